"""Masked pixels: frames without their values, and a data term without their weight."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from fracbench.errors import InputError
from fracbench.model import pyramid
from fracbench.model.data_terms.brightness import Residual
from fracbench.model.kernels.arrays import Array
from fracbench.model.warping import Linearization, sample


def check_mask(mask: NDArray[np.bool_], shape: tuple[int, ...]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of frame 0 and of frame 1: one of `shape`, (H, W), is that of both."""
    if mask.shape not in (shape, (2, *shape)):
        raise InputError(f"`mask`: shape {mask.shape} given, {shape} or {(2, *shape)} needed")
    first, second = np.broadcast_to(mask, (2, *shape))
    for frame, hidden in (("frame0", first), ("frame1", second)):
        if hidden.all():
            raise InputError(f"`mask`: all {hidden.size} pixels of {frame} are masked; no data are left")
    return first, second


def fill(frame: Array, hidden: NDArray[np.bool_]) -> Array:
    """Return a frame (H, W) with each masked pixel replaced by its nearest valid one.

    Filters and derivatives of the result depend on valid pixels alone.
    """
    if not hidden.any():
        return frame
    nearest: NDArray[Any] = scipy.ndimage.distance_transform_edt(
        hidden, return_distances=False, return_indices=True
    )
    return frame[tuple(nearest)]


def without_masked(frame0: Array, frame1: Array, mask: NDArray[np.bool_] | None) -> tuple[Array, Array]:
    """Return both frames, with the pixels of a mask (`check_mask`) filled; to fill them again changes nothing."""
    if mask is None:
        return frame0, frame1
    first, second = check_mask(mask, frame0.shape)
    return fill(frame0, first), fill(frame1, second)


def valid_shares(
    mask: NDArray[np.bool_], shapes: list[tuple[int, int]], eta: float, dtype: np.dtype
) -> list[list[Array]]:
    """Return the shares of valid pixels behind each pixel of each scale, for frame 0 and frame 1.

    The masks follow the frames down the pyramid, finest scale first. Far from masked pixels shares are exactly 1.
    """
    return [
        [np.clip(1.0 - masked, 0.0, 1.0) for masked in pyramid.build(hidden.astype(dtype), shapes, eta)]
        for hidden in check_mask(mask, shapes[0])
    ]


class Masked(Residual):
    """A data term weighted by the valid shares w of a scale: ``lambda |w(x) w1(x + u0) rho|``.

    `valid0` and `valid1`, (H, W), are those of the frames. Where w = 0 the v-step leaves the flow as it is, and
    the regulariser fills it in.
    """

    def __init__(self, data: Residual, valid0: Array, valid1: Array) -> None:
        self._data, self._valid0, self._valid1 = data, valid0, valid1

    def at(self, u0: Array) -> Linearization:
        """Multiply the residual and its gradient by the weights at `u0`; see `Residual`."""
        linear = self._data.at(u0)
        weights = self._valid0 * sample(self._valid1, u0)
        linear.rho_c[...] *= weights
        linear.gradient[...] *= weights
        return linear
