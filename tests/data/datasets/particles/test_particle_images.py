from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from fracbench.data.datasets.particles import images
from fracbench.data.datasets.particles.flows import FLOWS, make_flow
from fracbench.data.datasets.particles.images import SETTINGS, SHAPE, digest, particle_pair, render
from fracbench.data.datasets.registry import digest_of, list_sequences, load_sequence, shape_of
from fracbench.errors import InputError

SMALL = (64, 80)


def one(x: float, y: float, light: float = 1000.0, diameter: float = 2.5, shape=(40, 50)) -> np.ndarray:
    return render(np.array([x]), np.array([y]), np.array([light]), diameter, shape)


def centroid(image: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(x * image).sum(), (y * image).sum()]) / image.sum()


class TestRender:
    @pytest.mark.parametrize("diameter", [0.5, 1.0, 2.5, 10.0])
    @pytest.mark.parametrize("place", [(25.0, 20.0), (24.5, 20.5), (25.31, 19.83)])
    def test_the_integral_of_an_image_is_the_light_of_the_particle(self, diameter, place):
        assert one(*place, light=321.0, diameter=diameter).sum() == pytest.approx(321.0, rel=1e-7)

    def test_a_pixel_holds_the_integral_of_a_gaussian_over_it(self):
        x, y, diameter = 20.3, 11.6, 2.0
        sigma = diameter / 4

        def part(centre: float, pixel: int) -> float:
            def density(t: float) -> float:
                return math.exp(-((t - centre) ** 2) / (2 * sigma**2)) / (sigma * math.sqrt(2 * math.pi))

            return quad(density, pixel - 0.5, pixel + 0.5)[0]

        image = one(x, y, 700.0, diameter)
        for row, col in ((11, 20), (12, 21), (12, 19), (10, 20)):
            assert image[row, col] == pytest.approx(700.0 * part(x, col) * part(y, row), rel=1e-9)
        point_sample = 700.0 * math.exp(-(0.3**2 + 0.4**2) / (2 * sigma**2)) / (2 * math.pi * sigma**2)
        assert abs(image[12, 20] / point_sample - 1) > 0.1

    def test_images_add(self):
        x, y, light = np.array([[10.2, 12.7, 49.6, -0.8], [9.1, 9.9, 39.3, -0.2], [50.0, 700.0, 90.0, 20.0]])
        each = sum(one(*spot) for spot in zip(x, y, light, strict=True))
        np.testing.assert_allclose(render(x, y, light, 2.5, (40, 50)), each, atol=1e-12)

    def test_a_particle_beside_the_frame_shines_into_it_and_a_far_one_does_not(self):
        assert one(-0.5, 20.0).sum() == pytest.approx(500.0)
        assert one(-1.0, 20.0)[20, 0] > 50.0
        assert not one(-1e3, 20.0).any() and not one(20.0, 60.0).any()


@pytest.mark.parametrize("name", FLOWS)
def test_the_centroid_of_a_particle_moves_by_the_true_displacement(name):
    """The particle at a pixel's centre, rendered before and after, against the truth of the pair at that pixel."""
    pair = particle_pair(name, shape=SMALL, displacement=6.0, density=0.001)
    flow = make_flow(name, SMALL, displacement=6.0)
    for row, col in ((20, 45), (32, 30), (40, 50)):
        x, y = np.array([float(col)]), np.array([float(row)])
        light = np.array([1000.0])
        before, after = (render(*at, light, 2.5, SMALL) for at in ((x, y), flow.trace(x, y)))
        np.testing.assert_allclose(centroid(after) - centroid(before), pair.truth[:, row, col], atol=1e-3)


def test_the_particles_of_a_pair_move_by_the_truth(monkeypatch):
    """With few particles each bright spot of frame 0 is found again in frame 1 where the truth says."""
    pair = particle_pair("shear", displacement=6.0, density=0.001, diameter=3.0)
    found = 0
    for row, col in np.argwhere(pair.frame0 > 40.0):
        window = pair.frame0[row - 10 : row + 11, col - 10 : col + 11]
        u = pair.truth[0, row, col]
        at = col + round(u)
        later = pair.frame1[row - 10 : row + 11, at - 10 : at + 11]
        if window.shape != (21, 21) or later.shape != (21, 21) or window[10, 10] < window.max():
            continue
        inner = np.hypot(*(np.mgrid[-10:11, -10:11])) <= 5
        if window[~inner].max() > 1e-3 or later[~inner].max() > 1e-3:  # another particle is near
            continue
        moved = centroid(later) - centroid(window) + (round(u), 0)
        exact = 12.0 * (row - 10 + centroid(window)[1] - 127.5) / 255.0
        np.testing.assert_allclose(moved, (exact, 0.0), atol=1e-3)
        found += 1
    assert found >= 5


