"""Malformed masks and initial flows: one line each that says which array, and the shape or type it must have."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench import estimate_flow
from fracbench.errors import InputError

FRAMES = np.random.default_rng(0).uniform(0, 255, (2, 20, 26))


def refused(message, **values):
    with pytest.raises(InputError, match=message) as caught:
        estimate_flow(*FRAMES, **values)
    assert "\n" not in str(caught.value)


def flow_with(value):
    flow = np.zeros((2, 20, 26))
    flow[1, 3, 7] = value
    return flow


@pytest.mark.parametrize(
    ("flow", "message"),
    [
        (np.zeros((2, 20, 25)), r"`initial_flow`: shape \(2, 20, 25\) given, \(2, 20, 26\) needed"),
        (np.zeros((20, 26, 2)), r"`initial_flow`: shape \(20, 26, 2\) given"),
        (np.zeros((20, 26)), r"`initial_flow`: shape \(20, 26\) given"),
        (3.0, r"`initial_flow`: shape \(\) given"),
        (np.zeros((2, 20, 26), complex), "`initial_flow` must be an array of real numbers"),
        (np.zeros((2, 20, 26), bool), "`initial_flow` must be an array of real numbers"),
        ([[1.0], [2.0, 3.0]], "`initial_flow` must be an array of real numbers"),
        ("flow.flo", "`initial_flow` must be an array of real numbers"),
        (flow_with(np.nan), "`initial_flow`: 1 of 520 pixels are NaN, infinite or unknown, .* row 3, column 7"),
        (flow_with(np.inf), "`initial_flow`: 1 of 520 pixels"),
        (flow_with(1e300), "`initial_flow`: 1 of 520 pixels"),
        (flow_with(1e9), "`initial_flow`: 1 of 520 pixels"),
    ],
)
@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb_alpha_map"])
def test_initial_flows(flow, message, method):
    refused(message, initial_flow=flow, method=method)


def mask_of(value):
    return np.full((20, 26), value)


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros((20, 25), bool), r"`mask`: shape \(20, 25\) given, \(20, 26\) or \(2, 20, 26\) needed"),
        (np.zeros((26, 20), bool), r"`mask`: shape \(26, 20\) given"),
        (np.zeros((3, 20, 26), bool), r"`mask`: shape \(3, 20, 26\) given"),
        (np.zeros((1, 26), bool), r"`mask`: shape \(1, 26\) given"),
        (True, r"`mask`: shape \(\) given"),
        (mask_of(1), "`mask` must be an array of bool, true where a pixel does not count"),
        (mask_of(0.0), "`mask` must be an array of bool"),
        (mask_of("no"), "`mask` must be an array of bool"),
        ([[True], [True, False]], "`mask` must be an array of bool"),
        (mask_of(True), "`mask`: all 520 pixels of frame0 are masked; no data are left"),
        (np.stack([mask_of(False), mask_of(True)]), "`mask`: all 520 pixels of frame1 are masked"),
    ],
)
def test_masks(mask, message):
    refused(message, mask=mask)


def test_frames_of_nan_alone():
    with pytest.raises(InputError, match="all 520 pixels of frame1 are masked"):
        estimate_flow(FRAMES[0], mask_of(np.nan))


def test_infinite_pixels_are_no_gaps():
    frame = FRAMES[0].copy()
    frame[2, 5], frame[0, 0] = np.inf, np.nan
    with pytest.raises(InputError, match="frame0: 1 of 520 pixels are infinite, the first at row 2, column 5"):
        estimate_flow(frame, FRAMES[1])


def test_methods_of_other_programs_take_no_mask():
    pytest.importorskip("cv2")
    refused("method 'opencv_dis' takes no `mask`$", mask=mask_of(False), method="opencv_dis")
    frame = FRAMES[0].copy()
    frame[2, 5] = np.nan
    with pytest.raises(InputError, match="takes no `mask`: frame0: 1 of 520 pixels are NaN"):
        estimate_flow(frame, FRAMES[1], method="opencv_dis")


def test_methods_of_other_programs_take_no_initial_flow():
    pytest.importorskip("cv2")
    refused("method 'opencv_dis' takes no `initial_flow`", initial_flow=flow_with(0.0), method="opencv_dis")
