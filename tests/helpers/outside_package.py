"""A package of somebody else, as pip leaves it: modules beside a ``.dist-info`` with entry points."""

from __future__ import annotations

import sys
from pathlib import Path

from fracbench import entry_points
from fracbench.harness.run import plan

#: A method whose flow is one motion for all pixels.
SOURCE = """
from dataclasses import dataclass

import numpy as np

from fracbench import FlowResult, Method


@dataclass(frozen=True, slots=True)
class Params:
    strength: float = 1.0
    direction: str | None = None

    def __post_init__(self):
        if self.strength > 100:
            raise ValueError(f"strength {self.strength:g} is\\nmore than 100")


def estimate(frame0, frame1, params):
    assert frame0.dtype == frame1.dtype == np.float32 and frame0.ndim == 2
    frame0[:] = 0  # a copy: this harms nobody
    flow = np.full((2, *frame1.shape), 0.25 * params.strength)
    return flow if params.direction is None else FlowResult(flow, "x", None, notices=[f"goes {params.direction}"])


METHOD = Method("my_flow", "My flow", "one motion for all", estimate, params=Params, version="1")
"""


def write_package(
    folder: Path,
    source: str = SOURCE,
    *,
    module: str = "my_package",
    entries: str = "my_flow = my_package:METHOD",
    release: str = "1.0",
) -> Path:
    """Write a package, as it would be in ``site-packages``, and return the folder for ``PYTHONPATH``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{module}.py").write_text(source)
    name = module.replace("_", "-")
    info = folder / f"{module}-{release}.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {release}\n")
    (info / "entry_points.txt").write_text(f"[fracbench.methods]\n{entries}\n")
    return folder


def forget() -> None:
    """Let this process look for packages again."""
    entry_points._warn_once.cache_clear()
    plan._chosen.cache_clear()
    for module in ("my_package", "your_package"):
        sys.modules.pop(module, None)
