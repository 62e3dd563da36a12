"""Where a result comes from: machine, versions, commit."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

from fracbench.harness.assets import checkout

_PACKAGES = ("fracbench", "numpy", "scipy", "numba")


@lru_cache(maxsize=1)
def machine() -> dict[str, Any]:
    """Return what is known of the machine and the versions at work in this process.

    Returns
    -------
    dict
        ``host``, ``cpu``, ``cores``, ``python``, ``versions``.
    """
    return {
        "host": platform.node(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Return the versions of this package and of those its numbers depend on."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


@lru_cache(maxsize=1)
def commit() -> dict[str, Any]:
    """Return the commit of the checkout and whether its tracked files differ from it.

    Returns
    -------
    dict
        ``commit`` (None outside a checkout) and ``dirty``.
    """
    root = checkout()
    if root is None:
        return {"commit": None, "dirty": None}
    try:
        revision = _git(root, "rev-parse", "HEAD")
        return {"commit": revision, "dirty": bool(_git(root, "status", "--porcelain", "--untracked-files=no"))}
    except (OSError, subprocess.SubprocessError):
        return {"commit": None, "dirty": None}


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
