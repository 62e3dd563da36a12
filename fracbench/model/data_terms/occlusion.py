"""Visibility of each pixel in both frames, and a data term weighted by it."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from fracbench.model.data_terms.brightness import Brightness, Residual
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization


class Visibility:
    """How likely each pixel of a scale is seen in both frames; see `visibility`.

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
        return visibility(flow, difference)


class OcclusionWeighted:
    """A data term weighted by visibility w at each pixel, ``lambda |w rho|``.

    The v-steps need not know w. Before there is a flow, on the coarsest scale, w = 1: moving objects differ
    between the frames and would be taken for occluded.

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
        """Weigh the residual and its gradient by visibility at `u0`; see `data_terms.brightness.Residual`."""
        linear = self._data.at(u0)
        if u0.any():
            weights = self._visibility.of(u0)
            linear.rho_c[...] *= weights
            linear.gradient[...] *= weights
        return linear


#: Standard deviations of visibility: divergence of the flow, and residual in gray levels (Sand and Teller 2008).
DIVERGENCE, RESIDUAL = 0.3, 20.0


def visibility(flow: Array, residual: Array) -> Array:
    """Return how likely each pixel is seen in frame 1 as well: 1 where flow and frames agree.

    ``exp(-min(0, div u)^2 / (2 s_d^2) - residual^2 / (2 s_r^2))``: flow converges where one surface covers
    another.

    Parameters
    ----------
    flow : ndarray, shape (2, H, W)
        Flow.
    residual : ndarray, shape (H, W)
        ``I1(x + u) - I0(x)``, gray levels.

    Returns
    -------
    ndarray, shape (H, W)
        In (0, 1].
    """
    converging = np.minimum(slope(flow[0], 1) + slope(flow[1], 0), 0.0)
    exponent = converging**2 / (2.0 * DIVERGENCE**2) + residual**2 / (2.0 * RESIDUAL**2)
    return np.exp(-exponent).astype(flow.dtype)


def slope(image: Array, axis: int) -> Array:
    """Return central differences along an axis, borders repeated."""
    return scipy.ndimage.correlate1d(image, [-0.5, 0.0, 0.5], axis, mode="nearest")
