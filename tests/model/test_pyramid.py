from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest
from scipy import ndimage

from fracbench.model.pyramid import (
    MIN_SIDE,
    NOISE,
    SIGMA_ZERO,
    build,
    normalise,
    scale_shapes,
    smooth,
    stretch,
    upsample_flow,
)


@pytest.fixture
def rng():
    return np.random.default_rng(4)


# -- sizes ---------------------------------------------------------------------------------------


def test_scales_halve_the_size_rounding_halves_up():
    assert scale_shapes((50, 101), 0.5, 3) == [(50, 101), (25, 51), (13, 26)]


@pytest.mark.parametrize(
    ("shape", "scales"),
    [((480, 640), 6), ((388, 584), 6), ((380, 420), 6), ((96, 128), 4), ((30, 40), 2), ((12, 12), 1)],
)
def test_automatic_count_of_known_sizes(shape, scales):
    assert len(scale_shapes(shape, 0.5, None)) == scales


@pytest.mark.parametrize("eta", [0.3, 0.5, 0.65, 0.8, 0.95])
@pytest.mark.parametrize("shape", [(480, 640), (388, 584), (100, 90), (64, 64), (24, 32)])
def test_automatic_count_is_ipols(shape, eta):
    """N = 1 + log(hypot(nx, ny) / 16) / log(1 / zfactor), cut to a whole number (tvl1flow's main)."""
    expected = 1 + int(math.log(math.hypot(*shape) / 16) / math.log(1 / eta))
    assert len(scale_shapes(shape, eta, None)) == expected


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((4, 4), [(4, 4)]),
        ((5, 2000), [(5, 2000)]),
        ((2000, 8), [(2000, 8), (1000, 4)]),
        ((4, 5000), [(4, 5000)]),
    ],
)
def test_tiny_and_thin_images_stop_at_the_bicubic_stencil(shape, expected):
    assert scale_shapes(shape, 0.5, None) == expected
    assert scale_shapes(shape, 0.5, 9) == expected


@pytest.mark.parametrize("eta", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("shape", [(4, 4), (7, 300), (33, 17), (64, 48)])
def test_every_scale_is_smaller_and_large_enough(shape, eta):
    shapes = scale_shapes(shape, eta, None)
    assert all(min(s) >= MIN_SIDE for s in shapes)
    assert all(math.prod(b) < math.prod(a) for a, b in itertools.pairwise(shapes))


def test_the_count_asked_for_is_a_maximum():
    assert len(scale_shapes((480, 640), 0.5, 4)) == 4
    assert len(scale_shapes((480, 640), 0.5, 99)) == 6
    assert scale_shapes((480, 640), 0.5, 1) == [(480, 640)]


# -- stretching ----------------------------------------------------------------------------------


def test_frames_are_stretched_together():
    first, second = stretch(np.array([[0.0, 5.0]]), np.array([[10.0, -10.0]]), np.dtype(np.float64))
    np.testing.assert_allclose(first, [[127.5, 191.25]])
    np.testing.assert_allclose(second, [[255.0, 0.0]])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 257.0])
def test_stretching_undoes_gain_and_offset(rng, scale):
    frames = rng.uniform(0, 255, (2, 5, 6))
    frames[0, 0, :2] = 0.0, 255.0
    for result, frame in zip(stretch(*(frames * scale + 3.0), np.dtype(np.float64)), frames, strict=True):
        np.testing.assert_allclose(result, frame, atol=1e-9)


def test_equal_constants_are_left_alone():
    constant = np.full((4, 5), 42.0)
    for frame in stretch(constant, constant, np.dtype(np.float32)):
        np.testing.assert_array_equal(frame, 42.0)
        assert frame.dtype == np.float32


def test_stretching_makes_new_arrays(rng):
    frames = rng.uniform(0, 255, (2, 5, 6))
    copy = frames.copy()
    frames.flags.writeable = False
    for result in stretch(*frames, np.dtype(np.float64)):
        assert not np.shares_memory(result, frames)
    np.testing.assert_array_equal(frames, copy)


# -- smoothing and images ------------------------------------------------------------------------


def gaussian_by_hand(image, sigma, axis):
    reach = max(20, 2 * image.shape[axis])  # far beyond where the package cuts its kernel for the sigmas tested
    offsets = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (offsets / sigma) ** 2)
    kernel /= kernel.sum()
    n = image.shape[axis]
    lines = []
    for i in range(n):
        index = (i + offsets) % (2 * n)
        mirrored = np.where(index < n, index, 2 * n - 1 - index)
        lines.append(np.tensordot(kernel, np.take(image, mirrored, axis), axes=(0, axis)))
    return np.stack(lines, axis)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(9, 12), (30, 21), (4, 5), (1, 7), (7, 1)])
@pytest.mark.parametrize("sigma", [0.6, 0.8, SIGMA_ZERO * math.sqrt(3.0), 2.5])
def test_smoothing_is_a_gaussian_with_mirrored_borders(rng, sigma, shape, dtype):
    """A kernel that is longer than the image meets mirror images of mirror images."""
    image = rng.uniform(0, 255, shape)
    expected = gaussian_by_hand(gaussian_by_hand(image, sigma, 0), sigma, 1)
    smoothed = smooth(image.astype(dtype), sigma)
    assert smoothed.dtype == dtype
    np.testing.assert_allclose(smoothed, expected, atol=1e-3)


