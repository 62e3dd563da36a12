"""Peak memory: of this process, where the system tells it, and of the arrays that a call makes."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

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
