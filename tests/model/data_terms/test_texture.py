"""Structure and texture: the minimiser of Rudin, Osher and Fatemi's energy, and the remaining texture."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.data_terms import texture
from fracbench.model.data_terms.texture import THETA, structure, textures


@pytest.fixture
def image():
    """A bright square on a ramp, with fine texture."""
    y, x = np.mgrid[:11, :13]
    square = 80.0 * ((abs(y - 5) < 3) & (abs(x - 6) < 4))
    return 60.0 + 5.0 * x + square + np.random.default_rng(1).normal(0.0, 8.0, y.shape)


def rof(u, image):
    """TV(u) + |u - image|^2 / (2 THETA), forward differences, none across the border."""
    dx, dy = (np.diff(u, axis=axis, append=np.take(u, [-1], axis)) for axis in (1, 0))
    return np.hypot(dx, dy).sum() + np.square(u - image).sum() / (2.0 * THETA)


def test_the_structure_has_the_least_energy(image, monkeypatch):
    """The energy lies between the bounds of FISTA on the dense dual."""
    lower, upper = ref.denoising_bounds(ref.dense_gradient("natural", 1.0, image.shape), [1.0], image, THETA)
    assert upper - lower < 1e-6 * upper
    assert rof(structure(image), image) == pytest.approx(upper, rel=2e-3)
    monkeypatch.setattr(texture, "ITERATIONS", 20000)
    assert rof(structure(image), image) == pytest.approx(upper, rel=1e-6)


def test_the_steps_are_chambolles(image, monkeypatch):
    """Literally: p <- (p + tau/theta grad u) / (1 + tau/theta |grad u|), u = image + theta div p."""
    monkeypatch.setattr(texture, "ITERATIONS", 7)
    height, width = image.shape
    u, p = image.copy(), np.zeros((2, height, width))
    for _ in range(7):
        for i, j in np.ndindex(image.shape):
            dx = u[i, j + 1] - u[i, j] if j + 1 < width else 0.0
            dy = u[i + 1, j] - u[i, j] if i + 1 < height else 0.0
            step = texture.TAU / THETA
            p[:, i, j] = (p[:, i, j] + step * np.array([dx, dy])) / (1.0 + step * np.hypot(dx, dy))
        padded = np.pad(p, ((0, 0), (1, 0), (1, 0)))
        p[0, :, -1], p[1, -1] = 0.0, 0.0
        u = image + THETA * (p[0] - padded[0, 1:, :-1] + p[1] - padded[1, :-1, 1:])
    np.testing.assert_allclose(structure(image), u, rtol=1e-12)


def test_the_structure_keeps_the_mean_and_the_image(image):
    before = image.copy()
    found = structure(image)
    assert found.mean() == pytest.approx(image.mean())
    assert np.ptp(found) < np.ptp(image)
    np.testing.assert_array_equal(image, before)
    assert structure(image.astype(np.float32)).dtype == np.float32


def test_textures_are_what_is_left_stretched_together(image):
    frames = image, np.roll(image, 1, axis=1) + 20.0
    parts = [frame - 0.95 * structure(frame) for frame in frames]
    low, high = np.min(parts), np.max(parts)
    for got, part in zip(textures(*frames, 0.95), parts, strict=True):
        np.testing.assert_allclose(got, 255.0 * (part - low) / (high - low))


def test_light_that_is_added_is_structure(image):
    """With all structure removed, more brightness does not change frame 1."""
    one, other = textures(image, image + 30.0, 1.0)
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_nothing_is_left_of_equal_constants():
    flat = np.full((5, 6), 7.0, np.float32)
    for got in textures(flat, flat, 1.0):
        np.testing.assert_array_equal(got, 0.0)