def test_no_smoothing_leaves_the_image(rng):
    image = rng.uniform(0, 255, (9, 12))
    np.testing.assert_array_equal(smooth(image, 0.0), image)


def test_pyramid_samples_where_the_flow_is_scaled():
    """A ramp of slope 1 per fine pixel has slope W / w per coarse pixel, and both agree at pixel 0."""
    width = 61
    ramp = np.tile(np.arange(width, dtype=float), (20, 1))
    shapes = scale_shapes(ramp.shape, 0.5, 2)
    levels = build(ramp, shapes, 0.5)
    assert [level.shape for level in levels] == shapes
    ratio = width / shapes[1][1]
    inner = slice(4, -4)
    np.testing.assert_allclose(
        levels[1][:, inner], np.tile(ratio * np.arange(shapes[1][1]), (10, 1))[:, inner], atol=1e-4
    )


def test_each_scale_is_smoothed_by_sigma_of_eta():
    """A cosine of wave number k is damped by exp(-k^2 sigma^2 / 2), sigma = 0.6 sqrt(eta^-2 - 1)."""
    n, eta = 96, 0.5
    k = np.pi * 12 / n  # even about the mirrored borders
    image = np.tile(np.cos(k * (np.arange(n) + 0.5)), (16, 1))
    coarse = build(image, [(16, n), (8, n // 2)], eta)[1]
    sigma = SIGMA_ZERO * math.sqrt(eta**-2 - 1)
    np.testing.assert_allclose(coarse, math.exp(-((k * sigma) ** 2) / 2) * image[::2, ::2], atol=1e-4)


def test_pyramid_keeps_constants_and_inputs(rng):
    constant = np.full((33, 47), 9.0, np.float32)
    constant.flags.writeable = False
    for level in build(constant, scale_shapes(constant.shape, 0.5, None), 0.5):
        assert level.dtype == np.float32
        np.testing.assert_allclose(level, 9.0, rtol=1e-6)
    np.testing.assert_array_equal(constant, 9.0)


# -- the flow on its way to the next scale -------------------------------------------------------


@pytest.mark.parametrize(("coarse", "fine"), [((13, 17), (25, 33)), ((8, 8), (16, 16)), ((5, 9), (10, 17))])
def test_displacement_scales_by_size_ratio(coarse, fine):
    flow = np.stack([np.full(coarse, 1.5), np.full(coarse, -2.0)])
    result = upsample_flow(flow, fine)
    assert result.shape == (2, *fine)
    np.testing.assert_allclose(result[0], 1.5 * fine[1] / coarse[1], rtol=1e-14)
    np.testing.assert_allclose(result[1], -2.0 * fine[0] / coarse[0], rtol=1e-14)


def test_a_zoom_keeps_its_rate_across_scales():
    """u = c x on the coarse grid is u = c x on the fine one: positions and displacements scale alike."""
    coarse, fine, rate = (13, 17), (25, 33), 0.05
    y, x = np.mgrid[: coarse[0], : coarse[1]].astype(float)
    result = upsample_flow(rate * np.stack([x, y]), fine)
    y, x = np.mgrid[: fine[0], : fine[1]].astype(float)
    inner = (slice(3, -6), slice(3, -6))
    np.testing.assert_allclose(result[0][inner], rate * x[inner], atol=1e-13)
    np.testing.assert_allclose(result[1][inner], rate * y[inner], atol=1e-13)


@pytest.mark.parametrize("gain", [0.0, 0.5, 2.0])
def test_a_given_gain_replaces_the_ratio(gain):
    flow = np.stack([np.full((5, 6), 1.5, np.float32), np.full((5, 6), -2.0, np.float32)])
    result = upsample_flow(flow, (10, 13), gain)
    assert result.dtype == np.float32
    np.testing.assert_allclose(result[0], 1.5 * gain, rtol=1e-6)
    np.testing.assert_allclose(result[1], -2.0 * gain, rtol=1e-6)


# -- normalisation -------------------------------------------------------------------------------


def test_normalised_frames_are_those_of_a_literal_twin(rng):
    """By SciPy's Gaussian, the formula of the docstring; both frames are stretched together at the end."""
    frames = rng.uniform(0, 255, (40, 50)), 40 + 0.5 * rng.uniform(0, 255, (40, 50))
    frames[0][0, :2] = 0, 255  # the first stretch then changes nothing

    def literal(image, sigma=5.0):
        blur = functools.partial(ndimage.gaussian_filter, sigma=sigma, mode="reflect", truncate=5.0)
        mean = blur(image)
        return (image - mean) / np.sqrt(blur((image - mean) ** 2) + NOISE**2)

    expected = stretch(*map(literal, frames), np.dtype(float))
    found = normalise(*frames, 5.0, np.dtype(float))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert min(map(np.min, found)) == 0 and max(map(np.max, found)) == pytest.approx(255)


def test_gain_and_offset_of_a_frame_drop_out(rng):
    frame = rng.uniform(0, 255, (60, 60))
    first, second = normalise(frame, 0.7 * frame + 20, 8.0, np.dtype(float))
    # but for the noise, whose contrast is 10 of some 70 gray levels, they are equal
    assert np.abs(first - second).max() < 3.0 < np.abs(frame - (0.7 * frame + 20)).max()


def test_a_frame_without_contrast_is_no_division_by_zero():
    found = normalise(np.full((20, 20), 7.0), np.full((20, 20), 7.0), 4.0, np.dtype(np.float32))
    assert np.isfinite(found).all() and np.ptp(found) < 1e-3
