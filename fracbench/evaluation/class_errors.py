"""Errors of a flow within classes of pixels."""

from __future__ import annotations

from collections.abc import Mapping
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
    if np.shape(classes) != np.shape(truth)[1:]:
        raise InputError(f"the classes have the shape {np.shape(classes)}, the flow {np.shape(truth)[1:]}")
    return errors_by_mask(flow, truth, {name: np.asarray(classes) == index for index, name in enumerate(CLASSES)})


def errors_by_mask(flow: Any, truth: Any, masks: Mapping[str, Any]) -> dict[str, FlowErrors]:
    """Return the errors of a flow by mask (bool, (H, W)), for the masks with pixels of known true flow."""
    known = np.isfinite(endpoint_error(np.zeros_like(truth), truth))
    return {name: flow_errors(flow, truth, mask) for name, mask in masks.items() if (mask & known).any()}
