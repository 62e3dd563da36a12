from __future__ import annotations

import numpy as np
import pytest
import scipy.ndimage

from fracbench.data.datasets.synthetic.scenes import scene
from fracbench.errors import InputError
from fracbench.evaluation.class_errors import errors_by_class
from fracbench.model.structure import CLASSES, CORNER, EDGE, FLAT, TEXTURE, noise_level, structure_classes

SIZES = (16, 33, 96)


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def step(size: int, degrees: float = 0.0) -> np.ndarray:
    """A straight edge through the middle, one pixel wide."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    distance = np.cos(np.radians(degrees)) * x + np.sin(np.radians(degrees)) * y
    return 50.0 + 100.0 * np.clip(distance + 0.5, 0.0, 1.0)


def quadrant(size: int) -> np.ndarray:
    """A bright square in the upper left corner, which ends in the middle."""
    image = np.full((size, size), 50.0)
    image[: size // 2, : size // 2] = 150.0
    return image


def checker(size: int, square: int = 4) -> np.ndarray:
    rows, cols = np.indices((size, size)) // square
    return 100.0 * ((rows + cols) % 2)


def share(classes: np.ndarray, wanted: int) -> float:
    return float((classes == wanted).mean())


def literal(image: np.ndarray) -> np.ndarray:
    """The docstring pixel by pixel: convolutions as sums over a mirrored image, eigenvalues by LAPACK."""
    k = np.arange(-3, 4)
    g = np.exp(-(k**2) / 2)
    g /= g.sum()
    dg = -k * g  # the derivative of the Gaussian, correlated: reversed below
    levels = (image - image.min()) / np.ptp(image)

    def convolve(plane, kernel):
        r0, r1 = kernel.shape[0] // 2, kernel.shape[1] // 2
        padded = np.pad(plane, ((r0, r0), (r1, r1)), mode="symmetric")
        out = np.zeros_like(plane)
        for i, j in np.ndindex(plane.shape):
            out[i, j] = (padded[i : i + kernel.shape[0], j : j + kernel.shape[1]] * kernel[::-1, ::-1]).sum()
        return out

    def gauss(sigma):
        r = int(3 * sigma + 0.5)
        w = np.exp(-(np.arange(-r, r + 1) ** 2) / (2 * sigma**2))
        return np.outer(w, w) / w.sum() ** 2

    gx, gy = convolve(levels, np.outer(g, dg)), convolve(levels, np.outer(dg, g))
    tensor = np.stack([convolve(p, gauss(1.5)) for p in (gx * gx, gx * gy, gx * gy, gy * gy)], axis=-1)
    small, large = np.moveaxis(np.linalg.eigvalsh(tensor.reshape(*image.shape, 2, 2)), -1, 0)
    mixed = convolve(levels, np.outer([1, -2, 1], [1, -2, 1]))
    sigma = np.quantile(np.abs(mixed), 0.25) / (6 * 0.3186393639643752)
    n2 = sigma**2 * (np.outer(g, dg) ** 2).sum()
    flat = large <= max(6 * n2, 0.02 * np.quantile(large, 0.95))
    busy = ~flat & (small > np.maximum(6 * n2, 0.1 * large))
    crowded = convolve(busy.astype(float), gauss(4.0)) > 0.4
    return np.where(flat, FLAT, np.where(crowded, TEXTURE, np.where(busy, CORNER, EDGE)))


class TestWhatItFinds:
    @pytest.mark.parametrize("size", SIZES)
    def test_noise_alone_is_flat(self, size):
        classes = structure_classes(rng().normal(128.0, 5.0, (size, size)))
        assert share(classes, FLAT) > 1.0 - 1.6 / size  # beside a side the mirror image doubles the noise

    @pytest.mark.parametrize("noise", [0.0, 5.0])
    @pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0])
    @pytest.mark.parametrize("size", SIZES)
    def test_a_straight_edge_is_an_edge_between_flats(self, size, degrees, noise):
        classes = structure_classes(step(size, degrees) + rng().normal(0.0, noise, (size, size)))
        y, x = np.mgrid[:size, :size] - (size - 1) / 2
        away = np.abs(np.cos(np.radians(degrees)) * x + np.sin(np.radians(degrees)) * y)
        inner = np.maximum(abs(x), abs(y)) < size / 2 - 3  # where it meets a side, a slanted edge makes an angle
        assert (classes[(away < 2.0) & inner] == EDGE).all()
        assert share(classes[away > 7.0], FLAT) > 0.98

    @pytest.mark.parametrize("noise", [0.0, 5.0])
    @pytest.mark.parametrize("size", SIZES)
    def test_a_single_right_angle_is_a_corner_at_its_tip_and_an_edge_along_its_sides(self, size, noise):
        classes = structure_classes(quadrant(size) + rng().normal(0.0, noise, (size, size)))
        tip = size // 2
        assert (classes[tip - 1 : tip + 1, tip - 1 : tip + 1] == CORNER).all()
        assert classes[0, tip] == classes[tip, 0] == EDGE
        assert share(classes, TEXTURE) == 0.0
        rows, cols = np.nonzero(classes == CORNER)
        assert np.hypot(rows - tip + 0.5, cols - tip + 0.5).max() < 8.0

    @pytest.mark.parametrize("noise", [0.0, 5.0])
    @pytest.mark.parametrize("size", SIZES)
    def test_a_crowd_of_corners_is_texture(self, size, noise):
        classes = structure_classes(checker(size) + rng().normal(0.0, noise, (size, size)))
        assert share(classes, TEXTURE) > 0.99

    def test_noise_on_a_part_of_the_image_is_texture_there(self):
        image = rng().normal(128.0, 1.0, (96, 96))
        image[:, 48:] += rng().normal(0.0, 40.0, (96, 48))
        classes = structure_classes(image)
        assert share(classes[:, 54:], TEXTURE) > 0.95
        assert share(classes[:, :40], FLAT) > 0.99

    def test_weak_beside_strong_is_flat_and_alone_is_not(self):
        weak = scene("flat", shape=(64, 64)).frame0
        assert share(structure_classes(weak), FLAT) < 0.01
        both = np.concatenate((weak, 127.5 + 20.0 * (scene("rotation", shape=(64, 64)).frame0 - 127.5)), axis=1)
        assert share(structure_classes(both)[:, :56], FLAT) > 0.9

    @pytest.mark.parametrize("name", ["edge", "corner", "parallax"])
    def test_noise_leaves_most_pixels_as_they_were(self, name):
        image = 5.0 * scene(name, shape=(96, 96)).frame0
        clean, noisy = structure_classes(image), structure_classes(image + rng().normal(0.0, 1.0, image.shape))
        assert (clean == noisy).mean() > 0.85

    @pytest.mark.parametrize("shape", [(24, 31), (19, 16)])
    def test_it_is_what_its_docstring_says(self, shape):
        image = scene("parallax", shape=shape).frame0 + rng().normal(0.0, 2.0, shape)
        found = structure_classes(image)
        np.testing.assert_array_equal(found, literal(image))
        assert len(np.unique(found)) > 2


class TestInvariance:
    @pytest.fixture(params=["parallax", "corner", "occlusion", "step", "checker"])
    def image(self, request):
        made = {"step": step(61, 30.0), "checker": checker(40, 5)}
        if request.param in made:
            return made[request.param]
        return scene(request.param, shape=(57, 80), noise=2.0, seed=4).frame0

    @pytest.mark.parametrize(
        ("gain", "offset"), [(4.0, 0.0), (1 / 255, 0.0), (3.7, -300.0), (1e-3, 5.0), (-1, 255)]
    )
    def test_gain_and_offset_change_nothing(self, image, gain, offset):
        np.testing.assert_array_equal(structure_classes(gain * image + offset), structure_classes(image))

    @pytest.mark.parametrize("axis", [0, 1, (0, 1)])
    def test_flips_exactly(self, image, axis):
        expected = np.flip(structure_classes(image), axis)
        np.testing.assert_array_equal(structure_classes(np.flip(image, axis)), expected)

    def test_transposes(self, image):
        np.testing.assert_array_equal(structure_classes(image.T), structure_classes(image).T)

    def test_single_precision_finds_the_same(self, image):
        narrow = image.astype(np.float32)
        np.testing.assert_array_equal(structure_classes(narrow), structure_classes(narrow.astype(np.float64)))
        assert (structure_classes(narrow) != structure_classes(image)).mean() < 1e-3

    def test_the_image_is_left_as_it_is(self, image):
        before = image.copy()
        structure_classes(image)
        np.testing.assert_array_equal(image, before)


class TestLimits:
    @pytest.mark.parametrize("level", [0.0, 127.3, -1e9, 1e-30])
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_a_constant_image_is_flat_up_to_rounding(self, level, dtype):
        image = np.full((16, 21), level, dtype)
        image[3, 5] = np.nextafter(image[3, 5], dtype(np.inf))
        if level == 0.0:
            image[3, 5] = 0.0  # the smallest number above 0 is not a rounding error of 0
        classes = structure_classes(image)
        assert classes.dtype == np.uint8
        assert classes.shape == image.shape
        assert not classes.any()

    @pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 2), (16, 16)])
    def test_any_size_will_do(self, shape):
        classes = structure_classes(rng().normal(size=shape))
        assert classes.shape == shape
        assert classes.max() < len(CLASSES)

    def test_whole_numbers_will_do(self):
        image = np.rint(step(32)).astype(np.uint8)
        np.testing.assert_array_equal(structure_classes(image), structure_classes(image.astype(float)))

    def test_huge_levels_do_not_overflow(self):
        np.testing.assert_array_equal(structure_classes(1e250 * step(32)), structure_classes(step(32)))

    @pytest.mark.parametrize("image", [np.zeros(5), np.zeros((2, 3, 3)), np.zeros((0, 4))])
    def test_what_is_no_image_is_refused(self, image):
        with pytest.raises(InputError, match="shape"):
            structure_classes(image)

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_what_is_not_finite_is_refused(self, value):
        image = step(16)
        image[4, 4] = value
        with pytest.raises(InputError, match="finite"):
            structure_classes(image)


class TestNoise:
    @pytest.mark.parametrize("sigma", [0.5, 4.0])
    def test_of_noise_alone_to_a_few_per_cent(self, sigma):
        assert noise_level(rng().normal(90.0, sigma, (200, 200))) == pytest.approx(sigma, rel=0.03)

    def test_ramps_and_edges_along_an_axis_are_none(self):
        y, x = np.mgrid[:50, :60].astype(float)
        assert noise_level(3.0 * x - 2.0 * y + 7.0) == pytest.approx(0.0, abs=1e-12)
        assert noise_level(np.where(x < 20, 0.0, 200.0)) == 0.0

    def test_detail_on_half_of_the_image_doubles_it_at_most(self):
        image = rng().normal(0.0, 2.0, (200, 200))
        image[:, 100:] += 100.0 * (scipy.ndimage.gaussian_filter(rng().normal(size=(200, 100)), 0.6))
        assert 2.0 < noise_level(image) < 2.0 * 2.2


class TestErrorsByClass:
    def test_each_class_is_scored_alone_and_those_without_known_pixels_are_left_out(self):
        classes = np.array([[FLAT, FLAT, EDGE], [EDGE, CORNER, EDGE]], np.uint8)
        truth = np.zeros((2, 2, 3))
        truth[:, 1, 1] = np.nan
        truth[:, 0, 2] = np.nan
        flow = np.zeros((2, 2, 3))
        flow[0] = [[1.0, 3.0, 9.0], [5.0, 9.0, 7.0]]
        found = errors_by_class(flow, truth, classes)
        assert list(found) == ["flat", "edge"]
        assert (found["flat"].aepe, found["flat"].n_pixels, found["flat"].n_unknown) == (2.0, 2, 0)
        assert (found["edge"].aepe, found["edge"].n_pixels, found["edge"].n_unknown) == (6.0, 2, 1)

    def test_classes_of_another_picture_are_refused(self):
        with pytest.raises(InputError, match="classes have the shape"):
            errors_by_class(np.zeros((2, 4, 4)), np.zeros((2, 4, 4)), np.zeros((4, 5), np.uint8))
