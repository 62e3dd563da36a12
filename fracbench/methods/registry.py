"""The registry of methods: ours, and those that other packages offer by entry points.

The module itself imports no numerics: planning a sweep needs names and parameters only.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fracbench.entry_points import Offers
from fracbench.errors import unknown_name
from fracbench.methods.method import OPTIONS, Method
from fracbench.methods.peers import PEERS
from fracbench.model.params import SWITCHES, FlowParams

# Parameters of extensions: the paper's methods do not use them, nor do the keys of their results.
_BEYOND = frozenset({
    "alpha_flat", "alpha_edge", "alpha_corner", "alpha_texture", "lambda_gradient", "derivatives", "edge_decay",
    "edge_power", "median_radius", "weighted_radius", "texture", "occlusion", "lambda_growth", "weighted_guide"
})  # fmt: skip
# Those of them that came after results of both methods were stored.
_GUIDED = {"weighted_guide": "gray"}
# Those of the flow in two parts.
_INFIMAL = frozenset({"alpha_smooth", "smooth_weight", "smooth_penalty"})
# Other readings of the paper's split Bregman iteration, data term and 5-point stencil, which not all methods have.
_BREGMANS = frozenset({"shrinkage", "lambda_l", "tol_norm"})
_DATA = frozenset({"gradient_of", "stencil", "warp", "outside"})
_FIVE_POINT = frozenset({"sweep_order", "stencil_border"})
_PYRAMID = frozenset(FlowParams.names()) - _BEYOND - _INFIMAL - _BREGMANS - _DATA - _FIVE_POINT - {
    "alpha", "boundary", "pad", "tau", "lambda_sb", "u_solver", "inner", "tol", "max_inner", "coupling",
    "coupling_step", "relaxation", "sweeps"
}  # fmt: skip
# For cheap iterations of little progress; the default of six is for the exact u-step.
_SMALL_STEPS = {"epsilon": 0.02, "max_iter": 300, "n_warps": 5}
_PAPERS_ORDERS = (
    "tvl1_sb_alpha is the paper's method, with the paper's orders; tvl1_sb_alpha_map and tvl1_sb_alpha_ic take "
    "orders up to 4"
)
_BREGMAN = _PYRAMID | {
    "lambda_sb", "u_solver", "inner", "tol", "max_inner", "coupling", "coupling_step", "relaxation"
}  # fmt: skip

METHODS: dict[str, Method] = {}
_OTHERS = Offers(
    Method, METHODS, lambda method, package, release: dataclasses.replace(method, package=package, release=release)
)
DEFAULT_METHOD = "tvl1_sb_alpha"


def register(method: Method) -> Method:
    """Add a method to the registry of this process and return it; it replaces an earlier one of its name."""
    METHODS[method.name] = method
    return method


def get_method(name: str) -> Method:
    """Return a method by name: ours, or that of the package whose entry point has the name.

    Raises
    ------
    InputError
        Unknown name (the nearest is offered), or a package whose method cannot be used.
    """
    if name in METHODS:
        return METHODS[name]
    if name in _OTHERS:
        return _OTHERS.load(name)
    raise unknown_name("method", name, method_names())


def method_names() -> list[str]:
    """Return the names of all methods, sorted; no package is imported."""
    return sorted([*METHODS, *_OTHERS.names()])


def all_methods() -> tuple[list[Method], list[str]]:
    """Return all methods, ours first, and a line for each entry point that cannot be used."""
    others, unusable = _OTHERS.load_all()
    return [*METHODS.values(), *others], unusable


def _ours(
    name: str,
    label: str,
    summary: str,
    module: str,
    uses: frozenset[str],
    *,
    defaults: Mapping[str, Any] | None = None,
    younger: Mapping[str, Any] | None = None,
    limits: Mapping[str, tuple[float, str]] | None = None,
    color: bool = False,
) -> Method:
    """Return a method of this package, whose module is imported with its first call."""
    estimate = partial(_imported, f"fracbench.methods.{module}", name)
    return Method(
        name,
        label,
        summary,
        estimate,
        uses=uses,
        defaults=defaults or {},
        younger={"finest_scale": 0, "normalisation": 0.0, **_off(uses), **(younger or {})},
        limits=limits or {},
        options=OPTIONS if color else OPTIONS - {"color"},
        frame_dtype=None,
    )


def _off(uses: frozenset[str]) -> dict[str, Any]:
    """Return the switches among parameters, with the values at which they are off."""
    return {name: value for name, value in SWITCHES.items() if name in uses}


def _imported(module: str, function: str, *frames: Any, **settings: Any) -> Any:
    estimate: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return estimate(*frames, **settings)


register(
    _ours(
        "tvl1",
        "TV-L1",
        "thresholding and Chambolle's dual step (Zach et al. 2007, Sanchez et al. 2013)",
        "paper",
        _PYRAMID | _DATA | {"tau", "sweeps"},
        defaults=_SMALL_STEPS,
    )
)
register(
    _ours(
        "tvl1_sb",
        "TV-L1-SB",
        "split Bregman with forward differences, no flux through the border (Algorithms 1-3)",
        "paper",
        _BREGMAN | _BREGMANS | _DATA | _FIVE_POINT | {"sweeps"},
        defaults={"u_solver": "gauss_seidel", "inner": "cold", "coupling": "penalty", **_SMALL_STEPS},
    )
)
register(
    _ours(
        "tvl1_sb_alpha",
        "TV-L1-SB-alpha",
        "split Bregman with the fractional gradient (Algorithms 1, 2, 4)",
        "paper",
        _BREGMAN | _BREGMANS | _DATA | {"alpha", "boundary", "pad"},
        limits={"alpha": (2.0, _PAPERS_ORDERS)},
    )
)
register(
    _ours(
        "tvl1_sb_alpha_map",
        "TV-L1-SB-alpha, mapped",
        "the same with an order for each class of structure in frame 0: flat, edge, corner, texture",
        "alpha_map",
        _BREGMAN | _BREGMANS | _BEYOND,
        # orders without weight at a pixel slow the convergence of its flow, so that more iterations are needed
        defaults={"n_warps": 5, "max_iter": 10},
        younger={"texture": 0.0, "occlusion": "median", "lambda_growth": 0.0, **_GUIDED},
        color=True,
    )
)
register(
    _ours(
        "tvl1_sb_alpha_ic",
        "TV-L1-SB-alpha, infimal",
        "flow in two parts of different orders, the infimal convolution: the flow chooses its order by itself",
        "infimal",
        # boundary, u_solver and inner have one value that it allows
        (_BREGMAN | _BEYOND | _INFIMAL | {"alpha", "boundary"})
        - {"alpha_flat", "alpha_edge", "alpha_corner", "alpha_texture", "tol", "max_inner"},
        defaults={"alpha": 1.0, "n_warps": 5, "max_iter": 10},
        younger={"smooth_penalty": 1.0, "lambda_growth": 0.0, **_GUIDED},
        color=True,
    )
)
for _peer in PEERS:
    register(_peer)
