"""Two frames with the true flow between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames, the flow from the first to the second, and what identifies them.

    Attributes
    ----------
    name, dataset : str
        E.g. ``"Grove2"`` of ``"middlebury"``.
    frame0, frame1 : ndarray of float64, (H, W)
        Gray levels on the scale 0..255; read-only.
    truth : ndarray of float32, (2, H, W), or None
        True flow in pixels, NaN in both components where unknown; read-only.
    digest : str
        SHA-256, in hexadecimal, of what the data are made from: equal digests mean equal data.
    frame0_color : ndarray of uint8, (H, W, 3), or None
        The first frame in colour, for pictures; read-only.
    matched : ndarray of bool, (H, W), or None
        True at pixels that both frames show, False at those that are occluded in frame 1 or leave it; read-only.
    """

    name: str
    dataset: str
    frame0: NDArray[np.float64]
    frame1: NDArray[np.float64]
    truth: NDArray[np.float32] | None
    digest: str
    frame0_color: NDArray[np.uint8] | None = None
    matched: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.frame0)
        self._freeze("frame0", np.float64, shape[:2])
        self._freeze("frame1", np.float64, shape)
        if self.truth is not None:
            self._freeze("truth", np.float32, (2, *shape))
        if self.frame0_color is not None:
            self._freeze("frame0_color", np.uint8, (*shape, 3))
        if self.matched is not None:
            self._freeze("matched", np.bool_, shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.frame0.shape
        return height, width

    def _freeze(self, field: str, dtype: type[np.generic], shape: tuple[int, ...]) -> None:
        array: NDArray[Any] = np.array(getattr(self, field), dtype=dtype, order="C")
        if array.shape != shape:
            raise InputError(f"sequence {self.name!r}: {field} has the shape {array.shape}, not {shape}")
        array.setflags(write=False)
        object.__setattr__(self, field, array)
