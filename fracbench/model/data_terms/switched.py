"""Brightness constancy as other readers of the paper may compute it: gradient, interpolation and borders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fracbench.model.data_terms.brightness import Brightness, Residual, five_point_gradient
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.params import SWITCHES, FlowParams
from fracbench.model.warping import Linearization, central_gradient, cubic_weights


def switched_residual(frame0: Array, frame1: Array, params: FlowParams) -> Residual:
    """Return the data term of a scale that `params` ask for: the paper's, unless one of the switches is on."""
    names = ("gradient_of", "stencil", "warp", "outside")
    off = all(getattr(params, name) == SWITCHES[name] for name in names)
    return Brightness(frame0, frame1, params) if off else SwitchedBrightness(frame0, frame1, params)


class SwitchedBrightness(Residual):
    """The residual ``I1(x + u0) + g . (u - u0) - I0`` by the switches gradient_of, stencil, warp and outside.

    With all of them off it is that of `Brightness`, up to rounding.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._frame0, self._params = frame0, params
        self._gradient0 = image_gradient(frame0, params.stencil, params.gradient_scale)
        gradient1 = image_gradient(frame1, params.stencil, params.gradient_scale)
        self._still = self._gradient0 if params.gradient_of == "frame0" else gradient1
        self._planes = np.concatenate([frame1[None], gradient1])  # frame 1 and its gradient
        if params.gradient_of not in ("frame1", "mean"):
            self._planes = self._planes[:1]

    def at(self, u0: Array) -> Linearization:
        """Warp frame 1, take or warp the gradient; see `Residual`."""
        params, warped = self._params, np.empty_like(self._planes)
        out = np.zeros(u0.shape[1:], np.bool_)
        cubic, repeat = params.warp == "bicubic", params.outside == "repeat"
        parallel_for(lambda a, b: sample_planes(self._planes, u0, cubic, repeat, warped, out, a, b), u0.shape[1])
        if params.outside == "frame0":
            warped[0][out] = self._frame0[out]
        gradient = self._gradient(warped)
        if params.outside == "off":
            gradient = np.where(out, gradient.dtype.type(0.0), gradient)
        rho_c = warped[0] - gradient[0] * u0[0] - gradient[1] * u0[1] - self._frame0
        return Linearization(rho_c, gradient)

    def _gradient(self, warped: Array) -> Array:
        kind = self._params.gradient_of
        if kind == "warped":
            return image_gradient(warped[0], self._params.stencil, self._params.gradient_scale)
        if kind in ("frame0", "still"):
            return self._still
        if kind == "mean":
            return warped.dtype.type(0.5) * (self._gradient0 + warped[1:])
        return warped[1:]


def image_gradient(image: Array, stencil: str, scale: float = 1.0) -> Array:
    """Return `scale` times the x and y derivatives of an image (H, W), (2, H, W), borders repeated.

    Stencils: ``central`` (I(x+1) - I(x-1)) / 2, ``forward`` I(x+1) - I(x), ``backward`` I(x) - I(x-1), and
    ``five_point``, see `five_point_gradient`.
    """
    if stencil == "central":
        return central_gradient(image, scale)
    if stencil == "five_point":
        return five_point_gradient(image, scale)
    gradient = np.zeros((2, *image.shape), image.dtype)
    dx, dy = image[:, 1:] - image[:, :-1], image[1:] - image[:-1]
    if stencil == "forward":
        gradient[0, :, :-1], gradient[1, :-1] = dx, dy
    else:
        gradient[0, :, 1:], gradient[1, 1:] = dx, dy
    gradient *= image.dtype.type(scale)
    return gradient


@jit
def sample_planes(
    planes: Array,
    u0: Array,
    cubic: bool,
    repeat: bool,
    warped: Array,
    out: NDArray[np.bool_],
    start: int,
    stop: int,
) -> None:
    """Write planes (K, H, W) at ``x + u0`` to `warped`, rows ``start..stop-1``, bicubically or bilinearly.

    A pixel whose stencil, 4 x 4 or 2 x 2, leaves the image is marked in `out` and is 0, unless `repeat`: then the
    point is moved to the border, and samples beyond it are those of the border.
    """
    count, height, width = planes.shape
    low, margin = (1.0, 2.0) if cubic else (0.0, 1.0)
    real = planes.dtype.type
    wx, wy = np.zeros(4, planes.dtype), np.zeros(4, planes.dtype)
    for i in range(start, stop):
        for j in range(width):
            x, y = j + u0[0, i, j], i + u0[1, i, j]
            inside = x >= low and y >= low
            if cubic:  # the comparisons are false for NaN
                inside = inside and x < width - margin and y < height - margin
            else:
                inside = inside and x <= width - margin and y <= height - margin
            out[i, j] = not inside
            if not inside:
                if not (repeat and x == x and y == y):
                    for k in range(count):
                        warped[k, i, j] = real(0.0)
                    continue
                x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
            left, top = int(x), int(y)
            if not cubic:
                right, below = min(left + 1, width - 1), min(top + 1, height - 1)
                sx, sy = real(x - left), real(y - top)
                for k in range(count):
                    a = planes[k, top, left] + sx * (planes[k, top, right] - planes[k, top, left])
                    b = planes[k, below, left] + sx * (planes[k, below, right] - planes[k, below, left])
                    warped[k, i, j] = a + sy * (b - a)
                continue
            wx[0], wx[1], wx[2], wx[3] = cubic_weights(x - left)
            wy[0], wy[1], wy[2], wy[3] = cubic_weights(y - top)
            for k in range(count):
                total = real(0.0)
                for r in range(4):
                    row = min(max(top - 1 + r, 0), height - 1)
                    line = real(0.0)
                    for c in range(4):
                        line += wx[c] * planes[k, row, min(max(left - 1 + c, 0), width - 1)]
                    total += wy[r] * line
                warped[k, i, j] = total
