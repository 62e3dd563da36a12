from __future__ import annotations

import dataclasses
import sys
import textwrap
import types

import numpy as np
import pytest
import reference_impl as ref

from fracbench import estimate_flow
from fracbench.errors import InputError
from fracbench.harness.config.paths import checkout
from fracbench.methods.method import Method
from fracbench.methods.registry import METHODS, get_method, register
from fracbench.model.params import FlowParams

OURS = ("tvl1", "tvl1_sb", "tvl1_sb_alpha", "tvl1_sb_alpha_map", "tvl1_sb_alpha_ic")

#: parameter: (values that make it matter, two values of its own that give different flows)
VARIATIONS = {
    "lambda": ({}, 0.3, 0.1),
    "theta": ({}, 0.3, 0.15),
    "lambda_sb": ({}, 10.0, 3.0),
    "alpha": ({}, 1.1, 0.6),
    "epsilon": ({}, 0.1, 1e-3),
    "eta": ({}, 0.5, 0.7),
    "n_scales": ({}, None, 1),
    "finest_scale": ({}, 0, 1),
    "n_warps": ({}, 3, 1),
    "max_iter": ({"epsilon": 1e-4}, 10, 2),
    "presmoothing": ({}, 0.6, 1.2),
    "boundary": ({}, "reflect", "zero"),
    "pad": ({"boundary": "zero"}, 0, 4),
    "u_solver": ({}, "exact", "gauss_seidel"),
    "inner": ({}, "warm", "cold"),
    "coupling": ({}, "multiplier", "penalty"),
    "coupling_step": ({"coupling": "multiplier"}, 3.0, 1.0),
    "relaxation": ({"coupling": "multiplier", "inner": "warm"}, 1.7, 1.0),
    "tol": ({"inner": "cold"}, 0.1, 0.001),
    "max_inner": ({"inner": "cold", "tol": 1e-6}, 8, 2),
    "tau": ({}, 0.25, 0.1),
    "upsample_gain": ({}, None, 0.5),
    "relinearise": ({}, True, False),
    "dual_restart": ({"inner": "warm"}, False, True),
    "gradient_scale": ({}, 1.0, 2.0),
    "epsilon_squared": ({}, True, False),
    "dtype": ({}, "float32", "float64"),
    "alpha_flat": ({}, 1.0, 0.5),
    "alpha_edge": ({}, 1.3, 0.5),
    "alpha_corner": ({}, 1.3, 0.5),
    "alpha_texture": ({}, 1.3, 0.5),
    "lambda_gradient": ({}, 0.0, 0.5),
    "derivatives": ({}, "frame1", "both"),
    "edge_decay": ({}, 0.0, 0.3),
    "edge_power": ({"edge_decay": 0.3}, 0.5, 1.0),
    "median_radius": ({}, 0, 1),
    "weighted_guide": ({"gradient_scale": 0.1, "weighted_radius": 2}, "gray", "color"),
    "weighted_radius": ({"gradient_scale": 0.1}, 0, 2),  # a flow too long has edges
    "texture": ({}, 0.0, 0.5),
    "normalisation": ({}, 0.0, 8.0),
    "occlusion": ({}, "median", "both"),
    "intensity": ({}, "joint", "unit"),
    "lambda_factor": ({}, 1.0, 0.5),
    "theta_factor": ({}, 1.0, 0.5),
    "swap_weights": ({"theta": 0.2}, False, True),
    "smoothing_at": ({}, "frames", "scales"),
    "downsampling": ({}, "gaussian", "plain"),
    "upsampling": ({}, "bicubic", "bilinear"),
    "gradient_of": ({}, "frame1", "mean"),
    "stencil": ({}, "central", "forward"),
    "warp": ({}, "bicubic", "bilinear"),
    "outside": ({}, "zero", "repeat"),
    "threshold": ({"coupling": "penalty", "inner": "warm"}, "full", "no_theta"),
    "u0_per_scale": ({}, False, True),
    "residual_u0": ({}, True, False),
    "unknown": ({}, "flow", "increment"),
    "shrinkage": ({}, "isotropic", "anisotropic"),
    "lambda_l": ({}, None, 3.0),
    "sweeps": ({"u_solver": "gauss_seidel"}, 1, 2),
    "sweep_order": ({"u_solver": "gauss_seidel"}, "raster", "backward"),
    "stencil_border": ({"u_solver": "gauss_seidel"}, "natural", "four_zero"),
    "tol_norm": ({"inner": "cold", "tol": 0.01}, "rms", "sum"),
    "alpha_smooth": ({}, 1.5, 0.7),
    "smooth_weight": ({}, 2.0, 0.5),
    "smooth_penalty": ({}, 1.0, 10.0),
    "lambda_growth": ({}, 0.0, 2.0),
}
#: The values that `tvl1_sb_alpha_ic` allows; it refuses others.
ONLY = {"boundary": "reflect", "u_solver": "exact", "inner": "warm"}
SMALL = {"n_warps": 3, "max_iter": 10, "epsilon": 1e-3, "max_inner": 8}


