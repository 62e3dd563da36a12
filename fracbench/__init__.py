"""fracbench: fractional TV-L1 optical flow, and the harness that reproduces and checks arXiv:1512.01398."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fracbench.api import EstimatedFlow, estimate_flow
    from fracbench.clips import estimate_flows
    from fracbench.data.datasets.base import Dataset
    from fracbench.data.datasets.registry import load_sequence
    from fracbench.data.files import read_flow, write_flow
    from fracbench.data.pair import FramePair
    from fracbench.evaluation.derivatives import Derivatives, derivatives
    from fracbench.evaluation.metrics import FlowErrors, flow_errors
    from fracbench.figures.flowcolor import flow_to_color
    from fracbench.methods.method import Method
    from fracbench.model.coarse_to_fine import FlowResult
    from fracbench.model.confidence import Confidence
    from fracbench.model.params import FlowParams
    from fracbench.sweeps import sweep

__version__ = "0.1.0"
__all__ = [
    "Confidence",
    "Dataset",
    "Derivatives",
    "EstimatedFlow",
    "FlowErrors",
    "FlowParams",
    "FlowResult",
    "FramePair",
    "Method",
    "__version__",
    "derivatives",
    "estimate_flow",
    "estimate_flows",
    "flow_errors",
    "flow_to_color",
    "load_sequence",
    "read_flow",
    "sweep",
    "write_flow",
]

_HOMES = {
    "estimate_flow": "fracbench.api",
    "EstimatedFlow": "fracbench.api",
    "estimate_flows": "fracbench.clips",
    "sweep": "fracbench.sweeps",
    "derivatives": "fracbench.evaluation.derivatives",
    "Derivatives": "fracbench.evaluation.derivatives",
    "FlowResult": "fracbench.model.coarse_to_fine",
    "Confidence": "fracbench.model.confidence",
    "FlowParams": "fracbench.model.params",
    "Method": "fracbench.methods.method",
    "Dataset": "fracbench.data.datasets.base",
    "FramePair": "fracbench.data.pair",
    "load_sequence": "fracbench.data.datasets.registry",
    "read_flow": "fracbench.data.files",
    "write_flow": "fracbench.data.files",
    "flow_errors": "fracbench.evaluation.metrics",
    "FlowErrors": "fracbench.evaluation.metrics",
    "flow_to_color": "fracbench.figures.flowcolor",
}


def __getattr__(name: str) -> Any:
    # Loaded on first use: the command line answers --help without the compiler's start-up time.
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
