"""Bicubic sampling, and the linearisation of the brightness residual at a flow u0."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import AVAILABLE, LANES, load, store


class Linearization(NamedTuple):
    """The residual ``rho(v) = rho_c + gradient . v`` of equation (rho).

    Attributes
    ----------
    rho_c : ndarray, shape (H, W)
        ``I1(x + u0) - grad I1(x + u0) . u0 - I0(x)``, gray levels.
    gradient : ndarray, shape (2, H, W)
        ``grad I1(x + u0)``, gray levels per pixel.
    """

    rho_c: Array
    gradient: Array


def around(u0: Array, linear: Linearization) -> Linearization:
    """Return ``I1(x + u0) + grad I1(x + u0) . w - I0``: the residual of ``u0 + w`` as a function of w."""
    return Linearization(linear.rho_c + linear.gradient[0] * u0[0] + linear.gradient[1] * u0[1], linear.gradient)


def central_gradient(image: Array, scale: float = 1.0) -> Array:
    """Return `scale` times the central differences of an image (H, W) in x and y, (2, H, W); Neumann borders."""
    padded = np.pad(image, 1, mode="edge")
    half = image.dtype.type(0.5 * scale)
    gradient = np.empty((2, *image.shape), image.dtype)
    np.subtract(padded[1:-1, 2:], padded[1:-1, :-2], out=gradient[0])
    np.subtract(padded[2:, 1:-1], padded[:-2, 1:-1], out=gradient[1])
    gradient *= half
    return gradient


@jit
def cubic_weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of Keys' cubic (a = -1/2) for the samples at -1, 0, 1, 2 and a point `t` in [0, 1)."""
    t2 = t * t
    t3 = t2 * t
    return (
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (-t2 + t3),
    )


@jit
def interleave(image: Array, gradient: Array) -> Array:
    """Return an image (H, W) and its gradient (2, H, W) with a pixel's three numbers side by side: (H, 3 W)."""
    height, width = image.shape
    samples = np.empty((height, 3 * width), image.dtype)
    for i in range(height):
        for j in range(width):
            samples[i, 3 * j] = image[i, j]
            samples[i, 3 * j + 1] = gradient[0, i, j]
            samples[i, 3 * j + 2] = gradient[1, i, j]
    return samples


@jit
def linearize(
    frame0: Array, samples1: Array, u0: Array, rho_c: Array, gradient: Array, start: int, stop: int
) -> None:
    """Write the `Linearization` at the flow `u0`, (2, H, W), to rows `start` to `stop` of `rho_c` and `gradient`.

    Frame 1 and its gradient, `samples1`, come from `interleave`: the four pixels of a row of a stencil are twelve
    numbers in a row, on which the weights of the stencil's rows act at once. A pixel whose 4 x 4 stencil leaves
    the image counts as 0 in frame 1 and in the gradient, which switches the data term off.
    """
    height, width = frame0.shape
    left, top = np.empty(width, np.intp), np.empty(width, np.intp)
    wx, wy = np.empty((4, width), frame0.dtype), np.empty((4, width), frame0.dtype)
    row = np.empty((1, 12), frame0.dtype)
    for i in range(start, stop):
        _stencils(u0[0, i], 0.0, 1.0, width, left, wx)
        _stencils(u0[1, i], float(i), 0.0, height, top, wy)
        for j in range(width):
            if left[j] == 0 or top[j] == 0:
                rho_c[i, j] = -frame0[i, j]
                gradient[0, i, j] = 0.0
                gradient[1, i, j] = 0.0
                continue
            r = top[j]
            if AVAILABLE:
                for offset in (0, 12 - LANES):
                    c = 3 * (left[j] - 1) + offset
                    upper = wy[0, j] * load(samples1, r - 1, c) + wy[1, j] * load(samples1, r, c)
                    lower = wy[2, j] * load(samples1, r + 1, c) + wy[3, j] * load(samples1, r + 2, c)
                    store(row, 0, offset, upper + lower)
            else:
                for k in range(12):
                    c = 3 * (left[j] - 1) + k
                    upper = wy[0, j] * samples1[r - 1, c] + wy[1, j] * samples1[r, c]
                    row[0, k] = upper + wy[2, j] * samples1[r + 1, c] + wy[3, j] * samples1[r + 2, c]
            w0, w1, w2, w3 = wx[0, j], wx[1, j], wx[2, j], wx[3, j]
            value = w0 * row[0, 0] + w1 * row[0, 3] + w2 * row[0, 6] + w3 * row[0, 9]
            gx = w0 * row[0, 1] + w1 * row[0, 4] + w2 * row[0, 7] + w3 * row[0, 10]
            gy = w0 * row[0, 2] + w1 * row[0, 5] + w2 * row[0, 8] + w3 * row[0, 11]
            rho_c[i, j] = value - gx * u0[0, i, j] - gy * u0[1, i, j] - frame0[i, j]
            gradient[0, i, j] = gx
            gradient[1, i, j] = gy


def sample(image: Array, flow: Array) -> Array:
    """Return an image (H, W) at ``x + flow``, (2, H, W) in pixels: bilinear, the borders repeated."""
    at = np.indices(image.shape) + flow[::-1]
    sampled: Array = scipy.ndimage.map_coordinates(image, at, order=1, mode="nearest")
    return sampled


@jit
def _stencils(u: Array, at: float, step: float, n: int, sample: NDArray[np.intp], weights: Array) -> None:
    """Place the stencils of a row along an axis of length `n`: pixel j is sampled at ``at + step j + u(j)``.

    `sample` receives the second of the four samples, or 0 where the stencil leaves the image; `weights`, (4, W),
    their weights.
    """
    for j in range(u.size):
        x = at + step * j + u[j]
        # A non-finite flow must not index anything: the comparison is false for NaN.
        x = x if x >= 1.0 and x < n - 2.0 else 0.0
        second = int(x)
        sample[j] = second
        weights[0, j], weights[1, j], weights[2, j], weights[3, j] = cubic_weights(x - second)


@jit
def _resize_rows(image: Array, ratio: float, out: Array) -> None:
    height = image.shape[0]
    real = image.dtype.type
    for i in range(out.shape[0]):
        y = i * ratio
        top = math.floor(y)
        a, b, c, d = cubic_weights(y - top)
        w = real(a), real(b), real(c), real(d)
        r0 = min(max(top - 1, 0), height - 1)
        r1 = min(top, height - 1)
        r2 = min(top + 1, height - 1)
        r3 = min(top + 2, height - 1)
        for j in range(image.shape[1]):
            out[i, j] = w[0] * image[r0, j] + w[1] * image[r1, j] + w[2] * image[r2, j] + w[3] * image[r3, j]


def resize(image: Array, shape: tuple[int, int]) -> Array:
    """Return an image (H, W) sampled bicubically on a grid of the size `shape` = (h, w), borders repeated.

    Pixel (i, j) of the result is the image at ``(i H / h, j W / w)``; the precision is that of the image.
    """
    rows = np.empty((shape[0], image.shape[1]), image.dtype)
    _resize_rows(image, image.shape[0] / shape[0], rows)
    columns = np.empty((shape[1], shape[0]), image.dtype)
    _resize_rows(np.ascontiguousarray(rows.T), image.shape[1] / shape[1], columns)
    return np.ascontiguousarray(columns.T)