@pytest.fixture(scope="module")
def frames():
    pair = ref.translated_pair((20, 26), (1.1, -0.6))
    for frame in pair:
        frame.flags.writeable = False
    return pair


def flow(method, frames, **values):
    chosen = get_method(method)
    params = FlowParams().replace(chosen.defaults).replace(SMALL).replace(values)
    color = np.random.default_rng(1).uniform(0.0, 255.0, (*frames[0].shape, 3))
    return chosen.estimate(*frames, params, **({"color": color} if "color" in chosen.options else {})).flow


def test_the_papers_methods_are_registered():
    assert set(OURS) <= set(METHODS)
    for name, method in METHODS.items():
        assert method.name == name
        assert method.summary and "\n" not in method.summary
        assert method.uses <= set(method.names)
        assert set(method.defaults) <= method.uses
        assert method.values(method.start()).keys() == method.uses


def test_every_parameter_is_varied_here():
    assert set(VARIATIONS) == set(FlowParams.names())


@pytest.mark.parametrize("method", OURS)
@pytest.mark.parametrize("parameter", VARIATIONS)
def test_a_method_depends_on_what_it_says_it_uses_and_on_nothing_else(frames, method, parameter):
    context, *values = VARIATIONS[parameter]
    last = {**context, parameter: values[1]}
    if method == "tvl1_sb_alpha_ic" and {**ONLY, **last} != {**last, **ONLY}:
        with pytest.raises(InputError, match="tvl1_sb_alpha_ic needs"):
            flow(method, frames, **last)
        return
    first, second = (flow(method, frames, **{**context, parameter: value}) for value in values)
    assert np.isfinite(first).all()
    assert np.array_equal(first, second) == (parameter not in get_method(method).uses)


@pytest.mark.parametrize("values", [{"coupling_step": 1.0}, {"relaxation": 1.2}])
def test_the_penalty_coupling_ignores_what_belongs_to_the_multiplier(frames, values):
    for method in ("tvl1_sb", "tvl1_sb_alpha", "tvl1_sb_alpha_map", "tvl1_sb_alpha_ic"):
        plain = flow(method, frames, coupling="penalty", inner="warm")
        np.testing.assert_array_equal(flow(method, frames, coupling="penalty", inner="warm", **values), plain)


def test_methods_differ(frames):
    flows = [flow(method, frames) for method in OURS]
    for i, one in enumerate(flows):
        for other in flows[:i]:
            assert np.abs(one - other).max() > 1e-4


def test_unknown_methods_offer_the_nearest():
    with pytest.raises(InputError, match=r"unknown method 'tvl1sb': did you mean 'tvl1_sb'\?") as caught:
        get_method("tvl1sb")
    assert all(name in str(caught.value) for name in OURS)


def test_a_registered_method_is_found_and_may_be_replaced(monkeypatch):
    monkeypatch.setattr("fracbench.methods.registry.METHODS", dict(METHODS))
    mine = dataclasses.replace(get_method("tvl1"), name="mine")
    assert register(mine) is mine
    assert get_method("mine") is mine
    better = register(dataclasses.replace(mine, summary="better"))
    assert get_method("mine") is better
    assert "mine" not in METHODS


