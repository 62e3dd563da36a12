"""Bicubic sampling, and the linearisation of the brightness residual at a flow u0."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fracbench.model._jit import jit
from fracbench.model.arrays import Array


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


def central_gradient(image: Array, scale: float = 1.0) -> Array:
    """Return central differences with Neumann borders.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Image.
    scale : float, optional
        Factor on the result (1 is the derivative).

    Returns
    -------
    ndarray, shape (2, H, W)
        x and y derivative.
    """
    padded = np.pad(image, 1, mode="edge")
    half = image.dtype.type(0.5 * scale)
    gradient = np.empty((2, *image.shape), image.dtype)
    np.subtract(padded[1:-1, 2:], padded[1:-1, :-2], out=gradient[0])
    np.subtract(padded[2:, 1:-1], padded[:-2, 1:-1], out=gradient[1])
    gradient *= half
    return gradient


@jit
def cubic_weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of Keys' cubic (a = -1/2) for the samples at -1, 0, 1, 2 and a point `t` in [0, 1).

    Parameters
    ----------
    t : float
        Position between sample 0 and sample 1.

    Returns
    -------
    tuple of float
        Four weights with sum 1.
    """
    t2 = t * t
    t3 = t2 * t
    return (
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (-t2 + t3),
    )


@jit
def _weights(t: float, real: Any) -> tuple[Any, Any, Any, Any]:
    a, b, c, d = cubic_weights(t)
    return real(a), real(b), real(c), real(d)


@jit
def _sample(image: Array, top: int, left: int, wx: tuple[Any, ...], wy: tuple[Any, ...]) -> Any:
    # Unsigned indices: no test for negative ones, which would count from the end. The caller has checked.
    c0 = np.uintp(left - 1)
    c1, c2, c3 = c0 + np.uintp(1), c0 + np.uintp(2), c0 + np.uintp(3)
    value = image.dtype.type(0.0)
    for p in range(4):
        r = np.uintp(top - 1 + p)
        row = wx[0] * image[r, c0] + wx[1] * image[r, c1] + wx[2] * image[r, c2] + wx[3] * image[r, c3]
        value += wy[p] * row
    return value


@jit
def linearize(
    frame0: Array,
    frame1: Array,
    gradient1: Array,
    u0: Array,
    rho_c: Array,
    gradient: Array,
    start: int,
    stop: int,
) -> None:
    """Warp `frame1` and its gradient by `u0` and form the residual's constant part.

    A pixel whose 4 x 4 stencil leaves the image counts as 0 in the frame and in the gradient, so that the
    data term is silent there.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The two frames at this scale.
    gradient1 : ndarray, shape (2, H, W)
        Gradient of `frame1`.
    u0 : ndarray, shape (2, H, W)
        Flow to linearise at, pixels.
    rho_c : ndarray, shape (H, W)
        Output, see `Linearization`.
    gradient : ndarray, shape (2, H, W)
        Output, see `Linearization`.
    start, stop : int
        The rows of the image to take.
    """
    height, width = frame0.shape
    real = frame0.dtype.type
    for i in range(start, stop):
        for j in range(width):
            x = j + float(u0[0, i, j])
            y = i + float(u0[1, i, j])
            # A non-finite flow must not index anything: the comparison is false for NaN.
            if not (x >= 1.0 and x < width - 2.0 and y >= 1.0 and y < height - 2.0):
                rho_c[i, j] = -frame0[i, j]
                gradient[0, i, j] = 0.0
                gradient[1, i, j] = 0.0
                continue
            left, top = int(x), int(y)
            wx, wy = _weights(x - left, real), _weights(y - top, real)
            value = _sample(frame1, top, left, wx, wy)
            gx = _sample(gradient1[0], top, left, wx, wy)
            gy = _sample(gradient1[1], top, left, wx, wy)
            rho_c[i, j] = value - gx * u0[0, i, j] - gy * u0[1, i, j] - frame0[i, j]
            gradient[0, i, j] = gx
            gradient[1, i, j] = gy


@jit
def _resize_rows(image: Array, ratio: float, out: Array) -> None:
    height = image.shape[0]
    for i in range(out.shape[0]):
        y = i * ratio
        top = math.floor(y)
        w = cubic_weights(y - top)
        r0 = min(max(top - 1, 0), height - 1)
        r1 = min(top, height - 1)
        r2 = min(top + 1, height - 1)
        r3 = min(top + 2, height - 1)
        for j in range(image.shape[1]):
            out[i, j] = w[0] * image[r0, j] + w[1] * image[r1, j] + w[2] * image[r2, j] + w[3] * image[r3, j]


def resize(image: Array, shape: tuple[int, int]) -> Array:
    """Sample `image` bicubically on another grid; pixel (0, 0) stays, borders are repeated.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Image.
    shape : tuple of int
        ``(h, w)`` of the result, whose pixel (i, j) is the image at ``(i H / h, j W / w)``.

    Returns
    -------
    ndarray, shape `shape`
        In the precision of `image`.
    """
    rows = np.empty((shape[0], image.shape[1]), image.dtype)
    _resize_rows(image, image.shape[0] / shape[0], rows)
    columns = np.empty((shape[1], shape[0]), image.dtype)
    _resize_rows(np.ascontiguousarray(rows.T), image.shape[1] / shape[1], columns)
    return np.ascontiguousarray(columns.T)
