"""Compile loops before they are needed, and say so."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

from fracbench.commands import console
from fracbench.errors import InputError


def warmup(names: Sequence[str]) -> None:
    """Compile all that these methods, or all of our own, call under any protocol; say where the cache is."""
    from fracbench.harness.config.compose import group_options, protocol_settings
    from fracbench.methods.registry import METHODS, get_method
    from fracbench.model.kernels.jit import cache_folder
    from fracbench.model.params import FlowParams

    started = time.perf_counter()
    methods = [get_method(name) for name in names or METHODS]
    presets = [protocol_settings(name)[1] for name in group_options("protocol")]
    loops = compile_for(
        (method.name, method.start().replace(preset))
        for method in methods
        if method.params is FlowParams
        for preset in presets
    )
    seconds = time.perf_counter() - started
    folder = cache_folder()
    if folder is None:
        raise InputError("numba has no folder for its cache: set NUMBA_CACHE_DIR to one that can be written")
    console.say(f"{loops} loops compiled in {seconds:.1f} s; the cache is in {folder}")


def compile_for(settings: Iterable[tuple[str, Any]], *, errors: bool = True) -> int:
    """Compile all that these methods call with these parameters, and say so; return the number of loops.

    Worker processes would compile the same at once. Where a method fails, its points will tell. `errors` says
    whether the errors of flows are computed as well.
    """
    import numpy as np

    from fracbench.evaluation.metrics import flow_errors
    from fracbench.methods.registry import get_method
    from fracbench.methods.warmup import on_compilation, variant, warm_up
    from fracbench.model.params import FlowParams

    loops, seen = 0, set()
    with console.compiling() as advance:

        def count() -> None:
            nonlocal loops
            loops += 1
            advance()

        for name, params in settings:
            method, chosen = get_method(name), variant(name, params)
            if chosen not in seen and isinstance(params, FlowParams):
                seen.add(chosen)
                with suppress(Exception):
                    warm_up(method, params, count)
        if seen and errors:
            with on_compilation(count):
                flow_errors(*np.zeros((2, 2, 4, 4), np.float32))
    return loops
