"""Scenes of one structure: the structure is there, the flow exact, and all else differs between seeds."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from fracbench.data.datasets.synthetic.rendering import Swirl
from fracbench.data.datasets.synthetic.scenes import digest, layers, scene
from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE, SLANT, SPEEDS, STEP

SEEDS = (0, 1, 5)


@pytest.fixture(params=SEEDS)
def seed(request) -> int:
    return request.param


@pytest.mark.parametrize("name", SINGLE_STRUCTURE)
class TestEveryScene:
    def test_levels_size_and_truth(self, name, seed):
        s = scene(name, seed=seed)
        assert s.shape == (96, 96)
        assert 0 <= min(s.frame0.min(), s.frame1.min()) < max(s.frame0.max(), s.frame1.max()) <= 255
        assert np.isfinite(s.truth).all()
        assert 0.3 < np.hypot(*s.truth).max() < 5.0

    def test_what_a_pixel_shows_is_where_the_truth_says_in_frame_1(self, name, seed):
        """Frame 1 evaluated, layer by layer, where the flow leads from frame 0."""
        s, stack = scene(name, seed=seed), layers(name, seed=seed)
        y, x = np.mgrid[:96, :96].astype(float)
        x1, y1 = x + s.truth[0], y + s.truth[1]
        inside = np.ones((96, 96), bool)
        arrived = np.zeros((96, 96))
        for layer in stack:
            lx, ly = layer.motion.backward(x1, y1)
            cover = layer.coverage(lx, ly)
            arrived = (1 - cover) * arrived + cover * layer.texture(lx, ly)
            inside &= np.isin(layer.coverage(x, y), (0.0, 1.0)) & (cover == layer.coverage(x, y))
        assert inside.mean() > 0.85  # the rest is at an edge, or hidden in frame 1
        np.testing.assert_allclose(arrived[inside], s.frame0[inside], atol=1e-4)

    def test_seeds_differ(self, name):
        flows = [scene(name, seed=seed).truth[:, 48, 48] for seed in SEEDS]
        assert min(np.hypot(*(a - b)) for i, a in enumerate(flows) for b in flows[:i]) > 0.05
        assert len({digest(name, seed=seed) for seed in SEEDS}) == len(SEEDS)

    def test_noise_is_of_the_frames_alone(self, name):
        clean, noisy = scene(name, seed=3), scene(name, seed=3, noise=4.0)
        np.testing.assert_array_equal(clean.truth, noisy.truth)
        for frame in ("frame0", "frame1"):
            assert (getattr(noisy, frame) - getattr(clean, frame)).std() == pytest.approx(4.0, rel=0.05)


class TestOneStructure:
    def test_the_flat_one_is_weak_and_moves_as_one(self, seed):
        s = scene("lone_flat", seed=seed)
        assert 1.0 < s.frame0.std() < 5.0
        assert np.ptp(s.truth, axis=(1, 2)).max() < 1e-6
        assert SPEEDS[0] <= np.hypot(*s.truth[:, 0, 0]) <= SPEEDS[1]

    def test_the_edge_cuts_the_middle_and_two_surfaces_move_against_each_other(self, seed):
        s = scene("lone_edge", seed=seed)
        ground, figure = np.unique(s.truth.reshape(2, -1), axis=1).T
        np.testing.assert_allclose(sorted(np.hypot(*v) for v in (ground, figure)), self.speeds(s), atol=1e-5)
        assert np.dot(ground, figure) < 0
        bright = s.frame0 > 127.5
        assert 0.45 < bright.mean() < 0.55
        assert s.frame0[bright].mean() - s.frame0[~bright].mean() == pytest.approx(2 * STEP, abs=5.0)

    @staticmethod
    def speeds(s):
        fastest = np.hypot(*s.truth).max()
        return [fastest / 2, fastest]

    def test_the_corner_is_a_quarter_with_its_tip_in_the_middle(self, seed):
        s = scene("lone_corner", seed=seed)
        bright = s.frame0 > 127.5
        disc = np.hypot(*(np.mgrid[:96, :96] - 47.5)) < 47
        assert bright[disc].mean() == pytest.approx(0.25, abs=0.02)
        tip = bright[45:51, 45:51]
        assert 0 < tip.mean() < 0.5

    def test_the_parallax_edge_has_no_step_of_brightness_and_one_direction(self, seed):
        s = scene("lone_parallax", seed=seed)
        far, near = sorted(np.unique(s.truth.reshape(2, -1), axis=1).T, key=lambda v: np.hypot(*v))
        np.testing.assert_allclose(near, 2.0 * far, rtol=1e-5)
        fast = np.hypot(*(s.truth - far[:, None, None])) > 1e-3
        assert 0.4 < fast.mean() < 0.6
        assert {layer.texture.mean for layer in layers("lone_parallax", seed=seed)} == {127.5}

    def test_the_slanted_plane_has_one_gradient_of_rank_one(self, seed):
        u = scene("lone_affine", seed=seed).truth.astype(float)
        gradient = np.array([[np.diff(c, axis=1).mean(), np.diff(c, axis=0).mean()] for c in u])
        y, x = np.mgrid[:96, :96] - 47.5
        middle = u[:, 47:49, 47:49].mean(axis=(1, 2))
        linear = np.tensordot(gradient, np.stack((x, y)), 1) + middle[:, None, None]
        np.testing.assert_allclose(linear, u, atol=1e-4)
        values = np.linalg.svd(gradient, compute_uv=False)
        assert values == pytest.approx([SLANT, 0.0], abs=1e-5)

    def test_the_swirl_turns_and_does_not_spread(self, seed):
        u = scene("lone_curl", seed=seed).truth.astype(float)
        curl = np.gradient(u[1], axis=1) - np.gradient(u[0], axis=0)
        divergence = np.gradient(u[0], axis=1) + np.gradient(u[1], axis=0)
        assert abs(curl[48, 48]) == pytest.approx(0.2, abs=0.01)
        assert abs(divergence).max() < 0.1 * abs(curl).max()

    def test_a_swirl_is_undone_exactly(self):
        swirl = Swirl((1.2, -0.7), (40.0, 31.0), 0.3, 20.0)
        x, y = np.random.default_rng(0).uniform(0, 80, (2, 50))
        np.testing.assert_allclose(swirl.backward(*swirl.forward(x, y)), (x, y), atol=1e-12)
        found = scipy.optimize.fsolve(lambda p: np.subtract(swirl.forward(*p), (50.0, 20.0)), (50.0, 20.0))
        np.testing.assert_allclose(swirl.backward(50.0, 20.0), found, atol=1e-8)


PINNED = {
    "lone_flat": 123.40025277,
    "lone_edge": 163.94890874,
    "lone_corner": 168.60588540,
    "lone_parallax": 164.10370808,
    "lone_affine": 125.96749955,
    "lone_curl": 106.21763843,
}


def test_a_changed_rendering_needs_a_new_generator_version():
    """If this fails, raise `scenes.GENERATOR_VERSION` and put the new values here."""
    rendered = {name: scene(name, noise=1.0, seed=1).frame1[50, 60] for name in SINGLE_STRUCTURE}
    assert rendered == pytest.approx(PINNED, abs=1e-6)
