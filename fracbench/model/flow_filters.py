"""Median filters of the flow between warps: a plain one, and a weighted one near motion edges."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.ndimage

from fracbench.model.data_terms.occlusion import Visibility, slope
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.params import FlowParams

#: Standard deviations of a neighbour's weight: distance in pixels, difference in gray levels (Sun et al. 2014).
SIGMA_DISTANCE, SIGMA_GRAY = 7.0, 7.0
#: A neighbour that differs by more gray levels than this has no weight.
MAX_GRAY_DIFFERENCE = 3.0 * SIGMA_GRAY
#: A pixel is near a motion edge if the flow changes by more than this (pixels per pixel) within `REACH` pixels.
MOTION_EDGE, REACH = 0.1, 4


def median(flow: Array, size: int) -> Array:
    """Return the medians of a flow (2, H, W) over windows of ``size x size`` pixels, borders repeated."""
    return np.stack([scipy.ndimage.median_filter(component, size, mode="nearest") for component in flow])


def motion_edges(flow: Array) -> Array:
    """Return a mask (H, W) of the pixels of a flow (2, H, W) near a motion edge; see `MOTION_EDGE`."""
    steep = np.max([np.hypot(slope(u, 0), slope(u, 1)) for u in flow], axis=0) > MOTION_EDGE
    return scipy.ndimage.maximum_filter(steep, 2 * REACH + 1, mode="nearest")


@jit
def weighted_median(
    flow: Array, guide: Array, trust: Array, mask: Array, radius: int, out: Array, start: int, stop: int
) -> None:
    """Write the weighted median of each component of a flow (2, H, W) to `out` where `mask` (H, W) is true.

    The weight of a neighbour is proportional to its `trust` (H, W), e.g. its visibility, and falls as Gaussians
    with its distance and with its difference in the gray levels `guide` (H, W). The median is the lower one: the
    smallest value that half of the weight does not exceed. Neighbours outside the image do not count, and `out`
    stays where no neighbour has weight. Rows `start` to `stop` are filtered.
    """
    _, height, width = flow.shape
    space = (2 * radius + 1) ** 2
    values, weights = np.empty((2, space), flow.dtype), np.empty((2, space), flow.dtype)
    for i in range(start, stop):
        for j in range(width):
            if not mask[i, j]:
                continue
            count, total = 0, 0.0
            for p in range(max(0, i - radius), min(height, i + radius + 1)):
                for q in range(max(0, j - radius), min(width, j + radius + 1)):
                    gray = guide[p, q] - guide[i, j]
                    if abs(gray) > MAX_GRAY_DIFFERENCE or trust[p, q] <= 0.0:
                        continue
                    away = ((p - i) ** 2 + (q - j) ** 2) / (2.0 * SIGMA_DISTANCE**2)
                    weight = trust[p, q] * math.exp(-away - gray * gray / (2.0 * SIGMA_GRAY**2))
                    for c in range(2):
                        values[c, count], weights[c, count] = flow[c, p, q], weight
                    total += weight
                    count += 1
            if total > 0.0:
                for c in range(2):
                    out[c, i, j] = _select(values[c], weights[c], count, 0.5 * total)


@jit
def _select(values: Array, weights: Array, count: int, wanted: float) -> float:
    """Return the smallest of the first `count` values with a cumulative weight of at least `wanted`.

    Hoare's selection; both arrays are reordered.
    """
    low, high = 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        a, b, passed = low, high, 0.0
        while a <= b:
            while values[a] < pivot:
                passed += weights[a]
                a += 1
            while values[b] > pivot:
                b -= 1
            if a <= b:
                values[a], values[b] = values[b], values[a]
                weights[a], weights[b] = weights[b], weights[a]
                passed += weights[a]
                a += 1
                b -= 1
        smaller = passed - weights[b + 1] if a - b == 2 else passed  # at a - 1, between the parts, is a pivot
        if smaller >= wanted:
            high = b
        elif passed >= wanted:
            return pivot
        else:
            wanted -= passed
            low = a
    return values[min(low, count - 1)]


def flow_filter(frame0: Array, frame1: Array, params: FlowParams) -> Callable[[Array], Array] | None:
    """Return the filter of the flow that `params` ask for, or None."""
    wanted = params.median_radius or params.weighted_radius
    return FlowFilter(frame0, frame1, params) if wanted else None


class FlowFilter:
    """The plain median filter of the flow of a scale, replaced by the weighted one near motion edges."""

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._guide = frame0
        self._visibility = Visibility(frame0, frame1, params) if params.occlusion != "none" else None
        self._radius, self._weighted = params.median_radius, params.weighted_radius

    def __call__(self, flow: Array) -> Array:
        """Return the filtered flow, a new array of shape (2, H, W)."""
        plain = median(flow, 2 * self._radius + 1)
        if not self._weighted:
            return plain
        trust = np.ones_like(flow[0]) if self._visibility is None else self._visibility.of(flow)
        near = motion_edges(plain)
        arrays = flow, self._guide, trust, near, self._weighted, plain
        parallel_for(lambda a, b: weighted_median(*arrays, a, b), len(near))
        return plain
