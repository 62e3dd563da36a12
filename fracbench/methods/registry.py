"""The one registry of methods: name -> what it depends on, and where its code is.

The module itself imports no numerics: planning a sweep needs names and parameters only.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fracbench.errors import unknown_name
from fracbench.model.params import FlowParams

_PYRAMID = frozenset(FlowParams.names()) - {
    "alpha", "boundary", "pad", "tau", "lambda_sb", "u_solver", "inner", "tol", "max_inner", "coupling",
    "coupling_step", "relaxation"
}  # fmt: skip
_BREGMAN = frozenset(FlowParams.names()) - {"alpha", "boundary", "pad", "tau"}


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
    """

    name: str
    label: str
    summary: str
    home: str
    uses: frozenset[str]
    defaults: Mapping[str, Any] = field(default_factory=dict)

    @property
    def estimate(self) -> Callable[..., Any]:
        """The function itself, imported when asked for."""
        module, _, function = self.home.partition(":")
        estimate: Callable[..., Any] = getattr(importlib.import_module(module), function)
        return estimate


METHODS: dict[str, Method] = {}


def register(method: Method) -> Method:
    """Add a method to the registry; a later one replaces an earlier one of the same name.

    Parameters
    ----------
    method : Method
        The method.

    Returns
    -------
    Method
        The same.
    """
    METHODS[method.name] = method
    return method


def get_method(name: str) -> Method:
    """Return a method by name.

    Parameters
    ----------
    name : str
        Key in the registry.

    Returns
    -------
    Method
        The method.

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
        "fracbench.methods.variational:tvl1",
        _PYRAMID | {"tau"},
    )
)
register(
    Method(
        "tvl1_sb",
        "TV-L1-SB",
        "split Bregman with forward differences, no flux through the border (Algorithms 1-3)",
        "fracbench.methods.variational:tvl1_sb",
        _BREGMAN,
        {"u_solver": "gauss_seidel", "inner": "cold", "coupling": "penalty"},
    )
)
register(
    Method(
        "tvl1_sb_alpha",
        "TV-L1-SB-alpha",
        "split Bregman with the fractional gradient (Algorithms 1, 2, 4)",
        "fracbench.methods.variational:tvl1_sb_alpha",
        _BREGMAN | {"alpha", "boundary", "pad"},
    )
)
