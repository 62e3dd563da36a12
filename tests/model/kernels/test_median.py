"""The median by a network of comparisons, against sorting."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import scipy.ndimage

from fracbench.model.kernels.median import BLOCK, selection_network, window_median


@pytest.mark.parametrize("n", [1, 3, 5, 9, 13])
def test_the_network_finds_the_median_of_all_zeros_and_ones(n):
    """By the 0-1 principle it then finds that of all values."""
    values = np.array(list(product((0, 1), repeat=n))).T
    expected = np.sort(values, axis=0)[n // 2]
    for a, b in selection_network(n):
        values[a], values[b] = np.minimum(values[a], values[b]), np.maximum(values[a], values[b])
    np.testing.assert_array_equal(values[n // 2], expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("size", [1, 3, 5, 11])
def test_medians_are_those_of_another_program(size, dtype):
    image = np.random.default_rng(size).normal(size=(9, BLOCK + 7)).astype(dtype)
    got = window_median(image, size)
    assert got.dtype == dtype
    np.testing.assert_array_equal(got, scipy.ndimage.median_filter(image, size, mode="nearest"))
