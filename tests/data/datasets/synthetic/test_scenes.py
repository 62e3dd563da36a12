from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from fracbench.data.datasets.registry import list_sequences, load_sequence
from fracbench.data.datasets.synthetic import scenes as synthetic
from fracbench.data.datasets.synthetic.scenes import ALL, SCENES, Layer, Motion, layers, scene
from fracbench.data.pair import FramePair
from fracbench.errors import InputError

SINGLE = ("flat", "rotation", "zoom")
LAYERED = ("edge", "corner", "parallax", "occlusion", "large")
RNG = np.random.default_rng(11)


@functools.cache
def default(name: str) -> FramePair:
    return scene(name)


def grid(shape) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return x, y


def scalar_texture(layer: Layer, x: float, y: float) -> float:
    t = layer.texture
    waves = zip(t.amplitude, t.fx, t.fy, t.phase, strict=True)
    return t.mean + sum(a * math.cos(2 * math.pi * (fx * x + fy * y) + p) for a, fx, fy, p in waves)


def scalar_pixel(stack, x: int, y: int, frame: int) -> float:
    """One pixel, layer by layer, each layer's motion inverted by a linear solve."""
    value = 0.0
    for layer in stack:
        point = np.array([x, y], dtype=float)
        if frame == 1:
            centre = np.array(layer.motion.centre)
            point = centre + np.linalg.solve(layer.motion.matrix, point - centre - layer.motion.translation)
        d = math.inf if layer.distance is None else float(layer.distance(*point))
        s = min(max(d + 0.5, 0.0), 1.0)
        cover = 3 * s**2 - 2 * s**3
        value = (1 - cover) * value + cover * scalar_texture(layer, *point)
    return value


