"""The one place that holds the options of every compiled loop."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

import fracbench
from fracbench.model.kernels.cache_stamp import add_to_stamp

F = TypeVar("F", bound=Callable[..., Any])

# Sums may be reordered so that loops vectorise, but NaN and infinity keep their meaning: a diverging
# run has to be seen, not optimised away.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}

# All files whose functions a compiled loop may call: a cached loop is valid as long as none has changed.
_MODEL = Path(fracbench.__file__).parent / "model"
_DIGEST = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(_MODEL.rglob("*.py")))).hexdigest()


def jit(function: F) -> F:
    """Compile `function` (GIL released, single-threaded; cached on disk where that is possible and safe).

    Under ``NUMBA_DISABLE_JIT=1`` it is returned as it is.
    """
    try:
        compiled = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # numba finds no folder for its cache that can be written
        compiled = None
    if compiled is None or not add_to_stamp(compiled, _DIGEST):  # no cache, rather than code that may be stale
        compiled = numba.njit(**_OPTIONS)(function)
    return compiled
