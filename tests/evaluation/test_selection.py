"""Leave-one-out choice of settings."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench.errors import InputError
from fracbench.evaluation.resampling import Choice, leave_one_out


def test_each_sequence_is_chosen_for_by_the_others():
    # Setting 0 is the best of sequence 0 alone, by so much that it is the best of all.
    errors = [[0.1, 1.0, 1.0], [2.0, 0.9, 0.9], [2.0, 0.8, 1.1]]
    assert leave_one_out(errors) == Choice(left_out=(1, 0, 0), all_in=0)


def test_it_is_what_brute_force_finds():
    errors = np.random.default_rng(5).uniform(0.1, 1.0, (30, 8))
    found = leave_one_out(errors)
    for m, chosen in enumerate(found.left_out):
        means = [sum(row[i] for i in range(8) if i != m) / 7 for row in errors]
        assert chosen == means.index(min(means))
    assert found.all_in == min(range(30), key=lambda n: sum(errors[n]))


@pytest.mark.parametrize("m", [0, 3, 7])
def test_the_error_on_a_sequence_has_no_part_in_its_choice(m):
    rng = np.random.default_rng(6)
    errors = rng.uniform(0.1, 1.0, (20, 8))
    before = leave_one_out(errors).left_out[m]
    errors[:, m] = rng.uniform(0.0, 100.0, 20)
    assert leave_one_out(errors).left_out[m] == before


def test_a_setting_that_failed_somewhere_is_not_chosen():
    errors = [[np.nan, 0.1, 0.1], [0.5, 0.5, 0.5], [0.6, 0.4, 0.6]]
    assert leave_one_out(errors) == Choice((1, 1, 1), 1)
    assert leave_one_out([[np.nan, 1.0], [1.0, np.nan]]) is None


def test_of_equals_the_first_and_of_one_sequence_the_first():
    assert leave_one_out(np.ones((3, 2))) == Choice((0, 0), 0)
    assert leave_one_out([[2.0], [1.0]]) == Choice((0,), 1)


@pytest.mark.parametrize("errors", [[], [1.0, 2.0], [[]]])
def test_what_is_no_table_is_refused(errors):
    with pytest.raises(InputError, match="shape"):
        leave_one_out(errors)
