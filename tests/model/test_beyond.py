"""What goes beyond the paper at a scale: weights by their formula, and nothing at all when it is off."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.methods.registry import get_method
from fracbench.model import beyond
from fracbench.model.channels import ChannelStep, ImageAndGradient, TwoSided
from fracbench.model.median import median
from fracbench.model.params import FlowParams
from fracbench.model.solver import Brightness

SHORT = {"n_warps": 2, "max_iter": 5, "eta": 0.6, "dtype": "float64"}
#: Every ingredient, at a size that acts on small frames.
EVERYTHING = {
    "lambda": 0.2,
    "lambda_gradient": 0.8,
    "derivatives": "both",
    "edge_decay": 0.2,
    "median_radius": 1,
    "weighted_radius": 2,
}


@pytest.fixture(scope="module")
def frames():
    return ref.translated_pair((26, 31), (1.1, -0.6))


def flow(frames, method="tvl1_sb_alpha_map", **values):
    params = FlowParams().replace({**SHORT, **values})
    return get_method(method).estimate(*frames, params).flow


def all_orders(alpha):
    return {f"alpha_{name}": alpha for name in ("flat", "edge", "corner", "texture")}


def test_edge_weights_are_their_formula():
    image = np.random.default_rng(2).uniform(0.0, 255.0, (7, 9))
    got = beyond.edge_weights(image, 0.3, 0.8)
    padded = np.pad(image, 1, mode="edge")
    expected = np.empty_like(image)
    for i, j in np.ndindex(image.shape):
        gx = (padded[i + 1, j + 2] - padded[i + 1, j]) / 2
        gy = (padded[i + 2, j + 1] - padded[i, j + 1]) / 2
        expected[i, j] = np.exp(-0.3 * np.hypot(gx, gy) ** 0.8)
    np.testing.assert_allclose(got, expected / expected.mean())
    assert got.mean() == pytest.approx(1.0)


def test_without_decay_or_without_edges_all_weights_are_1():
    image = np.random.default_rng(2).uniform(0.0, 255.0, (7, 9)).astype(np.float32)
    for got in (beyond.edge_weights(image, 0.0, 0.5), beyond.edge_weights(0.0 * image, 1.0, 0.5)):
        np.testing.assert_array_equal(got, 1.0)
        assert got.dtype == np.float32


def test_what_is_off_is_not_there(frames):
    params = FlowParams(dtype="float64")
    assert type(beyond.residual(*frames, params)) is Brightness
    assert beyond.channel_step(np.zeros((2, 26, 31)), params) is None
    assert beyond.refiner(*frames, params) is None


@pytest.mark.parametrize(
    "values", [{}, {"edge_power": 2.0}, {"median_radius": 0, "weighted_radius": 0, "edge_decay": 0.0}]
)
def test_with_everything_off_the_flow_is_that_of_one_order(frames, values):
    plain = flow(frames, "tvl1_sb_alpha", alpha=1.2)
    np.testing.assert_allclose(flow(frames, **all_orders(1.2), **values), plain, atol=1e-6)
    np.testing.assert_array_equal(flow(frames, **all_orders(1.2), **values), flow(frames, **all_orders(1.2)))


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha"])
def test_the_papers_methods_know_nothing_of_it(frames, method):
    assert not set(EVERYTHING) - {"lambda"} & get_method(method).uses
    given = {name: value for name, value in EVERYTHING.items() if name != "lambda"}
    np.testing.assert_array_equal(flow(frames, method, **given), flow(frames, method))


def test_the_parts_are_those_asked_for(frames):
    some = FlowParams(dtype="float64", derivatives="both")
    more = some.replace({"lambda_gradient": 1.0})
    assert type(beyond.residual(*frames, some)) is TwoSided
    assert type(beyond.residual(*frames, more)) is ImageAndGradient
    assert type(beyond.channel_step(np.zeros((2, 26, 31)), more)) is ChannelStep


def test_the_plain_filter_is_the_median_of_the_flow(frames):
    noisy = np.random.default_rng(4).normal(size=(2, 26, 31))
    refine = beyond.refiner(*frames, FlowParams(dtype="float64", median_radius=2))
    np.testing.assert_array_equal(refine(noisy), median(noisy, 5))


def test_the_weighted_filter_leaves_smooth_flow_to_the_plain_one(frames):
    """Far from motion edges both filters together are the plain one; a step brings the other in."""
    refine = beyond.refiner(*frames, FlowParams(dtype="float64", median_radius=1, weighted_radius=2))
    y, x = np.mgrid[:26, :31]
    smooth = np.stack([0.01 * x, 0.02 * y])
    np.testing.assert_array_equal(refine(smooth), median(smooth, 3))
    step = np.random.default_rng(4).normal(0.0, 0.01, (2, 26, 31)) + (x > 15)
    assert (refine(step) != median(step, 3)).any()
    np.testing.assert_array_equal(refine(step)[..., :8], median(step, 3)[..., :8])


@pytest.mark.parametrize(
    "name", ["lambda_gradient", "derivatives", "edge_decay", "median_radius", "weighted_radius"]
)
def test_each_ingredient_changes_the_flow(frames, name):
    steps = frames[0], np.where(np.arange(31) < 15, frames[1], frames[0])
    plain = flow(steps)
    assert np.abs(flow(steps, **{name: EVERYTHING[name]}) - plain).max() > 1e-3


def test_a_translation_is_found_with_everything_on(frames):
    found = flow(frames, n_warps=5, max_iter=20, **EVERYTHING)
    inner = found[:, 4:-4, 4:-4]
    np.testing.assert_allclose(np.median(inner, axis=(1, 2)), (1.1, -0.6), atol=0.05)


@pytest.mark.parametrize("gradients", [False, True])
def test_transposing_the_frames_transposes_the_flow(frames, gradients, monkeypatch):
    """With gradients where each v-step is solved: a few rounds treat the channels in the order x, y."""
    monkeypatch.setattr("fracbench.model.channels.ROUNDS", 1000)
    values = {**EVERYTHING, "lambda_gradient": 0.3 * gradients, **SHORT, "max_iter": 3}
    transposed = flow([f.T.copy() for f in frames], **values)
    tolerance = 5e-3 if gradients else 1e-12
    np.testing.assert_allclose(transposed[::-1].transpose(0, 2, 1), flow(frames, **values), atol=tolerance)


def test_turning_the_frames_round_turns_the_flow(frames):
    """By half a turn, at one scale and on an even margin; see the same test of the method itself."""
    framed = [np.pad(frame, 8, constant_values=100.0) for frame in frames]
    values = {**EVERYTHING, "n_scales": 1}
    there = flow([frame[::-1, ::-1].copy() for frame in framed], **values)
    np.testing.assert_allclose(there, -flow(framed, **values)[:, ::-1, ::-1], atol=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lambda_gradient": -1.0}, "`lambda_gradient` must be at least 0, got -1"),
        ({"derivatives": "bth"}, "unknown value of `derivatives` 'bth': did you mean 'both'"),
        ({"edge_decay": -0.1}, "`edge_decay` must be at least 0"),
        ({"edge_power": 0.0}, r"`edge_power` must be in \(0, 4\]"),
        ({"median_radius": 11}, r"`median_radius` must be in \[0, 10\]"),
        ({"median_radius": 1.5}, "`median_radius` must be a whole number"),
        ({"weighted_radius": -1}, r"`weighted_radius` must be in \[0, 20\]"),
    ],
)
def test_bad_values_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        FlowParams().replace(values)


def test_gradients_need_the_multiplier(frames):
    with pytest.raises(InputError, match="`lambda_gradient` needs coupling=multiplier, got penalty"):
        flow(frames, lambda_gradient=1.0, coupling="penalty")


def test_the_energy_of_gradients_is_not_traced(frames):
    params = FlowParams(lambda_gradient=1.0)
    with pytest.raises(InputError, match="`trace` needs lambda_gradient=0"):
        get_method("tvl1_sb_alpha_map").estimate(*frames, params, trace=True)
