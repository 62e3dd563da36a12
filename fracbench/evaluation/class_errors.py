"""Errors of a flow within each class of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from fracbench.errors import InputError
from fracbench.evaluation.metrics import FlowErrors, endpoint_error, flow_errors
from fracbench.model.structure import CLASSES


def errors_by_class(flow: Any, truth: Any, classes: Any) -> dict[str, FlowErrors]:
    """Return the errors of a flow by class of pixels, for the classes with pixels of known true flow.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels; see `fracbench.evaluation.metrics.flow_errors`.
    classes : array_like of integers, (H, W)
        From `fracbench.model.structure.structure_classes`.
    """
    known = np.isfinite(endpoint_error(np.zeros_like(truth), truth))
    if np.shape(classes) != known.shape:
        raise InputError(f"the classes have the shape {np.shape(classes)}, the flow {known.shape}")
    masks = {name: np.asarray(classes) == index for index, name in enumerate(CLASSES)}
    return {name: flow_errors(flow, truth, mask) for name, mask in masks.items() if (mask & known).any()}
