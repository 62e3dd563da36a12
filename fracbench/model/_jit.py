"""The one place that holds the options of every compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

# Sums may be reordered so that loops vectorise, but NaN and infinity keep their meaning: a diverging
# run has to be seen, not optimised away.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


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
    return compiled
