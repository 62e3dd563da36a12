"""Compile all that a method calls before anything is timed, in two processes where nothing is cached yet.

As a script, ``python -m fracbench.methods.warmup METHOD PARAMS``, it is the second of them: it compiles the loops
that take longest and are needed last. The first process then loads them from numba's cache.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from typing import Any

import numpy as np
from numba import config
from numba.core import event  # documented for applications ("Event API"), although it is below `core`

from fracbench.methods.method import Method, fields_of
from fracbench.model.kernels import pointwise, simd
from fracbench.model.kernels.jit import cache_folder
from fracbench.model.params import FlowParams

#: Under `zero`, lines of the first scale are long, and those of the second short (`operators.zero.LEAST_SUMMED`).
SIDE = 72


def variant(name: str, params: Any) -> tuple[str | bool, ...]:
    """Return the method and the parameters that tell which functions are called: words, and numbers that are 0."""
    return name, *(value if isinstance(value, str) else bool(value) for value in fields_of(params).values())


def warm_up(
    method: Method, params: Any, on_loop: Callable[[], object] = lambda: None, *, alone: bool = False
) -> None:
    """Compile, or load from numba's cache, all that a method calls: `alone`, or with a second process.

    `on_loop` is called as each loop is compiled.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    frame0, frame1 = np.random.default_rng(0).uniform(0.0, 255.0, (2, SIDE, SIDE)).astype(np.float32)
    if not isinstance(params, FlowParams):
        with suppress(Exception):  # frames so small may be refused by a method that can do with larger ones
            method.compute(frame0, frame1, params)
        return
    scales = 2 if params.n_scales is None else min(params.n_scales, 2)
    small = params.replace({"n_scales": scales, "n_warps": 1, "max_iter": 2, "max_inner": 2})
    cores: int = config.NUMBA_DEFAULT_NUM_THREADS  # type: ignore[attr-defined]
    helps = not alone and cores > 1 and cache_folder() is not None and _leads(method.name, params) is not None
    helpers: list[subprocess.Popen[bytes]] = []

    def begin() -> None:
        if helps and not helpers:
            words = [sys.executable, "-m", __name__, method.name, json.dumps(params.as_dict())]
            helpers.append(subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        on_loop()

    try:
        with on_compilation(begin):
            # the thresholds of these two vary from pixel to pixel, and are of another type
            if helps and method.name not in ("tvl1_sb_alpha_map", "tvl1_sb_alpha_ic"):
                _call_steps(np.dtype(params.dtype))
            color: dict[str, Any] = {"color": np.stack([frame0] * 3, axis=-1)} if "color" in method.options else {}
            method.compute(frame0, frame1, small, **color)
    finally:
        for helper in helpers:  # anything that it has not finished has been compiled here
            helper.kill()
            helper.wait()


def _leads(name: str, params: FlowParams) -> Callable[[], None] | None:
    """Return a function that calls the loops which a second process compiles, if there are any worth it."""
    named = ("tvl1_sb", "tvl1_sb_alpha", "tvl1_sb_alpha_map", "tvl1_sb_alpha_ic")
    exact = name in named and params.u_solver == "exact"
    if not (exact and simd.AVAILABLE):
        return None
    if name == "tvl1_sb_alpha" and params.boundary == "zero":
        return None if params.pad else lambda: _call_zero(params)
    return lambda: _call_transform(np.dtype(params.dtype))


def _call_steps(dtype: np.dtype) -> None:
    """Call the loops that follow the transforms, so that the second process is further when those are needed."""
    z, w = np.zeros((2, 1, 2, SIDE, SIDE), dtype)
    pointwise.shrink_difference(z, 1.0, w, 0, SIDE)
    pointwise.bregman_update(w, 1.0, 1.0, z, 0, SIDE)
    pointwise.mean_squared_change(z[0], w[0])


def _call_zero(params: FlowParams) -> None:
    from fracbench.model.operators.zero import ZeroGradient

    for side in (SIDE, SIDE // 2):
        operator = ZeroGradient(params.alpha, (side, side), np.dtype(params.dtype))
        u, w = np.zeros((side, side), params.dtype), np.zeros(operator.range_shape, params.dtype)
        operator.differentiate(u, w)
        operator.solve(u.copy(), w, 1.0, 1.0, operator.factor(1.0, 1.0), u)


def _call_transform(dtype: np.dtype) -> None:
    from fracbench.model.kernels.cosine import cosine_back
    from fracbench.model.kernels.fft import fourier, line_plan

    x, plan = np.zeros((SIDE, SIDE), dtype), line_plan(SIDE, dtype)
    fourier(np.zeros((2 * SIDE, simd.LANES), dtype), 0, plan)  # first, as both transforms wait for it
    cosine_back(x, 0, 0, SIDE, np.ones(SIDE, dtype), plan, x)
    pointwise.add_and_divide(x, x, np.ones(SIDE), np.ones(SIDE), 0, SIDE)


def on_compilation(call: Callable[[], None]) -> AbstractContextManager[object]:
    """Call a function each time that numba begins to compile one within a ``with`` block."""

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            call()

        def on_end(self, event: Any) -> None:
            pass

    return event.install_listener("numba:compile", Listener())


def main(argv: Sequence[str]) -> None:
    """Compile what leads; see `warm_up`."""
    name, values = argv
    leads = _leads(name, FlowParams().replace(json.loads(values)))
    if leads is not None:
        leads()


if __name__ == "__main__":
    main(sys.argv[1:])
