from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench import estimate_flow
from fracbench.errors import InputError
from fracbench.model import pyramid
from fracbench.model.coarse_to_fine import check_initial_flow

METHODS = pytest.mark.parametrize(
    "method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha", "tvl1_sb_alpha_map", "tvl1_sb_alpha_ic"]
)
QUICK = {"n_warps": 2, "max_iter": 5, "inner": "warm", "coupling": "multiplier", "u_solver": "exact"}
MOTION = (11.4, -8.7)


def constant(motion, shape):
    return np.broadcast_to(np.reshape(motion, (2, 1, 1)), (2, *shape)).astype(np.float32)


def median_error(flow, motion):
    return np.median(np.hypot(flow[0] - motion[0], flow[1] - motion[1]))


@METHODS
@pytest.mark.parametrize("n_scales", [1, 2])
def test_a_motion_too_large_for_few_scales_is_found_from_a_start_near_it(method, n_scales):
    shape = (56, 72)
    frames = ref.translated_pair(shape, MOTION)
    start = constant((11.0, -8.4), shape)
    alone = estimate_flow(*frames, method=method, n_scales=n_scales, **QUICK).flow
    started = estimate_flow(*frames, method=method, n_scales=n_scales, initial_flow=start, **QUICK).flow
    assert median_error(alone, MOTION) > 3.0
    assert median_error(started, MOTION) < 0.2  # that of the start is 0.5


@METHODS
def test_a_start_of_zero_is_the_default(method):
    frames = ref.translated_pair((24, 30), (0.6, -0.4))
    start = np.zeros((2, 24, 30), int)
    expected = estimate_flow(*frames, method=method, **QUICK).flow
    np.testing.assert_array_equal(
        estimate_flow(*frames, method=method, initial_flow=start, **QUICK).flow, expected
    )


def test_the_start_is_never_changed():
    frames = ref.translated_pair((24, 30), (0.6, -0.4))
    start = np.random.default_rng(0).normal(0, 0.3, (2, 24, 30)).astype(np.float32)
    copy = start.copy()
    start.flags.writeable = False
    estimate_flow(*frames, initial_flow=start, n_scales=1, **QUICK)
    np.testing.assert_array_equal(start, copy)


def test_a_flow_is_downsampled_with_its_values():
    """A linear flow stays linear; at (i, j) of the coarse scale lies (i H/h, j W/w) of the fine one."""
    shape = (61, 90)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    flow = np.stack([2.0 + 0.10 * x - 0.05 * y, -1.0 + 0.03 * x + 0.08 * y])
    shapes = pyramid.scale_shapes(shape, 0.5, 3)
    coarse = pyramid.downsample_flow(flow, shapes, 0.5)
    h, w = shapes[-1]
    assert coarse.shape == (2, h, w) == (2, 16, 23)
    y, x = np.mgrid[:h, :w] * np.reshape([shape[0] / h, shape[1] / w], (2, 1, 1))
    expected = np.stack([(2.0 + 0.10 * x - 0.05 * y) * w / 90, (-1.0 + 0.03 * x + 0.08 * y) * h / 61])
    np.testing.assert_allclose(coarse[:, 3:-3, 3:-3], expected[:, 3:-3, 3:-3], atol=0.03)


def test_a_start_that_cannot_be_used_is_named_with_its_first_bad_pixel():
    with pytest.raises(InputError, match=r"shape \(2, 20, 25\) given, \(2, 20, 26\) needed"):
        check_initial_flow(np.zeros((2, 20, 25)), (20, 26))
    start = np.zeros((2, 20, 26))
    check_initial_flow(start, (20, 26))
    start[0, 3, 5], start[1, 17, 2] = np.nan, np.inf
    with pytest.raises(InputError, match=r"2 of 520 pixels are .* the first at row 3, column 5"):
        check_initial_flow(start, (20, 26))
