"""Worker processes and Ctrl-C."""

from __future__ import annotations

import signal
from concurrent.futures import ThreadPoolExecutor

from fracbench.harness.run.pool import _ctrl_c_ignored


def handler_inside():
    with _ctrl_c_ignored():
        return signal.getsignal(signal.SIGINT)


def test_processes_are_started_with_ctrl_c_ignored():
    before = signal.getsignal(signal.SIGINT)
    assert handler_inside() is signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_which_may_set_no_handler_starts_them_too():
    before = signal.getsignal(signal.SIGINT)
    with ThreadPoolExecutor(1) as other:
        assert other.submit(handler_inside).result() is before
