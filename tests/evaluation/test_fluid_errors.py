"""Errors of derivatives against closed forms, on the grid of vectors, and by class of the local gradient."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fracbench.errors import InputError
from fracbench.evaluation.fluid_errors import derivative_errors, errors_by_gradient, grid_points

Y, X = np.mgrid[:40, :56].astype(float)
STILL = np.zeros((2, 40, 56))


def linear(a, b, c, d):
    """The flow (a x + b y, c x + d y): vorticity c - b, divergence a + d, at any spacing."""
    return np.stack((a * X + b * Y, c * X + d * Y))


@pytest.mark.parametrize("step", [1, 8])
def test_a_linear_error_has_the_derivatives_of_its_matrix(step):
    truth, error = linear(0.01, 0.02, -0.03, 0.04), linear(0.003, -0.004, 0.002, 0.001)
    found = derivative_errors((truth + error)[:, ::step, ::step], truth[:, ::step, ::step], step)
    assert found.vorticity == pytest.approx(0.006, rel=1e-9)
    assert found.divergence == pytest.approx(0.004, rel=1e-9)
    assert found.own_divergence == pytest.approx(0.054, rel=1e-9)
    assert found.true_vorticity == pytest.approx(0.05, rel=1e-9)
    assert found.true_divergence == pytest.approx(0.05, rel=1e-9)


def test_white_noise_is_counted_by_central_differences_alone():
    # The variance of a central difference is sigma^2 / 2h^2, of two sigma^2 / h^2; one-sided: 13 times that.
    noise = np.random.default_rng(0).normal(0.0, 0.1, (2, 400, 400))
    found = derivative_errors(noise, np.zeros_like(noise), 2.0)
    assert found.vorticity == pytest.approx(0.1 / 2.0, rel=0.02)
    assert found.divergence == pytest.approx(0.1 / 2.0, rel=0.02)


def test_a_wave_free_of_divergence():
    k = 0.2
    wave = np.stack(
        (np.cos(k * Y), np.cos(k * X))
    )  # vorticity k (sin k y - sin k x), central: sin(k) in its place
    found = derivative_errors(wave, STILL)
    expected = math.sin(k) * np.sqrt(np.mean((np.sin(k * Y) - np.sin(k * X))[1:-1, 1:-1] ** 2))
    assert found.vorticity == pytest.approx(expected, rel=1e-9)
    assert found.divergence == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("unknown", [np.nan, 1e10])
def test_points_beside_an_unknown_flow_are_left_out(unknown):
    truth, flow = STILL.copy(), STILL.copy()
    truth[:, 10, 10] = unknown
    flow[:, 9:12, 9:12] = 7.0
    flow[:, 10, 10] = 0.0
    assert derivative_errors(flow, truth).vorticity > 0.0  # at the corners of the patch
    flow[:, 9:12, 9:12] = 0.0
    flow[:, 10, 10] = 7.0
    assert derivative_errors(flow, truth).vorticity == 0.0
    assert math.isnan(derivative_errors(flow, np.full_like(truth, unknown)).vorticity)  # nothing is known


def test_an_estimate_that_is_not_finite_has_no_error():
    flow = STILL.copy()
    flow[0, 20, 20] = np.nan
    assert math.isnan(derivative_errors(flow, STILL).vorticity)


def test_shapes_must_agree():
    with pytest.raises(InputError, match=r"the flow has the shape \(2, 4, 5\), the true flow \(2, 4, 6\)"):
        derivative_errors(np.zeros((2, 4, 5)), np.zeros((2, 4, 6)))


@pytest.mark.parametrize(
    ("start", "expected"), [((0, 0), (8, 8)), ((16, 16), (0, 0)), ((3, 8), (5, 0)), ((21, 9), (3, 7))]
)
def test_grid_points_are_multiples_of_8_in_the_frame(start, expected):
    rows, cols = grid_points(start, (40, 56))
    assert (rows.start, cols.start) == expected
    points = [
        begin + i for begin, n, part in zip(start, (40, 56), (rows, cols), strict=True) for i in range(n)[part]
    ]
    assert points and all(point % 8 == 0 and point > 0 for point in points)


def test_classes_of_the_gradient_are_those_of_its_frobenius_norm():
    truth = linear(0.036, 0.0, 0.0, -0.048)  # of norm 0.06
    flow = truth + np.array([[[0.3]], [[0.4]]])
    assert errors_by_gradient(flow, truth) == {"0.05": {"aepe": pytest.approx(0.5), "n_pixels": 40 * 56}}
    assert list(errors_by_gradient(flow, linear(0.0, 0.6, 0.6, 0.0))) == ["0.4"]
    assert list(errors_by_gradient(flow, linear(0.0, 0.019, 0.0, 0.0))) == ["0"]  # a shear: the norm is its rate
    truth = np.stack((np.where(X < 28, 0.0, 0.15 * X), STILL[1]))
    parts = errors_by_gradient(truth, truth)
    assert sum(part["n_pixels"] for part in parts.values()) == 40 * 56 and {"0", "0.1"} <= set(parts)
    truth[:, :, 30:] = np.nan
    assert sum(part["n_pixels"] for part in errors_by_gradient(truth, truth).values()) == 40 * 29
