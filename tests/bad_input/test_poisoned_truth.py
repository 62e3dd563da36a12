"""No ground truth reaches an estimator: with another truth, the harness computes the same flow."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fracbench.data.datasets.registry import load_sequence
from fracbench.harness.run import compute_point
from fracbench.harness.run.compute_point import hold, run_point
from fracbench.harness.run.plan import make_plan
from fracbench.methods import alpha_map, infimal, paper

QUICK = ["sequence=synthetic_parallax", "n_scales=2", "n_warps=1", "max_iter=3", "boundary=reflect"]
HOMES = {"tvl1_sb_alpha_map": alpha_map, "tvl1_sb_alpha": paper, "tvl1_sb_alpha_ic": infimal}


@pytest.fixture
def flows(monkeypatch):
    """The flows as the methods return them, on the sequences of one test."""
    found = []
    for name, home in HOMES.items():
        estimate = getattr(home, name)

        def recording(*arguments, _estimate=estimate, **options):
            result = _estimate(*arguments, **options)
            found.append(result.flow.copy())
            return result

        monkeypatch.setattr(home, name, recording)
    monkeypatch.setattr(compute_point, "_held", {})
    return found


def poisons(truth):
    rng = np.random.default_rng(7)
    return [
        rng.normal(0.0, 1e3, truth.shape).astype(np.float32),
        np.roll(truth, 11, axis=2)[:, ::-1],
        np.where(rng.uniform(size=truth.shape[1:]) < 0.5, np.nan, -truth),
    ]


@pytest.mark.parametrize("method", HOMES)
def test_poisoned_truth_changes_the_errors_and_not_a_bit_of_the_flow(flows, method):
    (planned,) = make_plan([f"method={method}", *QUICK]).points
    sequence = load_sequence("parallax", "synthetic", None)
    right = run_point(planned.point, None).result
    expected = flows[-1]
    for truth in poisons(sequence.truth):
        hold(dataclasses.replace(sequence, truth=truth))
        (again,) = make_plan([f"method={method}", *QUICK]).points
        assert again.point.key == planned.point.key
        poisoned = run_point(again.point, None).result
        assert poisoned["aepe"] > 2.0 * right["aepe"]  # the harness did score against the poisoned truth
        assert poisoned["iterations"] == right["iterations"] and poisoned["stop"] == right["stop"]
        np.testing.assert_array_equal(flows[-1], expected)
