"""The method of two parts: equalities and symmetries that it must keep, its parts, and its refusals."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import reference_impl as ref
from scipy.ndimage import gaussian_filter

from fracbench.errors import InputError
from fracbench.methods import infimal
from fracbench.methods.infimal import tvl1_sb_alpha_ic
from fracbench.methods.paper import tvl1_sb_alpha
from fracbench.methods.registry import get_method
from fracbench.model import pyramid
from fracbench.model.kernels.threads import use_threads
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import InfimalBregman

SETTINGS = {"dtype": "float64", "n_warps": 2, "epsilon": 0.0, "max_iter": 5, "alpha": 1.0, "smooth_weight": 0.5}
#: Every ingredient, at a size that acts on small frames.
EVERYTHING = {
    "lambda": 0.2, "lambda_gradient": 0.8, "derivatives": "both", "edge_decay": 0.2, "median_radius": 1,
    "weighted_radius": 2, "texture": 0.9, "occlusion": "both"
}  # fmt: skip


@pytest.fixture(scope="module")
def frames():
    return ref.moving_square()


def estimate(frames, **values):
    return tvl1_sb_alpha_ic(*frames, FlowParams().replace({**SETTINGS, **values}))


def test_the_parts_make_up_the_flow(frames):
    for values in ({}, {"dtype": "float32"}, EVERYTHING):
        result = estimate(frames, **values)
        assert result.parts.shape == (2, 2, 48, 56) and result.parts.dtype == np.float32
        np.testing.assert_array_equal(result.parts[0] + result.parts[1], result.flow)
        assert np.abs(result.parts).max(axis=(1, 2, 3)).min() > 0.05


def test_methods_of_one_order_have_no_parts(frames):
    assert tvl1_sb_alpha(*frames, FlowParams()).parts is None


def test_a_large_weight_leaves_the_first_order(frames):
    converged = {"max_iter": 250, "n_scales": 1}
    single = tvl1_sb_alpha(*frames, FlowParams().replace({**SETTINGS, **converged, "alpha": 1.2})).flow
    result = estimate(frames, alpha=1.2, smooth_weight=1e3, **converged)
    assert np.abs(result.flow - single).mean() < 2e-3
    np.testing.assert_allclose(result.parts[1], 0.0, atol=5e-3)
    assert np.abs(estimate(frames, alpha=1.2, **converged).flow - single).mean() > 1e-2


def test_transposing_the_frames_transposes_the_flow(frames):
    here, there = estimate(frames), estimate([frame.T for frame in frames])
    np.testing.assert_allclose(there.flow, here.flow[::-1].transpose(0, 2, 1), atol=1e-4)
    np.testing.assert_allclose(there.parts, here.parts[:, ::-1].transpose(0, 1, 3, 2), atol=1e-4)


def test_turning_the_frames_round_turns_the_flow(frames):
    """At one scale, since the pyramid keeps pixel (0, 0); on an even margin, since the last stencils differ."""
    framed = [np.pad(frame, 8, constant_values=100.0) for frame in frames]
    here, there = (estimate(pair, n_scales=1) for pair in (framed, [frame[::-1, ::-1] for frame in framed]))
    np.testing.assert_allclose(there.parts, -here.parts[..., ::-1, ::-1], atol=1e-6)


@pytest.mark.parametrize("finest", [0, 1])
@pytest.mark.parametrize("gain", [None, 0.5])
def test_the_smooth_part_goes_up_the_pyramid(frames, monkeypatch, finest, gain):
    steps = []

    class Recording(InfimalBregman):
        def __init__(self, operator, theta, mu, smooth, **rest):
            super().__init__(operator, theta, mu, smooth, **rest)
            self.start = smooth.copy()
            steps.append(self)

    monkeypatch.setattr(infimal, "InfimalBregman", Recording)
    result = estimate(frames, median_radius=1, finest_scale=finest, upsample_gain=gain)
    assert [step.start.shape for step in steps] == [(2, 12, 14), (2, 24, 28), (2, 48, 56)][: 3 - finest]
    assert not steps[0].start.any()
    for coarse, fine in itertools.pairwise(steps):
        assert np.abs(coarse.smooth).max() > 0.02
        np.testing.assert_array_equal(fine.start, pyramid.upsample_flow(coarse.smooth, fine.start.shape[1:], gain))
    # The median changes p alone. The flow of a scale that is not the last goes up with the true ratio.
    smooth = pyramid.upsample_flow(steps[-1].smooth, (48, 56)) if finest else steps[-1].smooth
    np.testing.assert_allclose(result.parts[1], smooth, atol=1e-6)


@pytest.mark.parametrize("name", [name for name in EVERYTHING if name != "lambda"])
def test_each_ingredient_changes_the_flow(frames, name):
    assert np.abs(estimate(frames, **{name: EVERYTHING[name]}).flow - estimate(frames).flow).max() > 1e-3


def test_the_flow_does_not_depend_on_the_number_of_threads(frames):
    large = [np.tile(frame, (4, 3)) for frame in frames]
    values = {"dtype": "float32", "n_warps": 1, "max_iter": 2}
    alone = estimate(large, **values)
    with use_threads(3):
        shared = estimate(large, **values)
    np.testing.assert_array_equal(shared.parts, alone.parts)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"boundary": "zero"}, "tvl1_sb_alpha_ic needs boundary=reflect, got zero"),
        ({"u_solver": "jacobi"}, "needs u_solver=exact, got jacobi"),
        ({"inner": "cold"}, "needs inner=warm, got cold"),
        ({"alpha_smooth": 4.5}, r"`alpha_smooth` must be in \[0, 4\]"),
        ({"smooth_weight": 0.0}, "`smooth_weight` must be greater than 0"),
    ],
)
def test_refusals(frames, values, says):
    with pytest.raises(InputError, match=says):
        estimate(frames, **values)


def test_an_energy_of_one_order_is_not_recorded(frames):
    with pytest.raises(InputError, match="no `trace`"):
        tvl1_sb_alpha_ic(*frames, FlowParams(), trace=True)


def test_a_constant_added_to_the_motion_is_added_to_the_flow():
    """The second frame moves by a whole pixel more, on a texture that repeats."""
    rng = np.random.default_rng(5)
    frame0 = 100.0 + 300.0 * gaussian_filter(rng.normal(size=(40, 44)), 2.0, mode="wrap")
    frame1 = np.roll(frame0, 1, axis=1)
    values = {"n_scales": 1, "n_warps": 8, "max_iter": 30}
    one, both = (estimate((frame0, np.roll(frame1, shift, axis=0)), **values) for shift in (0, 1))
    inner = (slice(None), slice(8, -8), slice(8, -8))
    np.testing.assert_allclose(
        both.flow[inner] - one.flow[inner], [[[0.0]], [[1.0]]] + 0.0 * one.flow[inner], atol=0.05
    )


def test_its_defaults_are_registered():
    defaults = FlowParams().replace(get_method("tvl1_sb_alpha_ic").defaults)
    assert (defaults.alpha, defaults.alpha_smooth, defaults.smooth_weight) == (1.0, 1.5, 2.0)
