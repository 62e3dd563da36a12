"""Colours in CIE Lab, where equal distances look equally different."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError
from fracbench.model import pyramid
from fracbench.model.data_terms.masked import check_mask, fill
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams

#: CIE XYZ of the linear primaries R, G, B of sRGB (IEC 61966-2-1), and of its white, D65.
PRIMARIES = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = PRIMARIES.sum(axis=1)
#: Below this share of white the cube root of CIE Lab is replaced by a straight line.
LINEAR = (6 / 29) ** 3


def cie_lab(color: Array) -> Array:
    """Return sRGB colours as CIE Lab (CIE 15, equations 8.3 to 8.8, white D65).

    Parameters
    ----------
    color : ndarray, shape (..., 3)
        R, G, B in 0..1.

    Returns
    -------
    ndarray, shape (3, ...), float64
        L in 0..100, a and b: ``116 f(Y) - 16``, ``500 (f(X) - f(Y))``, ``200 (f(Y) - f(Z))`` with X, Y, Z as
        shares of white and ``f(t) = t^(1/3)``, near 0 its tangent.
    """
    color = np.asarray(color, np.float64)
    linear = np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)
    shares = (linear @ PRIMARIES.T) / WHITE
    x, y, z = np.moveaxis(np.where(shares > LINEAR, np.cbrt(shares), shares / (3 * (6 / 29) ** 2) + 4 / 29), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def color_guides(
    color: Array | None, shape: tuple[int, ...], params: FlowParams, mask: NDArray[np.bool_] | None = None
) -> dict[tuple[int, int], Array]:
    """Return CIE Lab of a frame, (3, h, w), by the size of each scale; they go down the pyramid as the frames do.

    Parameters
    ----------
    color : ndarray, shape (H, W, 3), or None
        R, G, B of frame 0 on any scale: they are stretched to 0..1, as gray frames are to 0..255.
    shape : tuple
        ``(H, W)`` of the frames.
    params : FlowParams
    mask : ndarray of bool, shape (H, W) or (2, H, W), optional
        True at pixels whose colours do not count; see `fill`.

    Raises
    ------
    InputError
        No colours, or colours of another shape.
    """
    if color is None:
        raise InputError("weighted_guide=color needs frames in colour; gray frames take weighted_guide=gray")
    if color.shape != (*shape, 3):
        raise InputError(f"`color`: shape {color.shape} given, {(*shape, 3)} needed")
    planes = list(np.moveaxis(color, 2, 0))
    if mask is not None:
        planes = [fill(plane, check_mask(mask, shape)[0]) for plane in planes]
    rgb, _ = pyramid.stretch(np.stack(planes, axis=-1), np.stack(planes, axis=-1), np.dtype(np.float64))
    lab = cie_lab(rgb / 255.0).astype(params.dtype)
    shapes = pyramid.scale_shapes((shape[0], shape[1]), params.eta, params.n_scales)
    levels = [pyramid.build(pyramid.smooth(plane, params.presmoothing), shapes, params.eta) for plane in lab]
    return {size: np.stack(scale) for size, *scale in zip(shapes, *levels, strict=True)}
