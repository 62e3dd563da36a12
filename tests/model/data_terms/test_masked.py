from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench import estimate_flow
from fracbench.model import pyramid
from fracbench.model.data_terms.brightness import Brightness
from fracbench.model.data_terms.gradients import ImageAndGradient
from fracbench.model.data_terms.masked import Masked, fill, valid_shares
from fracbench.model.energy import energy
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.params import FlowParams
from fracbench.model.v_steps import ChannelStep, MultiplierStep, PenaltyStep
from fracbench.model.warping import sample

SHAPE = (44, 52)
MOTION = (1.6, -1.2)
#: Methods and couplings: each v-step, each u-step, each ingredient that looks at the frames.
VARIANTS = [
    {"method": "tvl1", "epsilon": 0.003},
    {"method": "tvl1_sb", "max_iter": 20},
    {"method": "tvl1_sb", "inner": "warm", "u_solver": "exact", "coupling": "multiplier", "max_iter": 20},
    {"method": "tvl1_sb_alpha"},
    {"method": "tvl1_sb_alpha", "coupling": "penalty", "max_iter": 40},
    {"method": "tvl1_sb_alpha", "boundary": "zero", "max_iter": 40},
    {"method": "tvl1_sb_alpha_map", "alpha_flat": 0.8},
    {"method": "tvl1_sb_alpha_ic"},
    {"method": "tvl1_sb_alpha_map", "lambda_gradient": 1.0, "edge_decay": 0.2, "derivatives": "both"},
    {"method": "tvl1_sb_alpha_map", "texture": 0.8, "occlusion": "both", "median_radius": 1, "weighted_radius": 3},
]
variants = pytest.mark.parametrize("settings", VARIANTS, ids=lambda values: "-".join(map(str, values.values())))


def block():
    hidden = np.zeros(SHAPE, bool)
    hidden[14:26, 20:34] = True
    return hidden


def spoiled(frames, hidden, seed):
    """The frames with garbage in the block: far beyond their range, or no numbers at all."""
    garbage = np.random.default_rng(seed).choice([-1e30, 3.0, 255.0, 7e5, np.nan, np.inf], (2, *SHAPE))
    return np.where(hidden, garbage, frames)


def run(frames, **values):
    """Methods are called by themselves: `estimate_flow` would refuse infinite values."""
    from fracbench.methods.registry import get_method

    values = dict(values)
    mask, start = values.pop("mask", None), values.pop("initial_flow", None)
    method = get_method(values.pop("method"))
    params = FlowParams().replace(method.defaults).replace(values)
    return method.estimate(*frames, params, mask=mask, initial_flow=start)


def error_inside(flow, hidden):
    return np.hypot(flow[0] - MOTION[0], flow[1] - MOTION[1])[hidden]


@variants
def test_the_motion_of_a_masked_block_is_filled_in(settings):
    frames, hidden = np.stack(ref.translated_pair(SHAPE, MOTION)), block()
    frames = 255 * (frames - frames.min()) / np.ptp(frames)
    broken = np.where(hidden, 255.0 * np.random.default_rng(0).integers(0, 2, (2, *SHAPE)), frames)
    masked, open_ = (run(broken, **settings, mask=mask).flow for mask in (hidden, None))
    assert error_inside(masked, hidden).max() < 0.3
    assert error_inside(masked, hidden).mean() < 0.5 * error_inside(open_, hidden).mean()


@variants
def test_values_under_the_mask_have_no_influence(settings):
    frames, hidden = np.stack(ref.translated_pair(SHAPE, MOTION)), block()
    quick = {**settings, "n_warps": 2, "max_iter": 3}
    first, second = (run(spoiled(frames, hidden, seed), **quick, mask=hidden).flow for seed in (1, 2))
    assert np.isfinite(first).all()
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("frame", [0, 1])
def test_each_frame_may_have_a_mask_of_its_own(frame):
    frames, masks = np.stack(ref.translated_pair(SHAPE, MOTION)), np.zeros((2, *SHAPE), bool)
    masks[frame] = block()
    other = frames.copy()
    other[frame, block()] = 1e20
    flows = [run(pair, method="tvl1_sb_alpha", mask=masks).flow for pair in (frames, other)]
    np.testing.assert_array_equal(*flows)
    np.testing.assert_array_equal(
        run(frames, method="tvl1", mask=block()).flow,
        run(frames, method="tvl1", mask=np.stack([block()] * 2)).flow,
    )


