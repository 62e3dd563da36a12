"""Median filters of a flow, against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fracbench.model.data_terms.occlusion import DIVERGENCE, RESIDUAL, visibility
from fracbench.model.flow_filters import (
    CUT,
    REACH,
    SIGMA_DISTANCE,
    SIGMA_GUIDE,
    _select,
    median,
    motion_edges,
    weighted_median,
)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def weighted(flow, guide, trust, mask, radius):
    out, guide = flow.copy(), np.atleast_3d(guide.T).T
    weighted_median(flow, guide, trust, mask, radius, out, 0, len(mask))
    return out


def neighbours(i, j, radius, shape):
    rows = range(max(0, i - radius), min(shape[0], i + radius + 1))
    return [(p, q) for p in rows for q in range(max(0, j - radius), min(shape[1], j + radius + 1))]


def literal(flow, guide, trust, i, j, radius):
    """Sort the neighbours of each pixel and add up their weights to one half, for each component."""
    around, guide = neighbours(i, j, radius, trust.shape), np.atleast_3d(guide.T).T
    weights = [
        trust[p, q]
        * math.exp(-((p - i) ** 2 + (q - j) ** 2) / (2 * SIGMA_DISTANCE**2))
        * math.exp(-(math.dist(guide[:, p, q], guide[:, i, j]) ** 2) / (2 * SIGMA_GUIDE**2))
        * (math.dist(guide[:, p, q], guide[:, i, j]) <= CUT * SIGMA_GUIDE)
        for p, q in around
    ]
    result = []
    for component in flow:
        values, masses = zip(*sorted(zip([component[p, q] for p, q in around], weights, strict=True)), strict=True)
        reached = np.cumsum(masses) >= 0.5 * sum(weights) - 1e-12
        result.append(values[int(np.argmax(reached))])
    return result


@pytest.mark.parametrize("radius", [1, 2])
def test_the_plain_median_is_the_middle_of_the_sorted_window(rng, radius):
    flow = rng.normal(size=(2, 7, 9))
    padded = np.pad(flow, ((0, 0), (radius, radius), (radius, radius)), mode="edge")
    size = 2 * radius + 1
    for c, i, j in np.ndindex(flow.shape):
        window = sorted(padded[c, i : i + size, j : j + size].ravel())
        assert median(flow, size)[c, i, j] == window[len(window) // 2]


def test_a_window_of_one_pixel_changes_nothing(rng):
    flow = rng.normal(size=(2, 5, 6)).astype(np.float32)
    np.testing.assert_array_equal(median(flow, 1), flow)
    assert median(flow, 3).dtype == np.float32


@pytest.mark.parametrize("levels", [3, 1000])
@pytest.mark.parametrize("radius", [1, 3])
def test_the_weighted_median_is_that_of_the_sorted_neighbours(rng, radius, levels):
    """With few levels most neighbours are equal, and the selection must cope with ties."""
    shape = (9, 11)
    flow = rng.integers(0, levels, (2, *shape)).astype(float)
    guide, trust = rng.uniform(0.0, 40.0, shape), rng.uniform(0.0, 1.0, shape) * rng.integers(0, 2, shape)
    trust[4, 4] = 1.0
    got = weighted(flow, guide, trust, np.ones(shape, bool), radius)
    for i, j in np.ndindex(shape):
        if any(
            trust[p, q] > 0 and abs(guide[p, q] - guide[i, j]) <= CUT * SIGMA_GUIDE
            for p, q in neighbours(i, j, radius, shape)
        ):
            assert got[:, i, j].tolist() == literal(flow, guide, trust, i, j, radius), (i, j)
        else:
            assert got[:, i, j].tolist() == flow[:, i, j].tolist()


def test_with_colours_the_weights_fall_with_the_distance_in_all_channels(rng):
    shape = (8, 9)
    flow, guide = rng.normal(size=(2, *shape)), rng.uniform(0.0, 15.0, (3, *shape))
    trust = rng.uniform(0.1, 1.0, shape)
    got = weighted(flow, guide, trust, np.ones(shape, bool), 3)
    for i, j in np.ndindex(shape):
        assert got[:, i, j].tolist() == literal(flow, guide, trust, i, j, 3), (i, j)


def test_equal_weights_give_the_plain_median(rng):
    """Far inside a uniform image the weights depend on distance alone: hardly within a radius of 1."""
    flow, shape = rng.normal(size=(2, 8, 8)), (8, 8)
    got = weighted(flow, np.zeros(shape), np.ones(shape), np.ones(shape, bool), 1)
    np.testing.assert_array_equal(got[:, 1:-1, 1:-1], median(flow, 3)[:, 1:-1, 1:-1])


def test_only_the_masked_pixels_of_the_rows_are_replaced(rng):
    flow, shape = rng.normal(size=(2, 8, 9)), (8, 9)
    mask = rng.integers(0, 2, shape).astype(bool)
    whole = weighted(flow, np.zeros(shape), np.ones(shape), mask, 2)
    np.testing.assert_array_equal(whole[:, ~mask], flow[:, ~mask])
    assert (whole[:, mask] != flow[:, mask]).any()
    halves = flow.copy()
    for start, stop in ((5, 8), (0, 5)):
        weighted_median(flow, np.zeros((1, *shape)), np.ones(shape), mask, 2, halves, start, stop)
    np.testing.assert_array_equal(halves, whole)


def test_the_weighted_median_keeps_to_its_own_side_of_an_edge_of_the_image():
    """The filter moves a flow that leaks two pixels over the image's edge back to it; a plain median does not."""
    guide = np.zeros((15, 20))
    guide[:, 10:] = 100.0
    flow = np.zeros((2, 15, 20))
    flow[:, :, 12:] = 1.0
    got = weighted(flow, guide, np.ones((15, 20)), np.ones((15, 20), bool), 5)
    assert (got[:, :, :10] == 0.0).all() and (got[:, :, 10:] == 1.0).all()
    assert (median(flow, 5)[:, :, 10:12] == 0.0).all()


