"""Brightness constancy: the difference of brightness between the frames, linearised at a flow."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.ndimage

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization, central_gradient, interleave, linearize


class Residual(Protocol):
    """The interface of the data term at a scale: the residual, linearised at a flow."""

    def at(self, u0: Array) -> Linearization:
        """Return the residual linearised at `u0`, (2, H, W); the next call overwrites it."""


class Brightness(Residual):
    """The paper's residual, with central differences of frame 1; the frames are those of a scale, 0..255."""

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._frame0 = frame0
        self._samples1 = interleave(frame1, self.differentiate(frame1, params.gradient_scale))
        self._linear = Linearization(np.empty_like(frame0), np.empty((2, *frame0.shape), frame0.dtype))

    def differentiate(self, frame: Array, scale: float) -> Array:
        """Return the derivatives of a frame, (2, H, W), times `scale`."""
        return central_gradient(frame, scale)

    def at(self, u0: Array) -> Linearization:
        """Warp frame 1 and its gradient; see `Residual`."""
        arrays = self._frame0, self._samples1, u0, *self._linear
        parallel_for(lambda a, b: linearize(*arrays, a, b), u0.shape[1])
        return self._linear


class TwoSided(Brightness):
    """The difference of brightness, linearised with the mean of both frames' five-point derivatives.

    Where the flow is right, ``grad I0(x) = grad I1(x + u)``, and the mean of the two has less noise than either.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        super().__init__(frame0, frame1, params)
        self._gradient0 = self.differentiate(frame0, params.gradient_scale)

    def differentiate(self, frame: Array, scale: float) -> Array:
        """Return the derivatives of a frame; see `Brightness`."""
        return five_point_gradient(frame, scale)

    def at(self, u0: Array) -> Linearization:
        """Average the gradients of both frames; see `Residual`."""
        linear = super().at(u0)
        parallel_for(lambda a, b: average_gradients(self._gradient0, u0, *linear, a, b), u0.shape[1])
        return linear


def five_point_gradient(image: Array, scale: float = 1.0) -> Array:
    """Return `scale` times the x and y derivatives of an image (H, W): shape (2, H, W), in its precision.

    The stencil is (1, -8, 0, 8, -1) / 12, of fourth order; borders are repeated.
    """
    stencil = scale * np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
    return np.stack([scipy.ndimage.correlate1d(image, stencil, axis, mode="nearest") for axis in (1, 0)])


@jit
def average_gradients(gradient0: Array, u0: Array, rho_c: Array, gradient: Array, start: int, stop: int) -> None:
    """Replace the gradient of a linearisation at `u0` by its mean with that of frame 0, in rows `start` to `stop`.

    The residual at `u0` stays. Pixels without data, at which `linearize` has set the gradient to 0, stay too.
    """
    for i in range(start, stop):
        for j in range(rho_c.shape[1]):
            if gradient[0, i, j] == 0.0 and gradient[1, i, j] == 0.0:
                continue
            for c in range(2):
                change = 0.5 * (gradient0[c, i, j] - gradient[c, i, j])
                gradient[c, i, j] += change
                rho_c[i, j] -= change * u0[c, i, j]
