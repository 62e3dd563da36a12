"""The method with a map of orders: equalities and symmetries that it must keep."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.methods import alpha_map
from fracbench.methods.alpha_map import flow_with_orders, tvl1_sb_alpha_map
from fracbench.methods.paper import tvl1_sb_alpha
from fracbench.model.operators.alpha_map import MappedGradient
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES

SETTINGS = {"dtype": "float64", "n_warps": 2, "epsilon": 0.0, "max_iter": 5}
BY_CLASS = {"alpha_flat": 0.8, "alpha_edge": 1.4, "alpha_corner": 1.6, "alpha_texture": 1.2}


@pytest.fixture(scope="module")
def frames():
    return ref.moving_square()


def mapped(frames, **values):
    return tvl1_sb_alpha_map(*frames, FlowParams().replace({**SETTINGS, **BY_CLASS, **values})).flow


def test_one_order_for_all_classes_is_the_single_order(frames):
    same = mapped(frames, **{f"alpha_{name}": 1.3 for name in CLASSES})
    single = tvl1_sb_alpha(*frames, FlowParams().replace({**SETTINGS, "alpha": 1.3})).flow
    np.testing.assert_allclose(same, single, atol=1e-6)


def test_each_order_matters(frames):
    flow = mapped(frames)
    for name in CLASSES:
        assert abs(mapped(frames, **{f"alpha_{name}": 0.2}) - flow).max() > 1e-3, name


def test_transposing_the_frames_transposes_the_flow(frames):
    there = mapped([frame.T for frame in frames])
    np.testing.assert_allclose(there, mapped(frames)[::-1].transpose(0, 2, 1), atol=1e-4)


def test_turning_the_frames_round_turns_the_flow(frames):
    """By half a turn: flipped along one axis, a left derivative would be paired with a right one.

    At one scale, since the pyramid keeps pixel (0, 0); on an even margin, since the last stencils differ.
    """
    framed = [np.pad(frame, 8, constant_values=100.0) for frame in frames]
    there = mapped([frame[::-1, ::-1] for frame in framed], n_scales=1)
    np.testing.assert_allclose(there, -mapped(framed, n_scales=1)[:, ::-1, ::-1], atol=1e-6)


@pytest.mark.parametrize("chosen", [0, 1])
def test_a_given_map_is_followed(frames, chosen):
    alphas = (0.6, 1.6)
    settings = FlowParams().replace({**SETTINGS, "max_iter": 400, "n_warps": 1, "n_scales": 1})
    weights = np.zeros((2, *frames[0].shape))
    weights[chosen] = 1.0
    flow = flow_with_orders(*frames, settings, alphas, weights).flow
    this, other = (
        tvl1_sb_alpha(*frames, settings.replace({"alpha": alphas[k]})).flow for k in (chosen, 1 - chosen)
    )
    assert abs(flow - this).mean() < 5e-4
    assert abs(flow - other).mean() > 1e-2


def test_a_given_map_follows_the_pyramid(frames, monkeypatch):
    seen = {}

    def recording(alphas, weights, dtype):
        seen[weights.shape[1:]] = weights
        return MappedGradient(alphas, weights, dtype)

    monkeypatch.setattr(alpha_map, "MappedGradient", recording)
    half = np.zeros((2, *frames[0].shape))
    half[0, :, :28] = half[1, :, 28:] = 1.0
    flow_with_orders(*frames, FlowParams().replace(SETTINGS), (0.6, 1.6), half)
    assert sorted(seen) == [(12, 14), (24, 28), (48, 56)]
    for (_, width), weights in seen.items():
        np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-2)
        assert (weights[0, :, : width // 2 - 2] > 0.99).all()
        assert (weights[1, :, width // 2 + 2 :] > 0.99).all()
