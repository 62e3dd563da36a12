"""Visibility of each pixel in both frames, and a data term weighted by it."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from fracbench.model.data_terms.brightness import Brightness, Residual
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization

#: Standard deviations of visibility: divergence of the flow, and residual in gray levels (Sand and Teller 2008).
DIVERGENCE, RESIDUAL = 0.3, 20.0


class Visibility:
    """The weights `visibility` of the pixels of a scale, for any flow between its frames."""

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._data = Brightness(frame0, frame1, params)

    def of(self, flow: Array) -> Array:
        """Return the weights for a flow (2, H, W): in (0, 1], shape (H, W)."""
        linear = self._data.at(flow)
        difference = linear.rho_c + (linear.gradient * flow).sum(axis=0)
        return visibility(flow, difference)


class OcclusionWeighted(Residual):
    """A data term weighted by visibility w at each pixel, ``lambda |w rho|``.

    The v-steps need not know w. Before there is a flow, on the coarsest scale, w = 1: moving objects differ
    between the frames and would be taken for occluded.
    """

    def __init__(self, data: Residual, visibility: Visibility) -> None:
        self._data, self._visibility = data, visibility

    def at(self, u0: Array) -> Linearization:
        """Multiply the residual and its gradient by the visibility at `u0`; see `Residual`."""
        linear = self._data.at(u0)
        if u0.any():
            weights = self._visibility.of(u0)
            linear.rho_c[...] *= weights
            linear.gradient[...] *= weights
        return linear


def visibility(flow: Array, residual: Array) -> Array:
    """Return a weight in (0, 1] at each pixel: 1 where flow and frames agree, near 0 where it is hidden.

    ``exp(-min(0, div u)^2 / (2 s_d^2) - residual^2 / (2 s_r^2))``: flow converges where one surface covers
    another.

    Parameters
    ----------
    flow : ndarray, shape (2, H, W)
    residual : ndarray, shape (H, W)
        ``I1(x + u) - I0(x)``, gray levels.
    """
    converging = np.minimum(slope(flow[0], 1) + slope(flow[1], 0), 0.0)
    exponent = converging**2 / (2.0 * DIVERGENCE**2) + residual**2 / (2.0 * RESIDUAL**2)
    return np.exp(-exponent).astype(flow.dtype)


def slope(image: Array, axis: int) -> Array:
    """Return central differences along an axis, borders repeated."""
    return scipy.ndimage.correlate1d(image, [-0.5, 0.0, 0.5], axis, mode="nearest")
