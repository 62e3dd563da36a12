"""The median of the windows of an image, by a network of comparisons that works on whole lines."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.threads import parallel_for

#: Pixels of a line that are filtered at once: for windows of 5 x 5 they fit the first-level cache.
BLOCK = 256


def window_median(image: Array, size: int) -> Array:
    """Return the medians of an image (H, W) over windows of ``size x size`` pixels, borders repeated."""
    padded, out = np.pad(image, size // 2, mode="edge"), np.empty_like(image)
    pairs = selection_network(size * size)
    parallel_for(lambda a, b: _filter(padded, size, pairs, out, a, b), len(image))
    return out


@lru_cache
def selection_network(n: int) -> NDArray[np.int64]:
    """Return comparisons (a, b), a < b, that bring the median of n values, n odd, to place ``n // 2``.

    A comparison puts the lower value at a. The network is Batcher's merge exchange (Knuth, The Art of Computer
    Programming 3, 5.2.2, algorithm M) without the comparisons that the median does not depend on.
    """
    pairs: list[tuple[int, int]] = []
    top = 1 << max(n - 1, 1).bit_length() - 1
    p = top
    while p:
        q, r, d = top, 0, p
        while True:
            pairs += [(i, i + d) for i in range(n - d) if i & p == r]
            if q == p:
                break
            d, q, r = q - p, q >> 1, p
        p >>= 1
    needed, kept = {n // 2}, []
    for pair in reversed(pairs):
        if not needed.isdisjoint(pair):
            needed.update(pair)
            kept.append(pair)
    return np.array(kept[::-1], np.int64).reshape(-1, 2)


@jit
def _filter(padded: Array, size: int, pairs: NDArray[np.int64], out: Array, start: int, stop: int) -> None:
    """Write the medians of rows `start` to `stop`; `padded` has ``size // 2`` more pixels on each side."""
    width, space = out.shape[1], size * size
    values = np.empty((space, BLOCK), out.dtype)
    for i in range(start, stop):
        for first in range(0, width, BLOCK):
            n = min(BLOCK, width - first)
            for k in range(space):
                line, row = padded[i + k // size, first + k % size :], values[k]
                for j in range(n):
                    row[j] = line[j]
            for m in range(len(pairs)):
                low, high = values[pairs[m, 0]], values[pairs[m, 1]]
                for j in range(n):
                    a, b = low[j], high[j]
                    low[j] = a if a < b else b
                    high[j] = b if a < b else a
            middle = values[space // 2]
            for j in range(n):
                out[i, first + j] = middle[j]
