"""Threads share the lines; the flow does not depend on their number."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from numba import config

from fracbench import estimate_flow
from fracbench.errors import InputError
from fracbench.model import regularizers, v_steps
from fracbench.model.kernels import threads as threads_module
from fracbench.model.kernels.cosine import LINES
from fracbench.model.kernels.threads import count, parallel_for, parallel_map, use_threads, worth_threads
from fracbench.model.operators import zero


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
@pytest.mark.parametrize(("lines", "least"), [(1, 64), (130, 64), (200, 16), (4, 1), (641, 64)])
def test_every_line_is_taken_once(threads, lines, least):
    taken = np.zeros(lines, int)
    starts = []

    def work(start, stop):
        starts.append(start)
        taken[start:stop] += 1

    with use_threads(threads):
        parallel_for(work, lines, least)
    np.testing.assert_array_equal(taken, 1)
    assert len(starts) == min(threads, max(1, lines // least))
    if least >= LINES:
        assert all(start % LINES == 0 for start in starts)


def test_each_gives_the_results_in_order():
    for threads in (1, 2, 5):
        with use_threads(threads):
            assert parallel_map(lambda x: x * x, range(5)) == [0, 1, 4, 9, 16]


def test_ranges_run_at_the_same_time():
    meeting = threading.Barrier(2, timeout=30)  # breaks if one range waits for the other
    with use_threads(2):
        parallel_for(lambda a, b: meeting.wait(), 2, least=1)


@pytest.mark.parametrize("threads", [1, 2, 3, 4, 7])
def test_a_range_shares_on_among_the_threads_left_to_it(threads):
    taken, at_once = np.zeros((2, 6), int), []

    def component(start, stop):
        for c in range(start, stop):
            at_once.append(count())

            def lines(a, b, c=c):
                taken[c, a:b] += 1

            parallel_for(lines, 6, least=1)

    with use_threads(threads):
        parallel_for(component, 2, least=1)
        assert count() == threads
    np.testing.assert_array_equal(taken, 1)
    assert at_once == [max(1, threads // 2)] * 2


def test_an_error_in_any_thread_is_raised():
    def work(start, stop):
        if start:
            raise ValueError("in the second range")

    with use_threads(2), pytest.raises(ValueError, match="in the second range"):
        parallel_for(work, 2, least=1)


@pytest.mark.skipif(config.DISABLE_JIT, reason="takes minutes without compilation")
@pytest.mark.parametrize(
    ("method", "boundary"),
    [("tvl1_sb_alpha", "reflect"), ("tvl1_sb_alpha", "zero"), ("tvl1_sb", None), ("tvl1", None)],
)
def test_the_flow_does_not_depend_on_the_number_of_threads(method, boundary, monkeypatch):
    monkeypatch.setattr(threads_module, "LEAST_PIXELS", 0)  # all scales, and all that is shared
    monkeypatch.setattr(v_steps, "LEAST_LIGHT_LINES", 64)
    monkeypatch.setattr(zero, "BLOCK_ROWS", 50)
    rng = np.random.default_rng(2)
    frame0 = rng.uniform(0, 255, (150, 210))
    frame1 = np.roll(frame0, 1, axis=1)
    settings = {} if boundary is None else {"boundary": boundary, "alpha": 1.3}
    flows = [
        estimate_flow(frame0, frame1, method=method, threads=n, n_warps=2, max_iter=4, **settings).flow
        for n in (1, 2, 3, 4)
    ]
    for other in flows[1:]:
        np.testing.assert_array_equal(other, flows[0])


def test_one_thread_takes_an_image_too_small_for_more():
    with use_threads(3):
        for pixels, team in ((threads_module.LEAST_PIXELS, 3), (threads_module.LEAST_PIXELS - 1, 1)):
            with worth_threads(pixels):
                assert count() == team
            assert count() == 3


def test_the_threads_of_a_flow_share_its_large_scales_alone(monkeypatch):
    teams = []

    def noted(*args):
        teams.append(count())
        return parallel_map(*args)

    monkeypatch.setattr(regularizers, "parallel_map", noted)
    frame = np.random.default_rng(2).uniform(0, 255, (160, 200))
    result = estimate_flow(frame, frame, threads=2, n_scales=2, n_warps=1, max_iter=1)
    assert [level.shape for level in result.levels] == [(80, 100), (160, 200)]
    assert teams == [1, 2]


@pytest.mark.parametrize("threads", [0, -1])
def test_fewer_than_one_thread_is_refused(threads):
    frame = np.zeros((20, 20))
    with pytest.raises(InputError, match=f"`threads` must be at least 1, got {threads}"):
        estimate_flow(frame, frame, threads=threads)