@pytest.mark.parametrize("frame", [0, 1])
def test_a_pixel_hidden_in_one_frame_does_not_count_where_it_is_seen(frame):
    """A block of frame 1 hides the pixels of frame 0 that the flow, of 9 and -7 pixels, leads into it."""
    frames, masks = np.stack(ref.translated_pair(SHAPE, (9.0, -7.0))), np.zeros((2, *SHAPE), bool)
    masks[frame] = block()
    start = np.reshape([9.0, -7.0], (2, 1, 1)) * np.ones((2, *SHAPE), np.float32)
    flow = run(frames, method="tvl1_sb_alpha", mask=masks, initial_flow=start, n_scales=1).flow
    hidden = np.roll(block(), (7, -9), (0, 1)) if frame else block()
    assert np.hypot(*(flow - start))[hidden].max() < 0.1


def test_a_mask_without_a_pixel_changes_nothing():
    frames = ref.translated_pair(SHAPE, MOTION)
    empty = np.zeros(SHAPE, bool)
    expected = run(frames, method="tvl1_sb_alpha").flow
    np.testing.assert_array_equal(run(frames, method="tvl1_sb_alpha", mask=empty).flow, expected)


def test_pixels_that_are_nan_are_masked_with_a_notice():
    frames, masks = np.stack(ref.translated_pair(SHAPE, MOTION)), np.zeros((2, *SHAPE), bool)
    masks[0, 3:9, 5:11], masks[1, 20:30, 20:30] = True, True
    expected = estimate_flow(*frames, mask=masks)
    frames[masks] = np.nan
    found = estimate_flow(*frames)
    np.testing.assert_array_equal(found.flow, expected.flow)
    assert expected.notices == []
    assert found.notices == [
        "frame0: 36 of 2288 pixels are NaN and do not count, the first at row 3, column 5",
        "frame1: 100 of 2288 pixels are NaN and do not count, the first at row 20, column 20",
    ]
    colour = np.repeat(frames[0][..., None], 3, axis=2)
    colour[..., :2] = np.nan_to_num(colour[..., :2])  # NaN in one channel is enough
    assert estimate_flow(colour, frames[1], n_warps=1).notices == found.notices
    both = estimate_flow(*frames, mask=block())
    np.testing.assert_array_equal(both.flow, estimate_flow(np.nan_to_num(frames[0]), np.nan_to_num(frames[1]),
                                                           mask=masks | block()).flow)  # fmt: skip


# -- the parts -----------------------------------------------------------------------------------


def test_masked_pixels_take_the_value_of_a_nearest_valid_one():
    rng = np.random.default_rng(3)
    frame, hidden = rng.uniform(size=(9, 11)), rng.uniform(size=(9, 11)) < 0.7
    filled = fill(frame, hidden)
    np.testing.assert_array_equal(filled[~hidden], frame[~hidden])
    valid = np.argwhere(~hidden)
    for pixel in np.argwhere(hidden):
        distances = np.hypot(*(valid - pixel).T)
        nearest = valid[distances == distances.min()]
        assert filled[tuple(pixel)] in frame[tuple(nearest.T)]
    np.testing.assert_array_equal(fill(filled, hidden), filled)
    assert fill(frame, np.zeros_like(hidden)) is frame


def test_samples_are_bilinear():
    rng = np.random.default_rng(4)
    image, flow = rng.uniform(size=(7, 9)), rng.uniform(-3, 3, (2, 7, 9))
    found = sample(image, flow)
    for i in range(7):
        for j in range(9):
            y, x = min(max(i + flow[1, i, j], 0), 6), min(max(j + flow[0, i, j], 0), 8)
            top, left = min(int(y), 5), min(int(x), 7)
            a, b = y - top, x - left
            rows = (1 - a) * image[top] + a * image[top + 1]
            assert found[i, j] == pytest.approx((1 - b) * rows[left] + b * rows[left + 1])


