"""The coarse-to-fine driver, with u-steps and v-steps of the tests."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.coarse_to_fine import coarse_to_fine
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.params import FlowParams
from fracbench.model.v_steps import PenaltyStep


class Recorder:
    """A u-step that copies v and records its calls."""

    def __init__(self, shape, dtype, value=None):
        self.operator = ForwardDifferences(1.0, shape, dtype)
        self.shape, self.dtype, self.value = shape, dtype, value
        self.restarts = 0

    def restart(self):
        self.restarts += 1

    def step(self, v, u, out):
        assert not np.shares_memory(u, out) and not np.shares_memory(v, out)
        out[...] = v if self.value is None else self.value
        return 1


class RecordingVStep(PenaltyStep):
    """The paper's v-step, which records its other calls."""

    def __init__(self, like, params):
        super().__init__(like, params)
        self.calls = []

    def relinearised(self):
        self.calls.append("relinearised")

    def restart(self):
        self.calls.append("restart")

    def target(self, u, linear):
        self.calls.append("target")
        return super().target(u, linear)


def drive(value=None, shape=(16, 40), **values):
    made, v_steps = [], []

    def make(params, frame0):
        made.append(Recorder(frame0.shape, frame0.dtype, value))
        return made[-1]

    def make_v_step(like, params):
        v_steps.append(RecordingVStep(like, params))
        return v_steps[-1]

    params = FlowParams(**{"n_warps": 3, "max_iter": 2, **values})
    frames = ref.translated_pair(shape, (0.5, 0.2))
    return coarse_to_fine(*frames, params, make, make_v_step, method="x"), made, v_steps


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_regularizer_is_made_for_each_scale_from_coarse_to_fine(dtype):
    result, made, _ = drive(dtype=dtype)
    assert [r.shape for r in made] == [(8, 20), (16, 40)]
    assert all(r.dtype == np.dtype(dtype) for r in made)
    assert result.method == "x"


def test_dual_variables_are_restarted_only_on_request():
    _, kept, _ = drive()
    _, restarted, _ = drive(dual_restart=True)
    assert [r.restarts for r in kept] == [0, 0]
    assert [r.restarts for r in restarted] == [3, 3]


@pytest.mark.parametrize("dual_restart", [False, True])
def test_the_v_step_is_told_of_each_linearisation_and_restart(dual_restart):
    _, _, v_steps = drive(dual_restart=dual_restart, epsilon=0.0)
    warp = ["relinearised", *(["restart"] if dual_restart else []), "target", "target"]
    assert [v_step.calls for v_step in v_steps] == [warp * 3, warp * 3]


@pytest.mark.parametrize(("gain", "expected"), [(None, (41 / 21, 17 / 9)), (0.5, (0.5, 0.5))])
def test_the_coarse_flow_is_scaled_on_its_way(gain, expected):
    started_from = []

    class Ones(Recorder):
        def step(self, v, u, out):
            started_from.append(u.copy())
            return super().step(v, u, out)

    params = FlowParams(n_warps=1, max_iter=1, upsample_gain=gain, dtype="float64")
    frames = ref.translated_pair((17, 41), (0.0, 0.0))
    coarse_to_fine(*frames, params, lambda params, frame0: Ones(frame0.shape, frame0.dtype, value=1.0))
    coarse, fine = started_from
    np.testing.assert_array_equal(coarse, np.zeros((2, 9, 21)))
    for component in range(2):
        np.testing.assert_allclose(fine[component], np.full((17, 41), expected[component]), rtol=1e-14)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_divergence_is_reported(value):
    with np.errstate(invalid="ignore"):  # compiled loops do not warn, the same loops in Python do
        result, *_ = drive(value)
    assert result.stop_reason == "diverged"
    assert result.levels[0].stop == ["diverged"]  # later warps of the scale are not tried
    assert result.iterations[0] == [1]
