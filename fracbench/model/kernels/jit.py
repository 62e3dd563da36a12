"""The one place that holds the options of every compiled loop."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

import fracbench

F = TypeVar("F", bound=Callable[..., Any])

# Sums may be reordered so that loops vectorise, but NaN and infinity keep their meaning: a diverging
# run has to be seen, not optimised away.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}

#: Of all files whose functions a compiled loop may call.
_MODEL = Path(fracbench.__file__).parent / "model"
_SOURCES = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(_MODEL.rglob("*.py"))))


def jit(function: F) -> F:
    """Compile `function` (cached on disk, GIL released, single-threaded).

    Parameters
    ----------
    function : callable
        A loop over arrays in the subset of Python that numba compiles.

    Returns
    -------
    callable
        The compiled function; `function` itself under ``NUMBA_DISABLE_JIT=1``.
    """
    compiled: F = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH)(function)  # type: ignore[assignment]
    # Numba takes a cached function for valid as long as its own file has not changed, but the functions that it
    # calls are compiled into it, and some stand in other files.
    cache = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache is not None:
        cache._source_stamp = cache._source_stamp, _SOURCES.hexdigest()
    return compiled
