"""What goes beyond the paper at each scale: edge weights, gradient constancy, filters of the flow after each warp.

Every part is off at its parameter's default, and then the numbers are those of the plain method, bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracbench.errors import InputError
from fracbench.model import median
from fracbench.model.arrays import Array
from fracbench.model.channels import ChannelStep, ImageAndGradient, TwoSided
from fracbench.model.params import FlowParams
from fracbench.model.solver import Brightness, Residual, VStep
from fracbench.model.threads import share


def edge_weights(image: Array, decay: float, power: float) -> Array:
    """Return ``exp(-k |grad I|^b)`` over its mean: where the image has an edge the flow may have one.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Frame 0, gray levels.
    decay : float
        k; 0 makes all weights 1.
    power : float
        b.

    Returns
    -------
    ndarray, shape (H, W)
        Positive, of mean 1, so that the balance with the data term stays.
    """
    steepness = np.hypot(median.slope(image, 0), median.slope(image, 1))
    weights = np.exp(-decay * steepness**power)
    return weights / weights.mean(dtype=np.float64).astype(image.dtype)


def residual(frame0: Array, frame1: Array, params: FlowParams) -> Residual:
    """Return the data of a scale that `params` ask for."""
    if params.lambda_gradient:
        return ImageAndGradient(frame0, frame1, params)
    return (TwoSided if params.derivatives == "both" else Brightness)(frame0, frame1, params)


def channel_step(like: Array, params: FlowParams) -> VStep | None:
    """Return the v-step for more data than brightness, or None if `params` ask for none.

    Raises
    ------
    InputError
        With the penalty coupling, which has no such step.
    """
    if not params.lambda_gradient:
        return None
    if params.coupling != "multiplier":
        raise InputError(f"`lambda_gradient` needs coupling=multiplier, got {params.coupling}")
    return ChannelStep(like, params)


def refiner(frame0: Array, frame1: Array, params: FlowParams) -> Callable[[Array], Array] | None:
    """Return the filter of the flow that `params` ask for, or None."""
    wanted = params.median_radius or params.weighted_radius
    return FlowFilter(frame0, frame1, params) if wanted else None


class FlowFilter:
    """The median filters of `fracbench.model.median`, one after the other, for the flow of a scale.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at the scale.
    params : FlowParams
        Radii of the windows, 0 for none.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._guide = frame0
        self._data = Brightness(frame0, frame1, params)
        self._radius, self._weighted = params.median_radius, params.weighted_radius

    def __call__(self, flow: Array) -> Array:
        """Return the filtered flow, a new array of shape (2, H, W)."""
        plain = median.median(flow, 2 * self._radius + 1)
        if not self._weighted:
            return plain
        linear = self._data.at(flow)
        difference = linear.rho_c + (linear.gradient * flow).sum(axis=0)
        trust = median.visibility(flow, difference)
        near = median.motion_edges(plain)
        arrays = flow, self._guide, trust, near, self._weighted, plain
        share(lambda a, b: median.weighted_median(*arrays, a, b), len(near))
        return plain