def test_visibility_is_its_formula(rng):
    flow, residual = rng.normal(size=(2, 6, 7)), rng.normal(0.0, 20.0, (6, 7))
    got = visibility(flow, residual)
    for i in range(1, 5):
        for j in range(1, 6):
            divergence = (flow[0, i, j + 1] - flow[0, i, j - 1] + flow[1, i + 1, j] - flow[1, i - 1, j]) / 2
            expected = math.exp(
                -(min(0, divergence) ** 2) / (2 * DIVERGENCE**2) - residual[i, j] ** 2 / (2 * RESIDUAL**2)
            )
            assert got[i, j] == pytest.approx(expected)
    assert (visibility(np.ones((2, 6, 7)), np.zeros((6, 7))) == 1.0).all()


def test_motion_edges_are_marked_within_reach():
    flow = np.zeros((2, 30, 40))
    flow[1, :, 20:] = 1.0  # steep at columns 19 and 20
    marked = motion_edges(flow)
    expected = np.zeros((30, 40), bool)
    expected[:, 19 - REACH : 21 + REACH] = True
    np.testing.assert_array_equal(marked, expected)
    assert not motion_edges(0.1 * flow).any()


def test_the_selected_value_is_the_first_whose_cumulative_weight_reaches_what_is_wanted(rng):
    """Whole weights reach it exactly, as those of rounded numbers seldom do."""
    for count in (1, 2, 3, 5, 8, 24):
        for _ in range(10):
            values, weights = rng.integers(0, 12, count).astype(float), rng.integers(1, 4, count).astype(float)
            order = np.argsort(values)
            cumulative = np.cumsum(weights[order])
            for wanted in (0.5, *cumulative, *(cumulative - 0.5)):
                expected = values[order][np.argmax(cumulative >= wanted)]
                assert _select(values.copy(), weights.copy(), count, wanted) == expected
