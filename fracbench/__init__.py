"""fracbench: fractional TV-L1 optical flow, and the harness that reproduces and checks arXiv:1512.01398."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fracbench.api import estimate_flow
    from fracbench.clips import estimate_flows
    from fracbench.data.datasets.base import Dataset
    from fracbench.data.pair import FramePair
    from fracbench.methods.method import Method
    from fracbench.model.coarse_to_fine import FlowResult
    from fracbench.model.confidence import Confidence
    from fracbench.model.params import FlowParams

__version__ = "0.1.0"
__all__ = [
    "Confidence",
    "Dataset",
    "FlowParams",
    "FlowResult",
    "FramePair",
    "Method",
    "__version__",
    "estimate_flow",
    "estimate_flows",
]

_HOMES = {
    "estimate_flow": "fracbench.api",
    "estimate_flows": "fracbench.clips",
    "FlowResult": "fracbench.model.coarse_to_fine",
    "Confidence": "fracbench.model.confidence",
    "FlowParams": "fracbench.model.params",
    "Method": "fracbench.methods.method",
    "Dataset": "fracbench.data.datasets.base",
    "FramePair": "fracbench.data.pair",
}


def __getattr__(name: str) -> Any:
    # Loaded on first use: the command line answers --help without the compiler's start-up time.
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
