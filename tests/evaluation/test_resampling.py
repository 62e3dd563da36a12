from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats

from fracbench.errors import InputError
from fracbench.evaluation.resampling import held_out, mean_interval, minimum_interval


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_the_interval_of_a_mean_is_students():
    samples = rng().normal(3.0, 2.0, (20, 4))
    mean, low, high = mean_interval(samples)
    for i, column in enumerate(samples.T):
        expected = scipy.stats.ttest_1samp(column, 0.0).confidence_interval(0.95)
        assert (low[i], high[i]) == pytest.approx((expected.low, expected.high))
        assert mean[i] == pytest.approx(column.mean())


def test_it_covers_the_truth_as_often_as_it_says():
    samples = rng().normal(1.0, 1.0, (8, 4000))
    _, low, high = mean_interval(samples, 0.9)
    assert ((low <= 1.0) & (high >= 1.0)).mean() == pytest.approx(0.9, abs=0.02)


def test_one_repetition_has_a_mean_and_no_interval():
    mean, low, high = mean_interval([[2.0, 3.0]])
    assert mean.tolist() == [2.0, 3.0]
    assert np.isnan([low, high]).all()
    assert np.isnan(held_out([[2.0, 3.0]])).all()


def test_a_clear_minimum_is_sure_and_a_flat_one_is_not():
    clear = (np.arange(9) - 6.0) ** 2 + rng().normal(0.0, 0.1, (20, 9))
    assert minimum_interval(clear) == (6, 6, 6)
    place, low, high = minimum_interval(rng().normal(0.0, 1.0, (20, 9)))
    assert low <= place <= high
    assert high - low >= 4


def test_the_interval_of_a_minimum_covers_it_and_repeats():
    shapes = 0.02 * (np.arange(11) - 4.0) ** 2 + rng().normal(0.0, 0.2, (200, 15, 11))
    found = [minimum_interval(samples) for samples in shapes]
    assert np.mean([low <= 4 <= high for _, low, high in found]) > 0.9
    assert found[:5] == [minimum_interval(samples) for samples in shapes[:5]]


def test_held_out_values_are_those_of_a_literal_search():
    samples = rng().normal(size=(7, 5))
    expected = []
    for i in range(7):
        others = [row for j, row in enumerate(samples) if j % 2 != i % 2]
        expected.append(samples[i][np.argmin(np.mean(others, axis=0))])
    assert held_out(samples).tolist() == expected


def test_held_out_values_do_not_gain_from_noise_where_the_minimum_does():
    samples = rng().normal(0.0, 1.0, (300, 10, 21))
    assert np.mean([held_out(s).mean() for s in samples]) == pytest.approx(0.0, abs=0.05)
    assert np.mean([s.mean(axis=0).min() for s in samples]) < -0.4
    surely = [mean_interval(held_out(s))[2] < 0.0 for s in rng().normal(0.0, 1.0, (2000, 10, 21))]
    assert np.mean(surely) < 0.08  # more than the promised 0.025: halves that agree by chance choose the same


@pytest.mark.parametrize("function", [mean_interval, minimum_interval, held_out])
def test_nothing_has_no_interval(function):
    with pytest.raises(InputError, match="needs repetitions"):
        function(np.empty((0, 3)))
    assert math.isfinite(np.sum(function(np.ones((2, 3)))[0]))