@pytest.mark.parametrize("name", SCENES)
class TestEveryScene:
    def test_shape_range_and_dtypes(self, name):
        s = default(name)
        assert (s.name, s.dataset) == (name, "synthetic")
        assert 120 <= s.shape[0] <= 136 and 152 <= s.shape[1] <= 168
        for frame in (s.frame0, s.frame1):
            assert frame.dtype == np.float64 and not frame.flags.writeable
            assert 0 <= frame.min() < frame.max() <= 255
        assert s.truth.dtype == np.float32 and np.isfinite(s.truth).all()

    def test_the_range_holds_for_any_seed_and_shape(self, name):
        for layer in layers(name, seed=3):
            reach = layer.texture.amplitude.sum()
            assert layer.texture.mean - reach >= 0 and layer.texture.mean + reach <= 255

    def test_pixels_equal_a_scalar_rendering(self, name):
        s, stack = scene(name, seed=2), layers(name, seed=2)
        rows, cols = RNG.integers(0, s.shape[0], 60), RNG.integers(0, s.shape[1], 60)
        for y, x in zip(rows, cols, strict=True):
            assert s.frame0[y, x] == pytest.approx(scalar_pixel(stack, x, y, 0), abs=1e-9)
            assert s.frame1[y, x] == pytest.approx(scalar_pixel(stack, x, y, 1), abs=1e-9)

    def test_the_truth_takes_frame0_to_frame1(self, name):
        """Frame 1, read at x + u by a spline of order 5, is frame 0, wherever neither is near a layer's edge."""
        s, stack = default(name), layers(name)
        x, y = grid(s.shape)
        x1, y1 = x + s.truth[0], y + s.truth[1]
        clear = (np.minimum(x1, y1) >= 8) & (x1 <= s.shape[1] - 9) & (y1 <= s.shape[0] - 9)
        top = np.zeros(s.shape, dtype=int)
        for k, layer in enumerate(stack[1:], start=1):
            for at in ((x, y), layer.motion.backward(x1, y1)):
                distance = layer.distance(*at)
                clear &= np.abs(distance) >= 8
            top[layer.distance(x, y) > 0] = k
        for k, layer in enumerate(stack[1:], start=1):  # not covered in frame 1 by a layer above
            clear &= (top >= k) | (layer.distance(*layer.motion.backward(x1, y1)) < 0)
        assert clear.mean() > 0.2 and set(top[clear]) == set(range(len(stack)))
        there = map_coordinates(s.frame1, [y1, x1], order=5, mode="nearest")
        assert np.abs(there - s.frame0)[clear].max() < 0.01 * s.frame0.std()
        assert np.abs(s.frame1 - s.frame0)[clear].max() > 0.3 * s.frame0.std()  # a zero flow would not pass

    def test_the_truth_is_the_flow_of_the_topmost_layer(self, name):
        s, stack = default(name), layers(name)
        x, y = grid(s.shape)
        everywhere = np.ones(s.shape, dtype=bool)
        inside = [everywhere if v.distance is None else v.distance(x, y) >= 0 for v in stack]
        for r, c in zip(RNG.integers(0, s.shape[0], 200), RNG.integers(0, s.shape[1], 200), strict=True):
            top = [k for k in range(len(stack)) if inside[k][r, c]][-1]
            motion = stack[top].motion
            centre = np.array(motion.centre)
            moved = centre + np.array(motion.matrix) @ ([c, r] - centre) + motion.translation
            np.testing.assert_allclose(s.truth[:, r, c], moved - [c, r], atol=1e-6)

    def test_wavelengths_stay_above_four_pixels_in_both_frames(self, name):
        for layer in layers(name, seed=7):
            f = np.stack([layer.texture.fx, layer.texture.fy])
            inverse = np.linalg.inv(layer.motion.matrix)
            for frequencies in (f, inverse.T @ f):  # a wave f.p becomes f.(A^-1 p)
                assert np.hypot(*frequencies).max() < 0.25

    def test_rendering_is_deterministic(self, name):
        a, b = (scene(name, shape=(40, 50), noise=2.0, seed=4) for _ in range(2))
        np.testing.assert_array_equal(a.frame0, b.frame0)
        np.testing.assert_array_equal(a.frame1, b.frame1)
        assert a.digest == b.digest

    def test_a_seed_changes_the_texture_and_nothing_else(self, name):
        a, b = default(name), scene(name, seed=1)
        assert np.abs(a.frame0 - b.frame0).mean() > 0.25 * a.frame0.std()
        np.testing.assert_array_equal(a.truth, b.truth)

    def test_the_shape_changes_the_cut_and_not_the_motion(self, name):
        small = scene(name, shape=(64, 77))
        assert small.shape == (64, 77)
        for layer, same in zip(layers(name, shape=(64, 77)), layers(name), strict=True):
            assert (layer.motion.translation, layer.motion.matrix) == (
                same.motion.translation,
                same.motion.matrix,
            )

    def test_the_digest_is_that_of_the_rendering_and_needs_none(self, name, monkeypatch):
        rendered = scene(name, shape=(32, 33), noise=1.5, seed=9).digest
        monkeypatch.setattr(synthetic, "layers", lambda *_, **__: pytest.fail("rendered"))
        assert synthetic.digest(name, shape=(32, 33), noise=1.5, seed=9) == rendered
        assert synthetic.digest(name.upper(), shape=[32, 33], noise=1.5, seed=np.int64(9)) == rendered


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_layer_is_band_limited(name):
    """In both frames, no energy beyond 0.25 cycles a pixel but what a 4-term Blackman-Harris window leaks."""
    s = default(name)
    windows = []
    for n in s.shape:
        w = 2 * np.pi * (np.arange(n) + 0.5) / n
        windows.append(0.35875 - 0.48829 * np.cos(w) + 0.14128 * np.cos(2 * w) - 0.01168 * np.cos(3 * w))
    fy, fx = np.fft.fftfreq(s.shape[0]), np.fft.fftfreq(s.shape[1])
    beyond = np.hypot(fy[:, None], fx[None, :]) > 0.26
    for frame in (s.frame0, s.frame1):
        power = np.abs(np.fft.fft2((frame - frame.mean()) * np.outer(*windows))) ** 2
        assert power[beyond].sum() < 1e-6 * power.sum()
        fine = (np.hypot(fy[:, None], fx[None, :]) > 0.15) & ~beyond
        assert power[fine].sum() > 1e-3 * power.sum()  # and there is fine detail below the limit


def test_rotation_and_zoom_have_their_closed_form():
    s = scene("rotation")
    x, y = grid(s.shape)
    z = (x - (s.shape[1] - 1) / 2) + 1j * (y - (s.shape[0] - 1) / 2)
    flow = z * (np.exp(1j * math.radians(4)) - 1)
    np.testing.assert_allclose(s.truth, [flow.real, flow.imag], atol=1e-6)
    s = scene("zoom")
    x, y = grid(s.shape)
    expected = [0.04 * (x - (s.shape[1] - 1) / 2), 0.04 * (y - (s.shape[0] - 1) / 2)]
    np.testing.assert_allclose(s.truth, expected, atol=1e-6)


@pytest.mark.parametrize("name", LAYERED)
def test_layers_move_each_by_its_own_translation(name):
    found = {tuple(v) for v in default(name).truth.reshape(2, -1).T}
    assert found == {tuple(np.float32(layer.motion.translation)) for layer in layers(name)}
    assert len(found) == len(layers(name)) >= 2


