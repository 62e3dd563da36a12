"""Errors of a flow that matter in fluids: of its derivatives, on a grid of vectors, and by local gradient."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError
from fracbench.evaluation.derivatives import derivatives
from fracbench.evaluation.metrics import endpoint_error

#: Distance in pixels of the vectors of a cross-correlation with windows of 16 pixels that overlap by half.
GRID = 8
#: Where classes of the local gradient begin, pixels a pixel; a class ends where the next begins, the last nowhere.
GRADIENTS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4)


@dataclass(frozen=True)
class DerivativeErrors:
    """Root mean squares over the scored points, per frame; see `derivative_errors`.

    Attributes
    ----------
    vorticity, divergence : float
        Of the estimate's vorticity and divergence less the true ones.
    own_divergence, true_divergence : float
        Of the divergence of the estimate itself, and of the true flow. Where that of a velocity vanishes, that of
        its displacement d over a frame is -det(grad d), of second order.
    true_vorticity : float
        Of the vorticity of the true flow: the scale of an error.
    """

    vorticity: float
    divergence: float
    own_divergence: float
    true_vorticity: float
    true_divergence: float


def derivative_errors(flow: Any, truth: Any, spacing: float = 1.0) -> DerivativeErrors:
    """Score vorticity and divergence of a flow by central differences, the same for estimate and truth.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels, H and W at least 3; unknown where a component of the true one is
        NaN or above 1e9.
    spacing : float, optional
        Distance of neighbouring values in pixels.

    Returns
    -------
    DerivativeErrors
        Over the points within the outermost ones, which have no central difference, whose neighbours have a known
        true flow. NaN where no point is scored, or a value of the estimate that is needed is not finite.

    Raises
    ------
    InputError
        If shapes differ, or a side is shorter than 3.
    """
    if np.shape(flow) != np.shape(truth):
        raise InputError(f"the flow has the shape {np.shape(flow)}, the true flow {np.shape(truth)}")
    ours, true = (derivatives(each, spacing=spacing) for each in (flow, _known(truth)))
    inside = slice(1, -1), slice(1, -1)
    known = (np.isfinite(true.vorticity) & np.isfinite(true.divergence))[inside]

    def rms(values: NDArray[np.float64]) -> float:
        scored = values[inside][known]
        return math.sqrt(np.mean(scored**2)) if scored.size else math.nan

    return DerivativeErrors(
        rms(ours.vorticity - true.vorticity),
        rms(ours.divergence - true.divergence),
        rms(ours.divergence),
        rms(true.vorticity),
        rms(true.divergence),
    )


def grid_points(start: tuple[int, int], shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a part of a frame that are multiples of `GRID`, above 0, in the frame.

    Parameters
    ----------
    start, shape : (int, int)
        First row and column of the part, and its height and width, pixels.
    """
    first = [(GRID if at == 0 else -at % GRID) for at in start]
    return slice(first[0], shape[0], GRID), slice(first[1], shape[1], GRID)


def errors_by_gradient(flow: Any, truth: Any) -> dict[str, Mapping[str, float]]:
    """Return AEPE and number of pixels by class of the local gradient of the true flow.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels.

    Returns
    -------
    dict
        By the text of its begin in `GRADIENTS`, each class that has pixels: ``{"aepe": px, "n_pixels": count}``.
        The gradient is the Frobenius norm of the matrix of derivatives, pixels a pixel.
    """
    found = derivatives(_known(truth))
    e_xx, e_yy, e_xy = found.strain
    size = np.sqrt(e_xx**2 + e_yy**2 + 2.0 * e_xy**2 + 0.5 * found.vorticity**2)
    error = endpoint_error(flow, truth)
    classes: dict[str, Mapping[str, float]] = {}
    for low, high in zip(GRADIENTS, (*GRADIENTS[1:], math.inf), strict=True):
        scored = error[(low <= size) & (size < high)]  # false where the gradient is unknown
        if scored.size:
            classes[f"{low:g}"] = {"aepe": float(scored.mean()), "n_pixels": scored.size}
    return classes


def _known(truth: Any) -> NDArray[np.float64]:
    """Return the true flow with NaN where it is unknown."""
    values = np.asarray(truth, np.float64)
    return np.where(np.isnan(endpoint_error(np.zeros_like(values), values)), math.nan, values)
