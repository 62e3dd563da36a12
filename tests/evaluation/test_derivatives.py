from __future__ import annotations

import math

import numpy as np
import pytest

import fracbench
from fracbench.errors import InputError
from fracbench.evaluation.derivatives import derivatives

Y, X = np.mgrid[0:9, 0:12].astype(float)


def everywhere(value: float) -> np.ndarray:
    return np.full(X.shape, value)


def check(found, vorticity, divergence, strain) -> None:
    np.testing.assert_allclose(found.vorticity, everywhere(vorticity), atol=1e-13)
    np.testing.assert_allclose(found.divergence, everywhere(divergence), atol=1e-13)
    np.testing.assert_allclose(found.strain, [everywhere(value) for value in strain], atol=1e-13)


def test_a_clockwise_rotation_has_twice_its_angular_velocity_as_vorticity():
    """With y down, a point right of the centre moves down: clockwise on the picture."""
    flow = 0.3 * np.stack([-(Y - 4), X - 6])
    assert flow[1, 4, 8] > 0
    check(derivatives(flow), 0.6, 0.0, (0, 0, 0))


def test_a_stagnation_flow_is_pure_strain():
    check(derivatives(0.2 * np.stack([X - 6, -(Y - 4)])), 0.0, 0.0, (0.2, -0.2, 0.0))


def test_a_source_has_divergence_alone():
    check(derivatives(0.2 * np.stack([X - 6, Y - 4])), 0.0, 0.4, (0.2, 0.2, 0.0))


@pytest.mark.parametrize(("flow", "vorticity"), [((0.5 * Y, 0 * X), -0.5), ((0 * Y, 0.5 * X), 0.5)])
def test_a_shear_is_half_rotation_and_half_strain(flow, vorticity):
    check(derivatives(np.stack(flow)), vorticity, 0.0, (0.0, 0.0, 0.25))


def test_x_and_y_have_coefficients_of_their_own():
    check(derivatives(np.stack([2 * X + 3 * Y, 5 * X + 7 * Y])), 5 - 3, 2 + 7, (2, 7, 4))


def taylor_green(n: int) -> tuple[np.ndarray, np.ndarray, float]:
    """u = (sin x cos 2y, -cos x sin 2y / 2) on n x n points, its vorticity, and the spacing."""
    h = 2.0 / (n - 1)
    y, x = np.mgrid[0:n, 0:n] * h
    flow = np.stack([np.sin(x) * np.cos(2 * y), -0.5 * np.cos(x) * np.sin(2 * y)])
    return flow, 2.5 * np.sin(x) * np.sin(2 * y), h


def test_the_error_falls_as_the_square_of_the_spacing_up_to_the_edges():
    largest = []
    for n in (21, 41, 81, 161):
        flow, vorticity, h = taylor_green(n)
        found = derivatives(flow, spacing=h)
        largest.append((np.abs(found.vorticity - vorticity).max(), np.abs(found.divergence).max()))
    orders = np.log2(np.array(largest[:-1]) / np.array(largest[1:]))
    assert orders[-1] == pytest.approx(2.0, abs=0.1)
    assert (orders > 1.6).all()


def test_a_grid_and_a_time_rescale_the_derivatives():
    flow = 0.3 * np.stack([-(Y - 4), X - 6])
    check(derivatives(flow, spacing=16, dt=0.5), 0.6 / 16 / 0.5, 0.0, (0, 0, 0))
    # A scale in mm a pixel multiplies displacements and distances.
    check(derivatives(0.02 * flow, spacing=0.02, dt=0.5), 1.2, 0.0, (0, 0, 0))


def test_float32_is_computed_in_float64_and_nan_stays_near():
    flow = (0.3 * np.stack([-(Y - 4), X - 6])).astype(np.float32)
    flow[:, 4, 6] = np.nan
    found = derivatives(flow)
    assert found.vorticity.dtype == np.float64
    unknown = np.isnan(found.vorticity)
    assert unknown.sum() == 4 and unknown[4, 5] and unknown[4, 7] and unknown[3, 6] and unknown[5, 6]


def test_wrong_input_is_refused_in_one_line():
    good = np.zeros((2, 4, 4))
    for flow in (np.zeros((4, 4)), np.zeros((3, 4, 4)), np.zeros((2, 2, 4)), np.zeros((2, 4, 2))):
        with pytest.raises(InputError, match="must have the shape"):
            derivatives(flow)
    for name in ("spacing", "dt"):
        for value in (0.0, -1.0, math.nan, math.inf):
            with pytest.raises(InputError, match=f"`{name}` must be a positive, finite number"):
                derivatives(good, **{name: value})


def test_it_is_public():
    assert fracbench.derivatives is derivatives
    assert {"derivatives", "Derivatives"} <= set(fracbench.__all__)