class TestPair:
    def test_frames_and_truth(self):
        pair = particle_pair("Taylor_Green", shape=SMALL)
        assert (pair.name, pair.dataset, pair.shape) == ("taylor_green", "particles", SMALL)
        assert np.isfinite(pair.truth).all()
        assert pair.frame0.min() >= 0 and 100 < pair.frame0.max() < 1000
        assert np.abs(pair.frame1 - pair.frame0).max() > 50

    @pytest.mark.parametrize("density", [0.01, 0.1])
    def test_the_light_of_the_frame_follows_density_and_diameter(self, density):
        """The mean over depth of exp(-8 z^2), from -1/2 to 1/2, is 0.598."""
        for diameter in (1.5, 3.0):
            pair = particle_pair("stagnation", density=density, diameter=diameter)
            expected = density * 0.598 * images.PEAK * 2 * math.pi * (diameter / 4) ** 2
            assert pair.frame0.mean() == pytest.approx(expected, rel=0.1)
            assert pair.frame1.mean() == pytest.approx(expected, rel=0.1)

    def test_walls_are_dark_and_their_truth_unknown(self):
        pair = particle_pair("backstep", shape=SMALL, diameter=1.0, density=0.3)
        wall = np.isnan(pair.truth[0])
        assert wall[-1].all() and 0.05 < wall.mean() < 0.3 and (np.isnan(pair.truth[1]) == wall).all()
        deep = wall & (np.roll(wall, 3, axis=0) & np.roll(wall, -3, axis=1))
        deep[:3] = deep[:, -3:] = False
        assert deep.sum() > 20
        for frame in (pair.frame0, pair.frame1):
            assert frame[deep].max() < 1.0 < 10.0 < frame[~wall].mean()

    def test_lost_particles_are_replaced_by_others(self):
        """In a slow shear the frames correlate by the share of the particles that both show."""

        def alike(**settings) -> float:
            pair = particle_pair("shear", shape=(128, 128), displacement=0.5, diameter=6.0, **settings)
            assert pair.frame1.mean() == pytest.approx(pair.frame0.mean(), rel=0.1)
            return float(np.corrcoef(pair.frame0.ravel(), pair.frame1.ravel())[0, 1])

        whole = alike()
        assert whole > 0.97
        assert alike(lost=0.3) / whole == pytest.approx(0.7, abs=0.05)
        assert alike(lost=0.9) / whole == pytest.approx(0.1, abs=0.05)

    def test_background_and_noise_are_added(self):
        plain, ground, noisy = (
            particle_pair("jet", shape=SMALL, **given) for given in ({}, {"background": 50.0}, {"noise": 4.0})
        )
        ramp = np.broadcast_to(np.linspace(0, 50, SMALL[1]), SMALL)
        for name in ("frame0", "frame1"):
            np.testing.assert_allclose(getattr(ground, name) - getattr(plain, name), ramp, atol=1e-9)
        noise = [getattr(noisy, name) - getattr(plain, name) for name in ("frame0", "frame1")]
        assert np.std(noise) == pytest.approx(4.0, rel=0.05) and abs(np.mean(noise)) < 0.2
        assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05

    def test_a_seed_changes_the_particles_and_not_an_analytic_flow(self):
        a, b = (particle_pair("rankine", shape=SMALL, seed=seed) for seed in (0, 1))
        np.testing.assert_array_equal(a.truth, b.truth)
        assert np.abs(a.frame0 - b.frame0).max() > 50

    def test_a_larger_displacement_moves_the_same_particles(self):
        a, b = (particle_pair("rankine", shape=SMALL, displacement=d) for d in (1.0, 8.0))
        np.testing.assert_array_equal(a.frame0, b.frame0)
        assert np.abs(a.frame1 - b.frame1).max() > 50

    def test_it_is_deterministic_and_its_digest_is_of_everything_that_is_given(self):
        given = {"shape": SMALL, "noise": 2.0, "seed": 3, "lost": 0.1, "background": 9.0, "slope": 2.0}
        a, b = (particle_pair("solenoidal", **given) for _ in range(2))
        for name in ("frame0", "frame1", "truth"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.digest == b.digest == digest("SOLENOIDAL", **given)
        others = [given | {key: least + 0.25 * (most - least)} for key, (_, least, most) in SETTINGS.items()]
        others += [given | {"noise": 1.0}, given | {"seed": 4}, given | {"shape": (64, 81)}, {}]
        assert len({a.digest, *(digest("solenoidal", **other) for other in others)}) == len(others) + 1
        assert digest("jet") != digest("shear")

    def test_a_usual_value_and_none_are_the_same_pair(self):
        usual = {key: value for key, (value, _, _) in SETTINGS.items() if key != "slope"}
        assert digest("jet", **usual) == digest("jet") == digest("jet", displacement=5)


@pytest.mark.parametrize(
    ("name", "given", "named"),
    [
        ("lamb_osen", {}, "unknown particles sequence 'lamb_osen': did you mean 'lamb_oseen'"),
        ("jet", {"densty": 0.1}, "particles jet: unknown setting 'densty': did you mean 'density'"),
        ("jet", {"slope": 2.0}, "particles jet: `slope` is of sequence=solenoidal alone"),
        ("jet", {"displacement": 12.5}, "`displacement` must be within 0.5..12, got 12.5"),
        ("jet", {"density": 0.0}, "`density` must be within 0.001..0.5, got 0"),
        ("jet", {"diameter": math.nan}, "`diameter` must be within 0.5..10, got nan"),
        ("jet", {"lost": 1.0}, "`lost` must be within 0..0.9, got 1"),
        ("jet", {"noise": -1.0}, "`noise` must be finite and not negative, got -1"),
        ("jet", {"seed": -1}, "`seed` must be finite and not negative, got -1"),
        ("jet", {"seed": 1.5}, "`seed` an integer"),
        ("jet", {"background": "dark"}, "all others numbers"),
        ("jet", {"shape": (16, 64)}, "`shape` must be at least 32 a side, got 16 x 64"),
    ],
)
def test_bad_input_is_one_line(name, given, named):
    for function in (particle_pair, digest):
        with pytest.raises(InputError) as caught:
            function(name, **given)
        assert named in str(caught.value) and "\n" not in str(caught.value)


def test_the_registry_knows_the_dataset():
    assert list_sequences("particles") == tuple(FLOWS)
    assert shape_of("jet", "particles") == SHAPE
    assert digest_of("jet", "particles", seed=2, lost=0.2) == digest("jet", seed=2, lost=0.2)
    pair = load_sequence("JET", "particles", noise=1.0, displacement=2.0)
    assert pair.digest == digest("jet", noise=1.0, displacement=2.0) and pair.shape == SHAPE
