from __future__ import annotations

import weakref

import numpy as np
import pytest

from fracbench import estimate_flow, estimate_flows
from fracbench.errors import InputError

QUICK = {"n_warps": 1, "max_iter": 2}


@pytest.fixture
def frames():
    """Four frames of a texture that moves to the right."""
    x = np.arange(24) - np.arange(4)[:, None, None]
    return np.round(127 + 60 * np.cos(0.5 * x) * np.cos(0.4 * np.arange(20)[:, None])).astype(np.uint8)


def test_each_flow_is_that_of_two_frames(frames):
    results = list(estimate_flows(frames, alpha=0.7, **QUICK))
    assert len(results) == 3
    for result, first, second in zip(results, frames, frames[1:], strict=False):
        np.testing.assert_array_equal(result.flow, estimate_flow(first, second, alpha=0.7, **QUICK).flow)


def test_frames_are_taken_when_their_flow_is_asked_for_and_given_up(frames):
    alive = []

    class Frame(np.ndarray):
        pass

    def clip():
        for _ in range(10**9):  # no list could hold them
            frame = frames[0].copy().view(Frame)
            alive.append(weakref.ref(frame))
            yield frame

    flows = estimate_flows(clip(), **QUICK)
    assert alive == []
    for count in range(2, 6):
        next(flows)
        assert len(alive) == count
    assert sum(frame() is not None for frame in alive) <= 3


def test_a_frame_that_cannot_be_used_is_named_by_its_number(frames):
    flows = estimate_flows([frames[0], frames[1], frames[2][1:]], **QUICK)
    next(flows)
    with pytest.raises(InputError, match=r"frames differ in size: .*\(frames 1 and 2 of the clip\)"):
        next(flows)


@pytest.mark.parametrize("count", [0, 1])
def test_a_clip_has_two_frames(frames, count):
    with pytest.raises(InputError, match=f"a clip has two or more frames, got {count}"):
        list(estimate_flows(iter(frames[:count])))


def test_settings_are_those_of_a_flow(frames):
    with pytest.raises(InputError, match="unknown parameter 'lamda': did you mean 'lambda'"):
        list(estimate_flows(frames, lamda=0.3))
