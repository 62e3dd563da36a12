"""Scenes that mix two kinds of motion: both are there, and the flow is exact."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench.data.datasets.synthetic.mixed_structure import MIXED_STRUCTURE, RADIUS, SHAPE
from fracbench.data.datasets.synthetic.scenes import digest, layers, scene

SEEDS = (0, 1, 5)


@pytest.fixture(params=SEEDS)
def seed(request) -> int:
    return request.param


@pytest.mark.parametrize("name", MIXED_STRUCTURE)
def test_what_a_pixel_shows_is_where_the_truth_says_in_frame_1(name, seed):
    s, stack = scene(name, seed=seed), layers(name, seed=seed)
    assert s.shape == SHAPE and 0.3 < np.hypot(*s.truth).max() < 6.0
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x1, y1 = x + s.truth[0], y + s.truth[1]
    inside, arrived = np.ones(SHAPE, bool), np.zeros(SHAPE)
    for layer in stack:
        lx, ly = layer.motion.backward(x1, y1)
        cover = layer.coverage(lx, ly)
        arrived = (1 - cover) * arrived + cover * layer.texture(lx, ly)
        inside &= np.isin(layer.coverage(x, y), (0.0, 1.0)) & (cover == layer.coverage(x, y))
    assert inside.mean() > 0.85
    np.testing.assert_allclose(arrived[inside], s.frame0[inside], atol=1e-4)


@pytest.mark.parametrize("name", MIXED_STRUCTURE)
def test_seeds_differ(name):
    flows = [scene(name, seed=seed).truth[:, 72, 72] for seed in SEEDS]
    assert min(np.hypot(*(a - b)) for i, a in enumerate(flows) for b in flows[:i]) > 0.05
    assert len({digest(name, seed=seed) for seed in SEEDS}) == len(SEEDS)


def test_the_patch_is_affine_and_its_ground_constant(seed):
    u = scene("mixed_patch", seed=seed).truth.astype(float)
    away = np.hypot(*(np.mgrid[: SHAPE[0], : SHAPE[1]] - 71.5))
    ground = u[:, away > RADIUS * SHAPE[0] + 1]
    assert np.ptp(ground, axis=1).max() < 1e-6
    patch = u[:, 55:89, 55:89]
    assert abs(np.diff(patch, n=2, axis=1)).max() < 1e-5 < 0.02 < abs(np.diff(patch, axis=1)).max()
    assert np.hypot(*(u[:, 72, 72] - ground[:, 0])) > 1.0


def test_the_vortex_turns_and_the_edge_is_steep(seed):
    u = scene("mixed_vortex", seed=seed).truth.astype(float)
    curl = np.gradient(u[1], axis=1) - np.gradient(u[0], axis=0)
    assert abs(curl[70:74, 44:48]).min() > 0.15  # in the middle of the swirl
    step = np.hypot(*np.diff(u, axis=2))[72]
    assert step[90:105].max() > 1.0 and step[105:].max() < 1e-5


def test_a_changed_rendering_needs_a_new_generator_version():
    """If this fails, raise `scenes.GENERATOR_VERSION` and put the new values here."""
    rendered = {name: scene(name, noise=1.0, seed=1).frame1[50, 60] for name in MIXED_STRUCTURE}
    assert rendered == pytest.approx({"mixed_patch": 126.532236405, "mixed_vortex": 109.377904604}, abs=1e-6)
