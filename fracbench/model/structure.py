"""Flat, edge, corner or texture: a class for each pixel of an image, from its structure tensor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError

CLASSES = ("flat", "edge", "corner", "texture")
FLAT, EDGE, CORNER, TEXTURE = range(len(CLASSES))

#: Standard deviations in pixels: of the derivatives, of the tensor, and of the neighbourhood that tells a corner
#: from texture.
DERIVATIVE, NEAR, WIDE = 1.0, 1.5, 4.0
#: A pixel has structure if its larger eigenvalue exceeds that of noise by this factor (as 3 in 10,000 pixels of
#: pure noise do), and the 95 % quantile over the image times ABOVE_WEAK (a gradient of a seventh).
ABOVE_NOISE, ABOVE_WEAK = 6.0, 0.02
#: It has one direction if the smaller eigenvalue is at most this part of the larger.
ONE_DIRECTION = 0.1
#: It is texture if more than this part of its neighbourhood has two directions; one right angle fills a quarter.
CROWDED = 0.4

_TRUNCATE = 3.0
_QUARTILE = 0.31863936396437514  # of |N(0, 1)|
_SECOND = (1.0, -2.0, 1.0)

Plane = NDArray[np.float64]


def structure_classes(image: Any) -> NDArray[np.uint8]:
    """Sort every pixel of a gray image by the structure around it.

    With the Gaussian ``G_s`` of standard deviation s and the derivatives ``g = grad G_1 * I``, the structure
    tensor is ``J = G_1.5 * (g g^T)``, with eigenvalues ``l1 >= l2 >= 0``. Noise of standard deviation sigma gives
    each derivative the variance ``n^2 = sigma^2 |dG_1/dx|^2``. A pixel is

    * *flat* if ``l1 <= max(6 n^2, 0.02 q95(l1))``, with q95 the 95 % quantile over the image;
    * else *busy*, with two directions, if ``l2 > max(6 n^2, 0.1 l1)``;
    * *texture* if it is not flat and more than 0.4 of the pixels about it are busy: ``G_4 * busy > 0.4``;
    * else *corner* if busy, *edge* if not.

    Sigma comes from `noise_level`: noise all over the image is not structure, noise on a part of it is texture.
    A gain and an offset of the gray levels change nothing. Flipping the image flips the classes exactly;
    transposing it transposes them, but for pixels within rounding (1e-12 of the largest value) of a threshold. The
    image is mirrored beyond its sides.

    Parameters
    ----------
    image : array_like of real numbers, (H, W)
        Gray levels on any scale; computed in float64.

    Returns
    -------
    ndarray of uint8, (H, W)
        Indices into `CLASSES`; all flat if the image is constant up to the rounding of its type.

    Raises
    ------
    InputError
        The image is not two-dimensional, is empty, or not all of it is finite.
    """
    levels = _normalised(image)
    if levels is None:
        return np.full(np.shape(image), FLAT, np.uint8)
    gx, gy = _smooth(levels, DERIVATIVE, (0, 1)), _smooth(levels, DERIVATIVE, (1, 0))
    products = (gx * gx, gx * gy, gy * gy)
    large, small = _eigenvalues(products, NEAR)
    floor = ABOVE_NOISE * noise_level(levels) ** 2 * _noise_gain()
    structured = large > max(floor, ABOVE_WEAK * float(np.quantile(large, 0.95)))
    busy = structured & (small > np.maximum(floor, ONE_DIRECTION * large))
    crowded = _smooth(busy.astype(np.float64), WIDE) > CROWDED
    found = np.where(busy, np.uint8(CORNER), np.uint8(EDGE))
    found[crowded] = TEXTURE
    found[~structured] = FLAT
    return found


def noise_level(image: Any) -> float:
    """Estimate the standard deviation of an image's noise.

    The mixed second difference ``N = I * (1, -2, 1)^T (1, -2, 1)`` vanishes on ramps and on edges along an axis,
    and has the standard deviation 6 sigma on white Gaussian noise: sigma is the lower quartile of ``|N|`` over
    that of a normal variable of standard deviation 6. Detail on up to half of the image multiplies the estimate by
    2.1 at most. The image, (H, W), and the result are in gray levels.
    """
    from scipy.ndimage import correlate1d

    levels = np.asarray(image, np.float64)
    mixed = correlate1d(correlate1d(levels, _SECOND, axis=0), _SECOND, axis=1)
    return float(np.quantile(np.abs(mixed), 0.25)) / (_QUARTILE * sum(w * w for w in _SECOND))


def _normalised(image: Any) -> Plane | None:
    """Return the gray levels stretched to 0..1, or None if all are equal."""
    given = np.asarray(image)
    if given.ndim != 2 or given.size == 0:
        raise InputError(f"the image must have the shape (H, W), not {given.shape}")
    eps = np.finfo(given.dtype).eps if given.dtype.kind == "f" else 0.0
    levels = given.astype(np.float64)
    low, high = float(levels.min()), float(levels.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError("the image holds values that are not finite")
    if high - low <= 8.0 * eps * max(abs(low), abs(high)):
        return None
    return np.asarray((levels - low) / (high - low))


def _eigenvalues(products: tuple[Plane, Plane, Plane], sigma: float) -> tuple[Plane, Plane]:
    """Return the larger and the smaller eigenvalue of the tensor smoothed with `sigma`."""
    xx, xy, yy = (_smooth(product, sigma) for product in products)
    mean, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return mean + radius, np.maximum(mean - radius, 0.0)


def _smooth(plane: Plane, sigma: float, order: tuple[int, int] = (0, 0)) -> Plane:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(plane, sigma, order=order, mode="reflect", truncate=_TRUNCATE))


def _noise_gain() -> float:
    """Return the variance of a derivative of white noise of variance 1: the sum of its kernel's squares."""
    impulse = np.zeros((9, 9))
    impulse[4, 4] = 1.0
    return float((_smooth(impulse, DERIVATIVE, (0, 1)) ** 2).sum())
