from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.warping import (
    Linearization,
    central_gradient,
    cubic_weights,
    interleave,
    linearize,
    resize,
)

SHAPE = (9, 11)


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def grid(shape=SHAPE):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return x, y


def quadratic(x, y):
    return 3.0 + 2.0 * x - y + 0.3 * x * x - 0.2 * x * y + 0.1 * y * y


def linearized(frame0, frame1, u0):
    linear = Linearization(np.full(frame0.shape, np.nan), np.full((2, *frame0.shape), np.nan))
    linearize(frame0, interleave(frame1, central_gradient(frame1)), u0, *linear, 0, len(frame0))
    return linear


# -- sampling ------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [0.0, 0.1, 0.25, 0.5, 0.9, 1.0 - 1e-12])
def test_cubic_weights_are_keys_kernel(t):
    weights = cubic_weights(t)
    np.testing.assert_allclose(weights, [ref.keys_kernel(t - s) for s in (-1, 0, 1, 2)], atol=1e-15)
    assert sum(weights) == pytest.approx(1.0, abs=1e-15)
    for power in (1, 2):
        moment = sum(w * s**power for w, s in zip(weights, (-1, 0, 1, 2), strict=True))
        assert moment == pytest.approx(t**power, abs=1e-14)


def test_cubic_weights_at_a_sample_are_exact():
    assert tuple(cubic_weights(0.0)) == (0.0, 1.0, 0.0, 0.0)


# -- gradient ------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [SHAPE, (4, 4), (1, 5), (5, 1)])
def test_central_gradient_is_the_literal_one(rng, shape):
    image = rng.normal(size=shape)
    np.testing.assert_allclose(central_gradient(image), ref.central_gradient(image), atol=1e-15)


def test_central_gradient_by_hand():
    image = np.array([[0.0, 2.0, 6.0], [1.0, 1.0, 1.0]])
    gradient = central_gradient(image)
    np.testing.assert_array_equal(gradient[0], [[1.0, 3.0, 2.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(gradient[1], [[0.5, -0.5, -2.5], [0.5, -0.5, -2.5]])
    np.testing.assert_array_equal(central_gradient(image, scale=2.0), 2.0 * gradient)
    assert central_gradient(image.astype(np.float32)).dtype == np.float32


# -- linearisation -------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.0, 0.4, 3.0, 20.0])
def test_linearize_is_the_literal_loop(rng, reach):
    frame0, frame1 = rng.uniform(0, 255, (2, *SHAPE))
    u0 = rng.uniform(-reach, reach, (2, *SHAPE))
    rho_c, gradient = ref.linearize(frame0, frame1, ref.central_gradient(frame1), u0)
    linear = linearized(frame0, frame1, u0)
    np.testing.assert_allclose(linear.rho_c, rho_c, atol=1e-10)
    np.testing.assert_allclose(linear.gradient, gradient, atol=1e-11)


def test_linearize_samples_with_x_along_the_columns():
    """On a quadratic both the samples and the central differences are exact, away from the border."""
    x, y = grid()
    u0 = np.stack([np.full(SHAPE, 1.3), np.full(SHAPE, -0.6)])
    linear = linearized(np.zeros(SHAPE), quadratic(x, y), u0)
    inner = (slice(3, -3), slice(3, -4))
    xw, yw = x + 1.3, y - 0.6
    expected = np.stack([2.0 + 0.6 * xw - 0.2 * yw, -1.0 - 0.2 * xw + 0.2 * yw])
    np.testing.assert_allclose(linear.gradient[:, *inner], expected[:, *inner], atol=1e-12)
    rho_at_u0 = linear.rho_c + (linear.gradient * u0).sum(axis=0)
    np.testing.assert_allclose(rho_at_u0[inner], quadratic(xw, yw)[inner], atol=1e-11)


def test_equal_frames_have_no_residual_at_zero_flow(rng):
    frame = rng.uniform(0, 255, SHAPE).astype(np.float32)
    linear = linearized(frame, frame, np.zeros((2, *SHAPE), np.float32))
    np.testing.assert_array_equal(linear.rho_c[1:-2, 1:-2], 0.0)


def test_the_data_are_silent_outside_the_image(rng):
    frame0, frame1 = rng.uniform(0, 255, (2, *SHAPE))
    for u0 in (np.full((2, *SHAPE), 50.0), np.full((2, *SHAPE), -50.0), np.full((2, *SHAPE), 1e30)):
        linear = linearized(frame0, frame1, u0)
        np.testing.assert_array_equal(linear.gradient, 0.0)
        np.testing.assert_array_equal(linear.rho_c, -frame0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_flow_that_is_not_finite_reads_nothing(rng, bad):
    frame0, frame1 = rng.uniform(0, 255, (2, *SHAPE))
    u0 = np.zeros((2, *SHAPE))
    u0[0, 4, 5] = u0[1, 5, 4] = bad
    linear = linearized(frame0, frame1, u0)
    for pixel in ((4, 5), (5, 4)):
        assert linear.rho_c[pixel] == -frame0[pixel]
        assert (linear.gradient[:, *pixel] == 0.0).all()
    assert np.isfinite(linear.rho_c).all() and np.abs(linear.gradient[:, 4, 4]).min() > 0.0


# -- resize --------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(5, 6), (4, 5), (18, 22), (13, 7), (9, 11), (1, 1)])
def test_resize_is_the_literal_loop(rng, shape):
    image = rng.normal(size=SHAPE)
    np.testing.assert_allclose(resize(image, shape), ref.resize(image, shape), atol=1e-13)


def test_resize_to_its_own_size_is_a_copy(rng):
    image = rng.normal(size=SHAPE)
    same = resize(image, SHAPE)
    np.testing.assert_array_equal(same, image)
    assert not np.shares_memory(same, image)


@pytest.mark.parametrize("shape", [(9, 11), (20, 33), (12, 15), (27, 40)])
def test_resize_reproduces_quadratics_inside(shape):
    source = (18, 23)
    x, y = grid(shape)
    x, y = x * source[1] / shape[1], y * source[0] / shape[0]
    result = resize(quadratic(*grid(source)), shape)
    inside = (x >= 1) & (x < source[1] - 2) & (y >= 1) & (y < source[0] - 2)
    assert inside.any()
    np.testing.assert_allclose(result[inside], quadratic(x, y)[inside], atol=1e-11)


def test_resize_keeps_constants_and_precision():
    result = resize(np.full(SHAPE, 7.0, np.float32), (4, 17))
    assert result.dtype == np.float32 and result.flags.c_contiguous
    np.testing.assert_allclose(result, 7.0, rtol=1e-6)


def test_inputs_may_be_read_only(rng):
    frame, u0 = rng.uniform(0, 255, SHAPE), rng.normal(size=(2, *SHAPE))
    copies = frame.copy(), u0.copy()
    frame.flags.writeable = u0.flags.writeable = False
    linearized(frame, frame, u0), resize(frame, (4, 5))
    np.testing.assert_array_equal(frame, copies[0])
    np.testing.assert_array_equal(u0, copies[1])
