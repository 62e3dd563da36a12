"""The registry of methods: name -> parameters, defaults and the place of the code.

The module itself imports no numerics: planning a sweep needs names and parameters only.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fracbench.errors import InputError, unknown_name
from fracbench.model.params import FlowParams

# Parameters of extensions: the paper's methods do not use them, nor do the keys of their results.
_BEYOND = frozenset({
    "alpha_flat", "alpha_edge", "alpha_corner", "alpha_texture", "lambda_gradient", "derivatives", "edge_decay",
    "edge_power", "median_radius", "weighted_radius", "texture", "occlusion"
})  # fmt: skip
# Those of the flow in two parts.
_INFIMAL = frozenset({"alpha_smooth", "smooth_weight"})
_PYRAMID = frozenset(FlowParams.names()) - _BEYOND - _INFIMAL - {
    "alpha", "boundary", "pad", "tau", "lambda_sb", "u_solver", "inner", "tol", "max_inner", "coupling",
    "coupling_step", "relaxation"
}  # fmt: skip
# For cheap iterations of little progress; the default of six is for the exact u-step.
_SMALL_STEPS = {"epsilon": 0.02, "max_iter": 300, "n_warps": 5}
_BREGMAN = _PYRAMID | {
    "lambda_sb", "u_solver", "inner", "tol", "max_inner", "coupling", "coupling_step", "relaxation"
}  # fmt: skip


@dataclass(frozen=True)
class Method:
    """A way to compute flow.

    Attributes
    ----------
    name : str
        Key in the registry.
    label : str
        Its name in tables and legends.
    summary : str
        One line.
    home : str
        ``"module:function"``; the function is called as ``function(frame0, frame1, params, trace=False)`` on
        gray (H, W) arrays and returns a `FlowResult`.
    uses : frozenset of str
        The parameters it depends on, by public name: no other enters the key of its results.
    defaults : mapping
        Parameters it starts from where they differ from `FlowParams`' own.
    requires : tuple of str
        Modules of other programs, which an extra installs.
    """

    name: str
    label: str
    summary: str
    home: str
    uses: frozenset[str]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    requires: tuple[str, ...] = ()

    @property
    def estimate(self) -> Callable[..., Any]:
        """The function itself, imported when asked for."""
        module, _, function = self.home.partition(":")
        estimate: Callable[..., Any] = getattr(importlib.import_module(module), function)
        return estimate

    def require(self) -> Method:
        """Return the method itself, if all that it needs is installed; else `InputError` says how to get it."""
        for module in self.requires:
            if importlib.util.find_spec(module) is None:
                raise InputError(f"method {self.name!r} needs {module}: pip install 'fracbench[peers]'")
        return self


METHODS: dict[str, Method] = {}
DEFAULT_METHOD = "tvl1_sb_alpha"


def register(method: Method) -> Method:
    """Add a method to the registry and return it; a later one replaces an earlier one of the same name."""
    METHODS[method.name] = method
    return method


def get_method(name: str) -> Method:
    """Return a method by name.

    Raises
    ------
    InputError
        Unknown name; the nearest is offered.
    """
    if name not in METHODS:
        raise unknown_name("method", name, METHODS)
    return METHODS[name]


register(
    Method(
        "tvl1",
        "TV-L1",
        "thresholding and Chambolle's dual step (Zach et al. 2007, Sanchez et al. 2013)",
        "fracbench.methods.paper:tvl1",
        _PYRAMID | {"tau"},
        _SMALL_STEPS,
    )
)
register(
    Method(
        "tvl1_sb",
        "TV-L1-SB",
        "split Bregman with forward differences, no flux through the border (Algorithms 1-3)",
        "fracbench.methods.paper:tvl1_sb",
        _BREGMAN,
        {"u_solver": "gauss_seidel", "inner": "cold", "coupling": "penalty", **_SMALL_STEPS},
    )
)
register(
    Method(
        "tvl1_sb_alpha",
        "TV-L1-SB-alpha",
        "split Bregman with the fractional gradient (Algorithms 1, 2, 4)",
        "fracbench.methods.paper:tvl1_sb_alpha",
        _BREGMAN | {"alpha", "boundary", "pad"},
    )
)


register(
    Method(
        "tvl1_sb_alpha_map",
        "TV-L1-SB-alpha, mapped",
        "the same with an order for each class of structure in frame 0: flat, edge, corner, texture",
        "fracbench.methods.alpha_map:tvl1_sb_alpha_map",
        _BREGMAN | _BEYOND,
        # orders without weight at a pixel slow the convergence of its flow, so that more iterations are needed
        {"n_warps": 5, "max_iter": 10},
    )
)


register(
    Method(
        "tvl1_sb_alpha_ic",
        "TV-L1-SB-alpha, infimal",
        "flow in two parts of different orders, the infimal convolution: the flow chooses its order by itself",
        "fracbench.methods.infimal:tvl1_sb_alpha_ic",
        # of some it allows one value, and refuses others
        (_BREGMAN | _BEYOND | _INFIMAL | {"alpha", "boundary"})
        - {"alpha_flat", "alpha_edge", "alpha_corner", "alpha_texture", "tol", "max_inner"},
        {"alpha": 1.0, "n_warps": 5, "max_iter": 10},
    )
)


def _register_peer(name: str, label: str, summary: str, module: str) -> None:
    register(Method(name, label, summary, f"fracbench.methods.peers:{name}", frozenset(), requires=(module,)))


_register_peer("opencv_tvl1", "OpenCV DualTVL1", "OpenCV's TV-L1, defaults", "cv2")
_register_peer("opencv_tvl1_deep", "OpenCV DualTVL1 (6 scales)", "OpenCV's TV-L1, 6 scales of step .5", "cv2")
_register_peer("opencv_dis", "OpenCV DIS", "OpenCV's dense inverse search, preset medium", "cv2")
_register_peer("opencv_farneback", "OpenCV Farneback", "OpenCV's Farneback flow, defaults", "cv2")
_register_peer("skimage_tvl1", "scikit-image TV-L1", "scikit-image's TV-L1, defaults", "skimage")
_register_peer("skimage_tvl1_ipol", "scikit-image TV-L1 (IPOL)", "scikit-image's TV-L1, IPOL's weight", "skimage")
_register_peer("skimage_ilk", "scikit-image iLK", "scikit-image's iterative Lucas-Kanade, defaults", "skimage")
