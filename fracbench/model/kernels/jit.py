"""The one place that holds the options of every compiled loop."""

from __future__ import annotations

import hashlib
import logging
import os
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

_folders: set[str] = set()
_uncached = False


def jit(function: F) -> F:
    """Compile `function` (GIL released, single-threaded; cached on disk where that is possible and safe).

    Under ``NUMBA_DISABLE_JIT=1`` it is returned as it is.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    try:
        compiled = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # numba finds no folder for its cache that can be written
        compiled = None
        _warn_once("numba finds no folder for its cache; set NUMBA_CACHE_DIR to one that can be written")
    if compiled is not None and not add_to_stamp(compiled, _DIGEST):  # rather than code that may be stale
        compiled = None
        _warn_once("this numba hides the stamp of its cache")
    if compiled is None:
        return numba.njit(**_OPTIONS)(function)
    _folders.add(compiled.stats.cache_path)
    return compiled


def cache_folder() -> str | None:
    """Return the folder below which numba caches the loops that were imported; None if it caches none."""
    return os.path.commonpath(_folders) if _folders and not _uncached else None


def _warn_once(reason: str) -> None:
    global _uncached
    if not _uncached:
        logging.getLogger("fracbench").warning("loops are compiled anew in every process: %s", reason)
    _uncached = True