def test_the_recipe_of_a_method_works(monkeypatch):
    root = checkout()
    if root is None:
        pytest.skip("the recipe is that of a checkout")
    recipe = (root / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Add a method")[2]
    module = types.ModuleType("my_method")
    monkeypatch.setitem(sys.modules, "my_method", module)
    exec(textwrap.dedent(recipe.partition("   ```python\n")[2].partition("   ```")[0]), vars(module))
    monkeypatch.setattr("fracbench.methods.registry.METHODS", dict(METHODS))
    register(module.METHOD)
    result = estimate_flow(np.zeros((9, 9)), np.ones((9, 9)), method="right", pixels="2")
    assert (result.method, result.params) == ("right", module.Params(2.0))
    assert (result.flow[0] == 2).all() and not result.flow[1].any()


def test_a_method_may_overwrite_the_frames_that_it_gets():
    def estimate(frame0, frame1, params):
        frame0[...] = frame1[...] = 0.0
        return np.zeros((2, *frame0.shape))

    frames = np.ones((2, 8, 8), np.float32)
    Method("careless", "label", "summary", estimate).compute(*frames, FlowParams())
    assert frames.all()


# -- orders above 2 ------------------------------------------------------------------------------


@pytest.mark.parametrize("boundary", ["zero", "reflect"])
def test_the_papers_method_keeps_the_papers_orders(boundary):
    method = get_method("tvl1_sb_alpha")
    says = r"`alpha` must be in \[0, 2\], got 2.5: tvl1_sb_alpha is the paper's method.*tvl1_sb_alpha_map and"
    for value in (2.5, "2.5"):
        with pytest.raises(InputError, match=says):
            method.replace(method.start(), {"alpha": value, "boundary": boundary})
    frame = np.zeros((8, 8))
    with pytest.raises(InputError, match=says):
        method.compute(frame, frame, FlowParams(alpha=2.5, boundary=boundary))
    assert method.replace(method.start(), {"alpha": 2.0}).alpha == 2.0


def test_limits_hold_for_each_spelling_and_for_parameters_that_may_be_none():
    limits = {"lambda": (0.5, "a reason"), "n_scales": (3, "another")}
    method = dataclasses.replace(get_method("tvl1"), limits=limits)
    frame = np.zeros((8, 8))
    for refuse in (
        lambda: method.replace(method.start(), {"lambda": 0.9}),
        lambda: method.replace(method.start(), {"lambda_": "0.9"}),
        lambda: method.compute(frame, frame, FlowParams(lambda_=0.9)),
    ):
        with pytest.raises(InputError, match=r"`lambda` must be in \[0, 0.5\], got 0.9: a reason"):
            refuse()
    assert method.replace(method.start(), {"n_scales": "auto", "lambda_": 0.5}).n_scales is None
    with pytest.raises(InputError, match=r"`n_scales` must be in \[1, 3\], got 4: another"):
        method.compute(frame, frame, FlowParams(n_scales=4))


def test_equal_orders_above_2_are_one_order_of_both_other_methods():
    """The map of four equal orders, and two parts of which the second is too dear, are a single order."""
    y, x = np.mgrid[:24, :32] / 6.0
    frame0 = 120.0 + 100.0 * np.sin(2 * x + y) * np.cos(x - 2 * y)
    frame1 = 120.0 + 100.0 * np.sin(2 * (x - 0.1) + y) * np.cos((x - 0.1) - 2 * y)
    usual = {"n_scales": 1, "n_warps": 4, "max_iter": 60, "epsilon": 0.0, "dtype": "float64"}
    flows = {}
    for order in (2.0, 3.0):
        equal = {f"alpha_{name}": order for name in ("flat", "edge", "corner", "texture")}
        parts = {"alpha": order, "alpha_smooth": order, "smooth_weight": 1e3}
        for name, orders in (("tvl1_sb_alpha_map", equal), ("tvl1_sb_alpha_ic", parts)):
            method = get_method(name)
            params = method.replace(method.start(), {**usual, **orders})
            flows[name, order] = method.compute(frame0, frame1, params).flow
        mapped, infimal = flows["tvl1_sb_alpha_map", order], flows["tvl1_sb_alpha_ic", order]
        np.testing.assert_allclose(infimal, mapped, atol=5e-3)
        np.testing.assert_allclose(mapped[0, 6:-6, 6:-6], 0.6, atol=0.05)
    assert np.abs(flows["tvl1_sb_alpha_map", 2.0] - flows["tvl1_sb_alpha_map", 3.0]).max() > 1e-4
