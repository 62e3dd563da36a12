"""Trust in a pixel of a flow: the distance between the flow and the one that leads back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array
from fracbench.model.warping import sample

#: The two flows agree where ``|w + b|^2 < SLOPE (|w|^2 + |b|^2) + OFFSET`` (Sundaram, Brox and Keutzer 2010).
SLOPE, OFFSET = 0.01, 0.5


@dataclass(frozen=True)
class Confidence:
    """The forward-backward check of a flow w by the flow b from frame 1 to frame 0.

    Attributes
    ----------
    distance : ndarray, shape (H, W), float32
        ``|w(x) + b(x + w)|``, pixels: 0 where b leads back to x. It is infinite where w leads out of the frame.
    agrees : ndarray of bool, shape (H, W)
        True where ``distance^2 < 0.01 (|w|^2 + |b|^2) + 0.5``.
    backward : ndarray, shape (2, H, W), float32
        The flow b, pixels.
    """

    distance: Array
    agrees: NDArray[np.bool_]
    backward: Array


def check_backward(flow: Array, backward: Array) -> Confidence:
    """Return the forward-backward check of a flow by the one back, both (2, H, W) in pixels."""
    back = np.stack([sample(component, flow) for component in backward])
    squared = np.square(flow + back).sum(axis=0)
    size = np.square(flow).sum(axis=0) + np.square(back).sum(axis=0)
    height, width = flow.shape[1:]
    rows, columns = np.indices((height, width)) + flow[::-1]
    inside = (rows >= 0) & (rows <= height - 1) & (columns >= 0) & (columns <= width - 1)
    distance = np.where(inside, np.sqrt(squared), np.inf).astype(np.float32)
    return Confidence(distance, inside & (squared < SLOPE * size + OFFSET), backward)
