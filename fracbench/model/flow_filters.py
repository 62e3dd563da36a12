"""Median filters of the flow between warps: a plain one, and a weighted one near motion edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from fracbench.model.coarse_to_fine import FlowFilterFactory
from fracbench.model.color import color_guides
from fracbench.model.data_terms.occlusion import Visibility, slope
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.median import window_median
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.params import FlowParams

#: Standard deviations of a neighbour's weight: distance in pixels, difference in gray levels or in CIE Lab
#: (Sun, Roth, Black 2014).
SIGMA_DISTANCE, SIGMA_GUIDE = 7.0, 7.0
#: A neighbour whose guide differs by more standard deviations than this has no weight.
CUT = 3.0
#: Halvings of the range of values before the exact selection: a pass without branches costs less than sorting.
HALVINGS = 8
#: A pixel is near a motion edge if the flow changes by more than this (pixels per pixel) within `REACH` pixels.
MOTION_EDGE, REACH = 0.1, 4


def median(flow: Array, size: int) -> Array:
    """Return the medians of a flow (2, H, W) over windows of ``size x size`` pixels, borders repeated."""
    return np.stack([window_median(component, size) for component in flow])


def motion_edges(flow: Array) -> Array:
    """Return a mask (H, W) of the pixels of a flow (2, H, W) near a motion edge; see `MOTION_EDGE`."""
    steep = np.max([np.hypot(slope(u, 0), slope(u, 1)) for u in flow], axis=0) > MOTION_EDGE
    return scipy.ndimage.maximum_filter(steep, 2 * REACH + 1, mode="nearest")


@jit
def weighted_median(
    flow: Array,
    guide: Array,
    trust: Array,
    mask: Array,
    radius: int,
    out: Array,
    start: int,
    stop: int,
) -> None:
    """Write the weighted median of each component of a flow (2, H, W) to `out` where `mask` (H, W) is true.

    The weight of a neighbour is proportional to its `trust` (H, W), e.g. its visibility, and falls as Gaussians
    with its distance and with its difference in the channels of `guide` (C, H, W), gray levels or
    CIE Lab. The median is the lower one: the smallest value that half of the weight does
    not exceed. Neighbours outside the image do not count, and `out` stays where no neighbour has weight. Rows
    `start` to `stop` are filtered.
    """
    _, height, width = flow.shape
    space = (2 * radius + 1) ** 2
    values, weights = np.empty((2, space), flow.dtype), np.empty((2, space), flow.dtype)
    least, largest = np.empty(2, flow.dtype), np.empty(2, flow.dtype)
    away = np.arange(-radius, radius + 1) ** 2 / (2.0 * SIGMA_DISTANCE**2)
    closeness = np.exp(-(away.reshape(-1, 1) + away)).astype(flow.dtype)
    scale = guide.dtype.type(-1.0 / (2.0 * SIGMA_GUIDE**2))
    for i in range(start, stop):
        for j in range(width):
            if not mask[i, j]:
                continue
            count, total = 0, 0.0
            least[:], largest[:] = math.inf, -math.inf
            for p in range(max(0, i - radius), min(height, i + radius + 1)):
                for q in range(max(0, j - radius), min(width, j + radius + 1)):
                    apart = guide.dtype.type(0.0)
                    for c in range(len(guide)):
                        change = guide[c, p, q] - guide[c, i, j]
                        apart += change * change
                    if apart > (CUT * SIGMA_GUIDE) ** 2 or trust[p, q] <= 0.0:
                        continue
                    weight = trust[p, q] * closeness[p - i + radius, q - j + radius] * math.exp(scale * apart)
                    for c in range(2):
                        value = flow[c, p, q]
                        values[c, count], weights[c, count] = value, weight
                        least[c], largest[c] = min(least[c], value), max(largest[c], value)
                    total += weight
                    count += 1
            if total > 0.0:
                for c in range(2):
                    out[c, i, j] = _narrow(values[c], weights[c], count, 0.5 * total, least[c], largest[c])


@jit
def _narrow(values: Array, weights: Array, count: int, wanted: float, low: Any, high: Any) -> float:
    """Return the value that `_select` returns, from the few that are left between two bounds.

    `low` and `high` are the least and the largest of the values. Both arrays are overwritten.
    """
    above: Any = -math.inf
    passed: Any = 0.0
    for _ in range(HALVINGS):
        pivot = values.dtype.type(0.5) * (low + high)
        below: Any = 0.0
        for k in range(count):
            below += weights[k] if values[k] <= pivot else values.dtype.type(0.0)
        if below >= wanted:
            high = pivot
        else:
            low, above, passed = pivot, pivot, below
    left = 0
    for k in range(count):
        value = values[k]
        values[left], weights[left] = value, weights[k]
        left += above < value <= high
    return _select(values, weights, left, wanted - passed)


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


def flow_filter(
    frame0: Array, frame1: Array, params: FlowParams, guide: Array | None = None
) -> Callable[[Array], Array] | None:
    """Return the filter of the flow that `params` ask for, or None; see `FlowFilter`."""
    wanted = params.median_radius or params.weighted_radius
    return FlowFilter(frame0, frame1, params, guide) if wanted else None


def filter_factory(
    params: FlowParams, color: Array | None, shape: tuple[int, ...], mask: NDArray[np.bool_] | None = None
) -> FlowFilterFactory:
    """Return the maker of filters: `flow_filter`, with `color_guides` where `params` ask for them."""
    if params.weighted_guide == "gray" or not params.weighted_radius:
        return flow_filter
    guides: dict[tuple[int, int], Array] = {}

    def make(frame0: Array, frame1: Array, params: FlowParams) -> Callable[[Array], Array] | None:
        if not guides:
            guides.update(color_guides(color, shape, params, mask))
        return flow_filter(frame0, frame1, params, guides.pop((frame0.shape[0], frame0.shape[1])))

    return make


class FlowFilter:
    """The plain median filter of the flow of a scale, replaced by the weighted one near motion edges.

    The weights follow frame 0, or the `guide` (C, H, W) in its place.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams, guide: Array | None = None) -> None:
        self._guide = frame0[np.newaxis] if guide is None else guide
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