def weighted_case(kind, params):
    rng = np.random.default_rng(5)
    frames, u = rng.uniform(0, 255, (2, 10, 12)), rng.normal(0, 0.4, (2, 10, 12))
    valid0, valid1 = rng.uniform(0.2, 1, (2, 10, 12))
    valid0[2:5, 3:6] = 0.0
    valid1[6:9, 5:9] = 0.0
    weights = valid0 * sample(valid1, u)
    plain = kind(*frames, params).at(u)
    plain = type(plain)(plain.rho_c.copy(), plain.gradient.copy())
    return u, weights, plain, Masked(kind(*frames, params), valid0, valid1).at(u)


@pytest.mark.parametrize("kind", [Brightness, ImageAndGradient])
def test_residuals_are_weighted_pixel_by_pixel(kind):
    _, weights, plain, masked = weighted_case(kind, FlowParams(lambda_gradient=1.0))
    assert 0 < (weights == 0).sum() < weights.size / 2
    np.testing.assert_allclose(masked.rho_c, weights * plain.rho_c, rtol=1e-12)
    np.testing.assert_allclose(masked.gradient, weights * plain.gradient, rtol=1e-12)


def test_the_energy_has_the_weights_by_finite_differences():
    """dE/dv = (v - u) / theta + lambda w sign(rho) grad I1, with rho from the frames without weights."""
    lambda_, theta, step = 0.4, 0.3, 1e-5
    u, weights, plain, masked = weighted_case(Brightness, FlowParams())
    operator = ForwardDifferences(1.0, u.shape[1:], np.float64)
    v = u + np.random.default_rng(6).normal(0, 0.5, u.shape)
    rho = plain.rho_c + (plain.gradient * v).sum(axis=0)
    expected = (v - u) / theta + lambda_ * weights * np.sign(rho) * plain.gradient
    for c, i, j in np.ndindex(u.shape):
        moved = [v.copy(), v.copy()]
        moved[0][c, i, j] -= step
        moved[1][c, i, j] += step
        low, high = (energy(operator, u, each, masked, lambda_, theta) for each in moved)
        assert (high - low) / (2 * step) == pytest.approx(expected[c, i, j], rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(("step", "kind"), [
    (PenaltyStep, Brightness), (MultiplierStep, Brightness), (ChannelStep, ImageAndGradient)
])  # fmt: skip
def test_v_steps_leave_the_flow_where_no_data_count(step, kind):
    params = FlowParams(lambda_gradient=1.0, dtype="float64")
    u, weights, _, masked = weighted_case(kind, params)
    target = step(u, params).target(u, masked)
    np.testing.assert_allclose(target[:, weights == 0], u[:, weights == 0], atol=1e-12)
    assert np.abs(target - u)[:, weights > 0].max() > 1e-3


def test_shares_follow_the_pyramid():
    masks = np.stack([block(), ~block()])
    shapes = pyramid.scale_shapes(SHAPE, 0.5, 3)
    first, second = valid_shares(masks, shapes, 0.5, np.dtype("float64"))
    np.testing.assert_array_equal(first[0], 1.0 - block())
    assert [share.shape for share in first] == shapes
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(a + b, 1.0, atol=0.1)  # each is clipped to 0..1
        assert a.min() >= 0.0 and a.max() <= 1.0
    assert first[1][0, 0] == 1.0 and first[1][9, 13] < 1e-4


def test_shares_stay_in_their_range_where_the_pyramid_overshoots():
    mask = np.random.default_rng(0).uniform(size=SHAPE) < 0.5
    shapes = pyramid.scale_shapes(SHAPE, 0.95, 4)
    (first, _) = valid_shares(mask, shapes, 0.95, np.dtype("float64"))
    assert min(share.min() for share in first) == 0.0 and max(share.max() for share in first) == 1.0
