"""Images resampled by other rules than `warping.resize`: those of the switches `downsampling` and `upsampling`.

Each rule is one weight matrix an axis, ``Wy I Wx^T``. Samples lie in the centres of their pixels, so that sample j
of ``m`` is at ``(j + 1/2) n / m - 1/2`` of the ``n`` given; only `printed` has them at the pixels' corners.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fracbench.model.kernels.arrays import Array, Float64Array


def resample(image: Array, shape: tuple[int, int], kind: str) -> Array:
    """Return an image (H, W) on a grid of the size `shape`, in its precision.

    Kinds: ``nearest``, ``bilinear``; ``imresize``, Keys' cubic (a = -1/2), widened by the ratio of the sizes where
    the image shrinks, as Matlab's function of that name; ``area``, means over the areas of the new pixels; and
    ``printed``, the formula ``u(x / eta)`` of Algorithm 1: bilinear at ``j m / n``, 0 outside the image.
    """
    wy, wx = (weight_matrix(kind, n, m, image.dtype) for n, m in zip(image.shape, shape, strict=True))
    return np.ascontiguousarray(wy @ image @ wx.T)


@lru_cache(maxsize=256)
def weight_matrix(kind: str, n: int, m: int, dtype: np.dtype) -> Array:
    """Return the weights (m, n) of `n` samples in `m` new ones; rows sum to 1, but for `printed` outside."""
    if kind == "printed":
        at = np.arange(m) * (m / n)
        return np.maximum(1.0 - np.abs(at[:, None] - np.arange(n)), 0.0).astype(dtype)
    at = (np.arange(m) + 0.5) * (n / m) - 0.5
    shrink = max(n / m, 1.0)
    reach = int(np.ceil(2.0 * shrink)) + 1
    columns = np.floor(at)[:, None] + np.arange(-reach, reach + 1)
    distance = np.abs(columns - at[:, None])
    if kind == "nearest":
        columns, values = np.floor(at + 0.5)[:, None], np.ones((m, 1))
    elif kind == "bilinear":
        values = np.maximum(1.0 - distance, 0.0)
    elif kind == "imresize":
        values = _keys(distance / shrink)
    else:  # area: the overlap of the new pixel with the old ones
        half = n / m / 2.0
        values = np.clip(
            np.minimum(columns + 0.5, at[:, None] + half) - np.maximum(columns - 0.5, at[:, None] - half),
            0.0,
            None,
        )
    values = values / values.sum(axis=1, keepdims=True)
    inside = np.where(columns < 0, -1 - columns, columns) if kind == "imresize" else np.clip(columns, 0, n - 1)
    inside = np.where(inside >= n, 2 * n - 1 - inside, inside) if kind == "imresize" else inside
    weights = np.zeros((m, n))
    np.add.at(weights, (np.arange(m)[:, None], np.clip(inside, 0, n - 1).astype(int)), values)
    return weights.astype(dtype)


def _keys(x: Float64Array) -> Float64Array:
    """Return Keys' cubic kernel, a = -1/2, at the distances `x`."""
    near = 1.5 * x**3 - 2.5 * x**2 + 1.0
    far = -0.5 * x**3 + 2.5 * x**2 - 4.0 * x + 2.0
    return np.where(x <= 1.0, near, np.where(x <= 2.0, far, 0.0))
