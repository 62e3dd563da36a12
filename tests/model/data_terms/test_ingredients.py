"""The extensions at a scale: weights against their formulas, and no effect when they are off."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.methods import alpha_map
from fracbench.methods.registry import get_method
from fracbench.model import flow_filters, pyramid
from fracbench.model.data_terms import choose
from fracbench.model.data_terms.brightness import Brightness, TwoSided
from fracbench.model.data_terms.choose import make_residual, residual_factory
from fracbench.model.data_terms.gradients import ImageAndGradient
from fracbench.model.data_terms.occlusion import Visibility, visibility
from fracbench.model.data_terms.texture import textures
from fracbench.model.flow_filters import flow_filter, median
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import edge_weights
from fracbench.model.v_steps import ChannelStep, MultiplierStep, channel_step

SHORT = {"n_warps": 2, "max_iter": 5, "eta": 0.6, "dtype": "float64"}
#: Every ingredient, at a size that acts on small frames.
EVERYTHING = {
    "lambda": 0.2,
    "lambda_gradient": 0.8,
    "derivatives": "both",
    "edge_decay": 0.2,
    "median_radius": 1,
    "weighted_radius": 2,
    "texture": 0.9,
    "occlusion": "both",
    "lambda_growth": 1.5,
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
    got = edge_weights(image, 0.3, 0.8)
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
    for got in (edge_weights(image, 0.0, 0.5), edge_weights(0.0 * image, 1.0, 0.5)):
        np.testing.assert_array_equal(got, 1.0)
        assert got.dtype == np.float32


def test_what_is_off_is_not_there(frames):
    params = FlowParams(dtype="float64")
    assert type(make_residual(*frames, params)) is Brightness
    assert channel_step(np.zeros((2, 26, 31)), params) is None
    assert flow_filter(*frames, params) is None
    assert residual_factory(*frames, params) is make_residual


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"edge_power": 2.0},
        {"median_radius": 0, "weighted_radius": 0, "edge_decay": 0.0},
        {"texture": 0.0, "occlusion": "none"},  # no weighted median whose neighbours could count less
    ],
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
    assert type(make_residual(*frames, some)) is TwoSided
    assert type(make_residual(*frames, more)) is ImageAndGradient
    assert type(channel_step(np.zeros((2, 26, 31)), more)) is ChannelStep


def test_the_plain_filter_is_the_median_of_the_flow(frames):
    noisy = np.random.default_rng(4).normal(size=(2, 26, 31))
    refine = flow_filter(*frames, FlowParams(dtype="float64", median_radius=2))
    np.testing.assert_array_equal(refine(noisy), median(noisy, 5))


def test_the_weighted_filter_leaves_smooth_flow_to_the_plain_one(frames):
    """Far from motion edges both filters together are the plain one; a step brings the other in."""
    refine = flow_filter(*frames, FlowParams(dtype="float64", median_radius=1, weighted_radius=2))
    y, x = np.mgrid[:26, :31]
    smooth = np.stack([0.01 * x, 0.02 * y])
    np.testing.assert_array_equal(refine(smooth), median(smooth, 3))
    step = np.random.default_rng(4).normal(0.0, 0.01, (2, 26, 31)) + (x > 15)
    assert (refine(step) != median(step, 3)).any()
    np.testing.assert_array_equal(refine(step)[..., :8], median(step, 3)[..., :8])


@pytest.mark.parametrize("name", [name for name in EVERYTHING if name != "lambda"])
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
    """With gradients each v-step is solved: the result of few sweeps depends on the order of the channels x, y."""
    monkeypatch.setattr("fracbench.model.v_steps.DUAL_SWEEPS", 1000)
    values = {**EVERYTHING, "lambda_gradient": 0.3 * gradients, **SHORT, "max_iter": 3}
    transposed = flow([f.T.copy() for f in frames], **values)
    tolerance = 5e-3 if gradients else 1e-12
    np.testing.assert_allclose(transposed[::-1].transpose(0, 2, 1), flow(frames, **values), atol=tolerance)


def test_turning_the_frames_round_turns_the_flow(frames):
    """The turn is by 180 degrees, at one scale and with a uniform margin; the method has the same test."""
    framed = [np.pad(frame, 8, constant_values=100.0) for frame in frames]
    values = {**EVERYTHING, "n_scales": 1, "texture": 0.0}  # a turn makes its forward differences backward ones
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
        ({"texture": 1.1}, r"`texture` must be in \[0, 1\], got 1.1"),
        ({"occlusion": "bth"}, "unknown value of `occlusion` 'bth': did you mean 'both'"),
    ],
)
def test_bad_values_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        FlowParams().replace(values)


# -- textures and visibility ---------------------------------------------------------------------


def test_textures_are_taken_once_and_followed_down_the_pyramid(frames):
    """Without guides, the data at each scale are those of a run on the textures themselves."""
    own = textures(*pyramid.stretch(*frames, np.dtype(float)), 0.9)
    for more in ({}, {"n_scales": 1}, {"lambda_gradient": 0.5, "derivatives": "both"}):
        values = {**all_orders(1.1), **more}
        found = flow(frames, texture=0.9, **values)
        np.testing.assert_allclose(found, flow(own, **values), atol=1e-6)
        assert np.abs(found - flow(frames, **values)).max() > 1e-3


def test_guides_see_the_gray_levels(frames, monkeypatch):
    """Classes, weights of edges, filter and visibility are given the same frames with textures as without."""
    seen: dict[float, list] = {0.0: [], 0.9: []}

    def spy(module, name):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda image, *rest: seen[share].append(image) or real(image, *rest))

    for module, name in (
        (alpha_map, "edge_weights"),
        (choose, "Visibility"),
        (flow_filters, "Visibility"),
        (flow_filters, "FlowFilter"),
    ):
        spy(module, name)
    for share in seen:
        flow(frames, **{**EVERYTHING, "texture": share})
    assert len(seen[0.0]) == len(seen[0.9]) > 6
    for one, other in zip(*seen.values(), strict=True):
        np.testing.assert_array_equal(one, other)


def hidden(shape=(26, 31)):
    """A flow that converges along a column, where one surface covers another."""
    u = np.random.default_rng(6).normal(0.0, 0.2, (2, *shape))
    u[0] += np.where(np.arange(shape[1]) < 15, 1.0, -1.0)
    return u


@pytest.mark.parametrize("values", [{}, {"lambda_gradient": 0.5}, {"derivatives": "both", "texture": 0.9}])
def test_data_count_as_much_as_they_are_seen(frames, values):
    params = FlowParams(dtype="float64", **values)
    u = hidden()
    both = params.replace({"occlusion": "both"})
    plain, weighted = (residual_factory(*frames, chosen)(*frames, chosen).at(u) for chosen in (params, both))
    linear = Brightness(*frames, FlowParams(dtype="float64")).at(u)
    expected = visibility(u, linear.rho_c + linear.gradient[0] * u[0] + linear.gradient[1] * u[1])
    assert expected.min() < 0.01 and expected.max() > 0.9
    np.testing.assert_allclose(weighted.rho_c, plain.rho_c * expected)
    np.testing.assert_allclose(weighted.gradient, plain.gradient * expected)


def test_weighing_the_residual_is_thresholding_with_a_lambda_of_each_pixel(frames):
    """The v-step in closed form: v = z - tau lambda w sign(rho) grad, or as far as rho = 0, tau = theta + step."""
    params = FlowParams(dtype="float64", occlusion="both")
    u = hidden()
    plain = Brightness(*frames, params).at(u)
    weights = Visibility(*frames, params).of(u)
    target = MultiplierStep(u, params).target(u, make_residual(*frames, params).at(u))
    tau, g2 = params.theta + params.coupling_step, np.square(plain.gradient).sum(axis=0)
    rho = plain.rho_c + (plain.gradient * u).sum(axis=0)
    limit = params.lambda_ * weights
    move = np.clip(rho / (tau * np.where(g2 > 0.0, g2, 1.0)), -limit, limit) * (g2 > 0.0)
    w = u - params.coupling_step * move * plain.gradient
    assert (abs(move) == limit).any() and (abs(move) < limit).any()
    np.testing.assert_allclose(target, 2.0 * w - u, atol=1e-9)  # w - c with c = u - w


def test_where_there_is_no_flow_yet_all_is_seen(frames):
    far = 20.0 * frames[0], 20.0 * np.roll(frames[1], 9, axis=1)
    params = FlowParams(dtype="float64", occlusion="both")
    start = np.zeros((2, 26, 31))
    assert Visibility(*far, params).of(start).min() < 0.1
    plain, weighted = (
        make_residual(*far, params.replace({"occlusion": occlusion})).at(start) for occlusion in ("none", "both")
    )
    for one, other in zip(plain, weighted, strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_visibility_all_neighbours_count_alike(frames, monkeypatch):
    """Without visibility the filter gives the same flow as with visibility 1 everywhere; with it, another."""
    u = hidden()
    filters = {name: FlowParams(dtype="float64", weighted_radius=2, occlusion=name) for name in ("median", "none")}
    found = {name: flow_filter(*frames, params)(u) for name, params in filters.items()}
    assert (found["median"] != found["none"]).any()
    monkeypatch.setattr(
        "fracbench.model.data_terms.occlusion.visibility", lambda flow, residual: np.ones_like(residual)
    )
    np.testing.assert_array_equal(flow_filter(*frames, filters["median"])(u), found["none"])


def test_gradients_need_the_multiplier(frames):
    with pytest.raises(InputError, match="`lambda_gradient` needs coupling=multiplier, got penalty"):
        flow(frames, lambda_gradient=1.0, coupling="penalty")


def test_the_energy_of_gradients_is_not_traced(frames):
    params = FlowParams(lambda_gradient=1.0)
    with pytest.raises(InputError, match="`trace` needs lambda_gradient=0"):
        get_method("tvl1_sb_alpha_map").estimate(*frames, params, trace=True)
