"""What goes beyond the paper at each scale: edge weights, other data, filters of the flow after each warp.

Every part is off at its parameter's default, and then the numbers are those of the plain method, bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracbench.errors import InputError
from fracbench.model import flow_filters as median
from fracbench.model import pyramid
from fracbench.model.data_terms.gradients import ChannelStep, ImageAndGradient, TwoSided
from fracbench.model.data_terms.texture import textures
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.threads import share
from fracbench.model.params import FlowParams
from fracbench.model.single_level import Brightness, Residual, VStep
from fracbench.model.warping import Linearization


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


def data(frame0: Array, frame1: Array, params: FlowParams) -> Callable[[Array, Array, FlowParams], Residual]:
    """Return what gives the data of each scale that `params` ask for, from both frames there.

    Textures are taken at full resolution and follow the frames down the pyramid (Wedel et al. 2009): a coarse
    scale's own would lack what long motions are found by.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames as they came; what is seen in both is told by them, not by their textures.
    params : FlowParams
        Parameters.
    """
    if not params.texture:
        return residual
    pair = textures(*pyramid.stretch(frame0, frame1, np.dtype(params.dtype)), params.texture)
    shapes = pyramid.scale_shapes(frame0.shape, params.eta, params.n_scales)
    scales = [pyramid.build(pyramid.smooth(t, params.presmoothing), shapes, params.eta) for t in pair]
    by_shape = dict(zip(shapes, zip(*scales, strict=True), strict=True))
    return lambda frame0, frame1, params: residual(frame0, frame1, params, by_shape[frame0.shape])


def residual(
    frame0: Array, frame1: Array, params: FlowParams, images: tuple[Array, Array] | None = None
) -> Residual:
    """Return the data of a scale that `params` ask for: of the frames, or of `images` in their place."""
    plain = TwoSided if params.derivatives == "both" else Brightness
    kind = ImageAndGradient if params.lambda_gradient else plain
    found: Residual = kind(*(images or (frame0, frame1)), params)
    return SeenInBoth(found, Visibility(frame0, frame1, params)) if params.occlusion == "both" else found


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


class Visibility:
    """How likely each pixel of a scale is seen in both frames; see `fracbench.model.flow_filters.visibility`.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at the scale.
    params : FlowParams
        Factor on the image gradient.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._data = Brightness(frame0, frame1, params)

    def of(self, flow: Array) -> Array:
        """Return weights in (0, 1], shape (H, W), by a flow (2, H, W)."""
        linear = self._data.at(flow)
        difference = linear.rho_c + (linear.gradient * flow).sum(axis=0)
        return median.visibility(flow, difference)


class SeenInBoth:
    """Data that count as much as they are seen in both frames: lambda times visibility, at each pixel.

    ``lambda |w rho|`` is the term, so that the v-steps know nothing of w. Where there is no flow yet, on the
    coarsest scale, all is taken to be seen: what moves differs between the frames and would be silenced.

    Parameters
    ----------
    data : Residual
        The data.
    visibility : Visibility
        Of the scale.
    """

    def __init__(self, data: Residual, visibility: Visibility) -> None:
        self._data, self._visibility = data, visibility

    def at(self, u0: Array) -> Linearization:
        """Weigh the residual and its gradient by visibility at `u0`; see `single_level.Residual`."""
        linear = self._data.at(u0)
        if u0.any():
            weights = self._visibility.of(u0)
            linear.rho_c[...] *= weights
            linear.gradient[...] *= weights
        return linear


class FlowFilter:
    """The median filters of `fracbench.model.flow_filters`, one after the other, for the flow of a scale.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at the scale.
    params : FlowParams
        Radii of the windows, 0 for none, and whether neighbours that are hidden count less.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._guide = frame0
        self._visibility = Visibility(frame0, frame1, params) if params.occlusion != "none" else None
        self._radius, self._weighted = params.median_radius, params.weighted_radius

    def __call__(self, flow: Array) -> Array:
        """Return the filtered flow, a new array of shape (2, H, W)."""
        plain = median.median(flow, 2 * self._radius + 1)
        if not self._weighted:
            return plain
        trust = np.ones_like(flow[0]) if self._visibility is None else self._visibility.of(flow)
        near = median.motion_edges(plain)
        arrays = flow, self._guide, trust, near, self._weighted, plain
        share(lambda a, b: median.weighted_median(*arrays, a, b), len(near))
        return plain