def test_the_scenes_are_what_their_names_say():
    speed = {name: np.hypot(*default(name).truth) for name in SCENES}
    assert speed["flat"].max() < 1.5 and default("flat").frame0.std() < 5
    assert 10 <= np.median(speed["large"]) <= 12
    assert [layer.motion.translation[0] for layer in layers("parallax")] == [0.8, 2.0, 4.0]
    corner = (default("corner").truth == np.float32(layers("corner")[1].motion.translation)[:, None, None]).all(0)
    assert 0.15 < corner.mean() < 0.35
    assert any(n % 2 for name in SCENES for n in default(name).shape)


def test_an_edge_is_one_pixel_wide_and_smooth():
    layer = Layer(layers("flat")[0].texture, Motion((0.0, 0.0)), lambda x, y: x)
    d = np.linspace(-1, 1, 401)
    cover = layer.coverage(d, np.zeros_like(d))
    assert (cover[d <= -0.5] == 0).all() and (cover[d >= 0.5] == 1).all()
    assert cover[200] == 0.5
    assert (np.diff(cover) >= 0).all() and np.diff(cover).max() < 1.6 * (d[1] - d[0])
    np.testing.assert_allclose(cover + cover[::-1], 1.0, atol=1e-12)


def test_backward_inverts_forward():
    motion = Motion((3.0, -2.0), (10.0, 20.0), ((1.1, 0.3), (-0.2, 0.9)))
    x, y = RNG.normal(size=(2, 5, 5))
    np.testing.assert_allclose(motion.backward(*motion.forward(x, y)), (x, y), atol=1e-12)


def test_noise_is_gaussian_white_and_independent():
    clean, noisy = scene("zoom", seed=5), scene("zoom", seed=5, noise=3.0)
    first, second = noisy.frame0 - clean.frame0, noisy.frame1 - clean.frame1
    for noise in (first, second):
        assert abs(noise.mean()) < 0.1 and noise.std() == pytest.approx(3.0, rel=0.03)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.03
    np.testing.assert_array_equal(clean.truth, noisy.truth)


def test_digests_tell_every_parameter_apart(monkeypatch):
    digests = [synthetic.digest(name) for name in SCENES]
    digests += [synthetic.digest("edge", **kw) for kw in ({"shape": (64, 64)}, {"noise": 1.0}, {"seed": 1})]
    monkeypatch.setattr(synthetic, "GENERATOR_VERSION", synthetic.GENERATOR_VERSION + 1)
    digests.append(synthetic.digest("edge"))
    assert len(set(digests)) == len(digests)


def test_the_default_shape_and_the_same_shape_given_are_the_same_data():
    assert synthetic.digest("edge", shape=default("edge").shape) == synthetic.digest("edge")


PINNED = {
    "flat": 130.46709143,
    "edge": 82.95413263,
    "corner": 85.7674187,
    "parallax": 194.77064949,
    "rotation": 80.67695341,
    "zoom": 131.59067631,
    "occlusion": 113.66036583,
    "large": 137.93325768,
}


def test_a_changed_rendering_needs_a_new_generator_version():
    """If this fails, raise GENERATOR_VERSION and put the new values here."""
    assert synthetic.GENERATOR_VERSION == 1
    rendered = {name: scene(name, noise=1.0, seed=1).frame1[50, 60] for name in SCENES}
    assert rendered == pytest.approx(PINNED, abs=1e-6)


def test_load_sequence_renders_by_name():
    assert list_sequences("Synthetic") == ALL
    np.testing.assert_array_equal(load_sequence("EDGE", "synthetic").frame0, default("edge").frame0)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"name": "edeg"}, "did you mean 'edge'"),
        ({"shape": (7, 100)}, "at least 8 a side, got 7 x 100"),
        ({"shape": (10,)}, "`shape` must be two integers"),
        ({"shape": (10.0, 12)}, "`shape` must be two integers"),
        ({"shape": 12}, "`shape` must be two integers"),
        ({"noise": -1.0}, "`noise` must be finite and not negative"),
        ({"noise": math.nan}, "`noise` must be finite and not negative"),
        ({"noise": "much"}, "`noise` a number"),
        ({"seed": -1}, "`seed` must not be negative"),
        ({"seed": 0.5}, "`seed` an integer"),
    ],
)
def test_parameters_that_cannot_be_used(kwargs, message):
    for act in (scene, synthetic.digest):
        with pytest.raises(InputError, match=message) as caught:
            act(**{"name": "edge", **kwargs})
        assert "\n" not in str(caught.value)
