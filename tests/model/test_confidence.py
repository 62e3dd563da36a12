from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench import estimate_flow
from fracbench.model.confidence import check_backward

QUICK = {"n_warps": 2, "max_iter": 5}


def test_the_distance_and_the_rule_pixel_by_pixel():
    rng = np.random.default_rng(0)
    height, width = 12, 16
    flow, backward = rng.normal(0, 0.55, (2, 2, height, width))
    flow[0] += 5.0  # so long that it counts in the rule
    backward[0] -= 5.0
    found = check_backward(flow, backward)
    agreeing = 0
    for i in range(height):
        for j in range(width):
            w = flow[:, i, j]
            x, y = j + w[0], i + w[1]
            if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
                assert found.distance[i, j] == np.inf and not found.agrees[i, j]
                continue
            left, top = min(int(x), width - 2), min(int(y), height - 2)
            a, b = x - left, y - top
            upper = (1 - a) * backward[:, top, left] + a * backward[:, top, left + 1]
            lower = (1 - a) * backward[:, top + 1, left] + a * backward[:, top + 1, left + 1]
            back = (1 - b) * upper + b * lower
            assert found.distance[i, j] == pytest.approx(np.hypot(*(w + back)), rel=1e-5)
            limit = 0.01 * (w @ w + back @ back) + 0.5
            assert found.agrees[i, j] == ((w + back) @ (w + back) < limit)
            agreeing += found.agrees[i, j]
    assert 3 < agreeing < height * width / 2
    np.testing.assert_array_equal(found.backward, backward)


def test_opposite_flows_agree_everywhere_inside():
    flow = np.zeros((2, 9, 12), np.float32)
    flow[0], flow[1] = 2.0, -1.0
    found = check_backward(flow, -flow)
    assert found.distance.dtype == np.float32
    np.testing.assert_array_equal(found.agrees[1:, :-2], True)
    np.testing.assert_array_equal(found.distance[1:, :-2], 0.0)
    np.testing.assert_array_equal(found.distance[0], np.inf)
    np.testing.assert_array_equal(found.distance[:, -2:], np.inf)


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb_alpha"])
def test_estimates_come_with_their_confidence_on_request(method):
    frames = ref.translated_pair((40, 48), (1.6, -1.2))
    plain = estimate_flow(*frames, method=method, **QUICK)
    result = estimate_flow(*frames, method=method, confidence=True, **QUICK)
    back = estimate_flow(*frames[::-1], method=method, **QUICK)
    assert plain.confidence is None
    np.testing.assert_array_equal(result.flow, plain.flow)
    np.testing.assert_array_equal(result.confidence.backward, back.flow)
    expected = check_backward(plain.flow, back.flow)
    np.testing.assert_array_equal(result.confidence.distance, expected.distance)
    np.testing.assert_array_equal(result.confidence.agrees, expected.agrees)
    assert result.confidence.agrees[8:-8, 8:-8].all()
    assert result.seconds["backward"] > 0.0 and "backward" not in plain.seconds


def test_the_masks_of_the_frames_change_places_on_the_way_back():
    frames, masks = np.stack(ref.translated_pair((40, 48), (1.6, -1.2))), np.zeros((2, 40, 48), bool)
    masks[0, 4:14, 5:19], masks[1, 22:30, 25:41] = True, True
    found = estimate_flow(*frames, mask=masks, confidence=True, **QUICK).confidence
    back = estimate_flow(*frames[::-1], mask=masks[::-1], **QUICK)
    np.testing.assert_array_equal(found.backward, back.flow)


def test_the_way_back_does_not_start_from_the_flow_on_the_way_there():
    frames, start = ref.translated_pair((40, 48), (1.6, -1.2)), np.full((2, 40, 48), 3.0)
    found = estimate_flow(*frames, initial_flow=start, confidence=True, n_scales=1, **QUICK)
    np.testing.assert_array_equal(
        found.confidence.backward, estimate_flow(*frames[::-1], n_scales=1, **QUICK).flow
    )


def test_a_square_that_moves_over_the_background_is_distrusted_where_it_hides_it():
    y, x = np.mgrid[:48, :64].astype(float)
    background, square = ref.texture(x, y, 1), ref.texture(x, y, 2)
    moved = ref.texture(x - 6, y, 2)
    frame0 = np.where((abs(y - 24) < 10) & (abs(x - 26) < 10), square, background)
    frame1 = np.where((abs(y - 24) < 10) & (abs(x - 32) < 10), moved, background)
    agrees = estimate_flow(frame0, frame1, confidence=True).confidence.agrees
    hidden = (abs(y - 24) < 8) & (x > 36) & (x < 41)
    open_ = (abs(y - 24) > 16) & (abs(x - 32) < 24)
    assert agrees[hidden].mean() < 0.5 < 0.85 < agrees[open_].mean()
