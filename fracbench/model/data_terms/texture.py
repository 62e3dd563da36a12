"""Structure and texture of frames (Wedel et al. 2009): shadows and shading belong to the structure."""

from __future__ import annotations

import numpy as np

from fracbench.model import pyramid
from fracbench.model.kernels.arrays import Array
from fracbench.model.regularizers import dual_ascent, dual_primal

#: Tightness of S in ``min_S TV(S) + |S - I|^2 / (2 THETA)``, gray levels: Wedel's 1/8 for intensities in -1..1.
THETA = 16.0
#: Number and length of Chambolle's steps.
ITERATIONS, TAU = 100, 0.25


def structure(image: Array) -> Array:
    """Return the image without its texture: S of Rudin, Osher and Fatemi's model, by Chambolle's dual.

    The image holds gray levels in 0..255, (H, W); the result has its precision.
    """
    smooth, dual = image.copy(), np.zeros((2, *image.shape), image.dtype)
    for _ in range(ITERATIONS):
        dual_ascent(smooth, TAU / THETA, dual)
        dual_primal(image, dual, THETA, smooth)
    return smooth


def textures(frame0: Array, frame1: Array, share: float) -> tuple[Array, Array]:
    """Return ``I - share S(I)`` of both frames, together stretched to 0..255, so that lambda keeps its scale.

    The frames hold gray levels in 0..255, (H, W); `share`, in [0, 1], is the part of the structure S that is
    removed. The results are new arrays in the precision of the frames.
    """
    kept = frame0.dtype.type(share)
    first, second = (frame - kept * structure(frame) for frame in (frame0, frame1))
    return pyramid.stretch(first, second, frame0.dtype)
