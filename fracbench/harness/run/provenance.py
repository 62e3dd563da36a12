"""The origin of a result (machine, versions, commit) and the memory that its computation took."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

from fracbench import __version__
from fracbench.harness.config.paths import checkout

_PACKAGES = ("numpy", "scipy", "numba")
_PEERS = ("opencv-contrib-python-headless", "opencv-python", "scikit-image")


@lru_cache(maxsize=1)
def machine() -> dict[str, Any]:
    """Return the machine and the versions at work in this process."""
    return {
        "host": platform.node(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Return the versions of this package, of those its numbers depend on, and of the peers that are there."""
    found = {"fracbench": __version__}
    for name in (*_PACKAGES, *_PEERS):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            if name in _PACKAGES:
                found[name] = "not installed"
    return found


@lru_cache(maxsize=1)
def commit() -> dict[str, Any]:
    """Return the commit of the checkout (None outside one) and whether its tracked files differ from it."""
    root = checkout()
    if root is None:
        return {"commit": None, "dirty": None}
    try:
        revision = git(root, "rev-parse", "HEAD")
        return {"commit": revision, "dirty": bool(git(root, "status", "--porcelain", "--untracked-files=no"))}
    except (OSError, subprocess.SubprocessError):
        return {"commit": None, "dirty": None}


def git(root: Path, *arguments: str) -> str:
    """Return the output of a git command in a checkout; an error if it fails or takes longer than 10 s."""
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


def reset_peak() -> None:
    """Forget the peak so far (Linux); elsewhere the peak is that of the whole process."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return


def peak_mib() -> float | None:
    """Return the largest resident memory since `reset_peak`, MiB; None where the system does not tell."""
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
