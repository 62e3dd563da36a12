"""Memory: the peak of this process, where the system tells it, and of a call's arrays; and what is given back."""

from __future__ import annotations

import ctypes
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt
_LARGE = 2**22

_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


def reset_peak() -> None:
    """Forget the peak so far (Linux); elsewhere the peak is that of the whole process."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return


def peak_mib() -> float | None:
    """Return the largest resident memory since `reset_peak`, MiB.

    Returns
    -------
    float or None
        None where the system does not tell.
    """
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    except OSError:
        pass
    try:
        import resource
        import sys
    except ImportError:
        return None
    peak = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peak / 1024.0**2 if sys.platform == "darwin" else peak / 1024.0


def return_what_is_freed() -> None:
    """Let this process give large arrays back to the system as they are freed (glibc; nothing elsewhere).

    Else glibc keeps what coarser scales have freed, in pieces too small for the next, which adds a tenth to the
    peak of a flow. The room of smaller ones it keeps: a page that is given back and taken again costs more than
    what is computed on it.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library, another system
        for threshold in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
            ctypes.CDLL(None).mallopt(threshold, _LARGE)


def array_bytes(work: Callable[[], object]) -> int:
    """Call `work` and return the most that its arrays took at once, bytes.

    It is what Python and NumPy ask for: the same on every system, without what the system's allocator wastes.

    Parameters
    ----------
    work : callable
        What to measure; it runs slower.
    """
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
