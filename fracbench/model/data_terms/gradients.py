"""Gradient constancy beside brightness constancy, for robustness against changes of illumination."""

from __future__ import annotations

import numpy as np

from fracbench.model.data_terms.brightness import Brightness, Residual, TwoSided
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization, central_gradient


class ImageAndGradient(Residual):
    """The residuals of the frames of a scale and of their two derivatives: arrays with three channels first."""

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        derivatives = zip(central_gradient(frame0), central_gradient(frame1), strict=True)
        channel = TwoSided if params.derivatives == "both" else Brightness
        self._channels = [channel(*pair, params) for pair in [(frame0, frame1), *derivatives]]
        shape = len(self._channels), *frame0.shape
        rho_c, gradient = np.empty(shape, frame0.dtype), np.empty((shape[0], 2, *frame0.shape), frame0.dtype)
        self._linear = Linearization(rho_c, gradient)

    def at(self, u0: Array) -> Linearization:
        """Linearise each channel; see `Residual`."""
        for k, channel in enumerate(self._channels):
            self._linear.rho_c[k], self._linear.gradient[k] = channel.at(u0)
        return self._linear
