from __future__ import annotations

import numpy as np
import pytest

from fracbench.errors import InputError
from fracbench.evaluation.sparsification import ause, remaining_error


def test_the_errors_that_are_left_by_hand():
    errors = np.array([4.0, 1.0, 3.0, 2.0, np.nan, 0.0])
    uncertainty = np.array([0.5, np.inf, 0.1, 0.2, 9.0, 0.3])  # dropped: 1, 4, 0, 2, 3
    found = remaining_error(errors, uncertainty, (0.0, 0.2, 0.4, 0.6, 0.8))
    np.testing.assert_allclose(found, np.array([2.0, 9 / 4, 5 / 3, 5 / 2, 3.0]) / 2.0)
    best = remaining_error(errors, errors * 7, (0.2, 0.4))
    np.testing.assert_allclose(best, np.array([6 / 4, 3 / 3]) / 2.0)


def test_the_area_of_the_best_order_is_zero_and_of_none_that_under_a_linear_course():
    rng = np.random.default_rng(0)
    errors = rng.uniform(0, 1, 200_000)
    assert ause(errors, errors) == 0.0
    # uniform errors: the mean of those left is (1 - share) / 2, and constant for a random order
    assert ause(errors, rng.uniform(size=errors.size)) == pytest.approx(0.99**2 / 2, abs=0.01)
    assert ause(errors, -errors) > ause(errors, rng.uniform(size=errors.size))


def test_flows_without_error():
    np.testing.assert_array_equal(remaining_error(np.zeros(5), np.arange(5.0)), 1.0)


@pytest.mark.parametrize(
    ("errors", "uncertainty", "dropped", "message"),
    [
        (
            np.ones((2, 3)),
            np.ones((3, 2)),
            (0.1,),
            r"shape \(2, 3\), the uncertainty \(3, 2\)",
        ),
        (np.ones(3), np.ones(3), (1.0,), r"shares of dropped pixels must be in \[0, 1\), got \[1.0\]"),
        (np.ones(3), np.ones(3), (-0.1,), "shares of dropped pixels"),
        (np.ones(3), np.array([1.0, np.nan, 2.0]), (0.1,), "the uncertainty is NaN"),
        (np.full(3, np.nan), np.ones(3), (0.1,), "no pixel to score"),
    ],
)
def test_input_that_cannot_be_ranked(errors, uncertainty, dropped, message):
    with pytest.raises(InputError, match=message):
        remaining_error(errors, uncertainty, dropped)
