"""Worker processes on this machine: joblib's executor, one process a place."""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from fracbench.errors import FracbenchError
from fracbench.harness import provenance, spool
from fracbench.harness.job import Job
from fracbench.harness.store import Row

#: So many workers in a row may die before they are ready for a point.
MAX_STILLBORN = 2

_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"
)  # fmt: skip
_LOOK_SECONDS = 0.5


class Crew(Protocol):
    """What runs jobs, here or elsewhere; each in a process where nothing else runs."""

    #: Whether a job that has lost its worker once must not share the machine with another.
    retry_alone: bool

    def free(self) -> int:
        """Return how many jobs could be started now."""
        ...

    def start(self, job: Job) -> None:
        """Start a job; only if a place is free."""
        ...

    def wait(self, seconds: float) -> list[tuple[str, Row | None]]:
        """Return the keys of jobs that ended, after `seconds` at most; no row if the worker died."""
        ...

    def close(self) -> None:
        """Stop at once what still runs."""
        ...


@dataclass
class _Run:
    """A job in its place."""

    place: _Place
    job: Job

    def overdue(self) -> bool:
        """Tell whether the estimate, which alone is timed, runs for longer than it may."""
        began, allowed = self.place.began(), self.job.timeout
        return began is not None and allowed is not None and time.monotonic() - began > allowed


class LocalCrew:
    """Processes on this machine, one for each place.

    Each place has an executor of its own, so that a death concerns one job and no other. A row comes by the
    spool: a process that dies right after it has written one has lost nothing. Idle processes stay for the next
    crew, as starting one takes a second. The time that a job may take is kept here, where nothing that it does can
    stop the clock.

    Parameters
    ----------
    jobs : int
        Places; a process is started when a job needs it.
    folder : Path
        The spool.
    """

    retry_alone = True

    def __init__(self, jobs: int, folder: Path) -> None:
        self._jobs, self._folder = jobs, folder.resolve()
        self._busy: dict[Future[None], _Run] = {}
        self._stillborn = 0

    def free(self) -> int:
        """Return the number of places without a job."""
        return self._jobs - len(self._busy)

    def start(self, job: Job) -> None:
        """Start a job in an idle process, or in a new one."""
        from joblib.externals.loky.process_executor import BrokenProcessPool

        while True:
            place = _idle.pop() if _idle else _Place()
            try:
                future = place.submit(partial(_compute, job, self._folder, os.getpid()))
            except BrokenProcessPool:  # it died while it was idle
                continue
            self._busy[future] = _Run(place, job)
            return

    def wait(self, seconds: float) -> list[tuple[str, Row | None]]:
        """Return the keys of jobs that ended or took too long, with their rows; no row if the process died.

        Raises
        ------
        FracbenchError
            Processes die before they are ready, or a row could not be written to the spool.
        """
        if not self._busy:
            time.sleep(seconds)
        ended, _ = wait(self._busy, seconds, FIRST_COMPLETED)
        overdue = {future for future, run in self._busy.items() if run.overdue()} - ended
        found = [end for future in ended if (end := self._end(future)) is not None]
        return [*found, *map(self._give_up, overdue)]

    def _end(self, future: Future[None]) -> tuple[str, Row | None] | None:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        run = self._busy.pop(future)
        error = future.exception()
        if error is None:
            _idle.append(run.place)
        else:
            _close([run.place])
            if not isinstance(error, BrokenProcessPool):
                raise FracbenchError(_explain(error, self._folder)) from error
            if run.place.stillborn():
                self._count_stillborn(error)
                self.start(run.job)
                return None
        self._stillborn = 0
        return run.job.key, spool.read(self._folder, run.job.key)

    def _give_up(self, future: Future[None]) -> tuple[str, Row]:
        run = self._busy.pop(future)
        _close([run.place])
        return run.job.key, spool.read(self._folder, run.job.key) or run.job.expired(provenance.machine())

    def _count_stillborn(self, error: BaseException) -> None:
        self._stillborn += 1
        if self._stillborn == MAX_STILLBORN:
            raise FracbenchError("worker processes die before they begin with a point (out of memory?)") from error

    def close(self) -> None:
        """Kill the processes that have a job, which is given up."""
        places = [run.place for run in self._busy.values()]
        self._busy = {}
        _close(places)


def dismiss() -> None:
    """Kill the idle processes: they have nothing to lose, and loky would wait for one after the other."""
    _close(_idle)
    _idle.clear()


def _close(places: Sequence[_Place]) -> None:
    with warnings.catch_warnings(), ThreadPoolExecutor(max(1, len(places))) as side_by_side:
        warnings.simplefilter("ignore")  # that there is no `pgrep` to find the children of a worker
        list(side_by_side.map(_Place.close, places))


class _Place:
    """One executor with one process, which rings a bell when an estimate begins and when it ends."""

    def __init__(self) -> None:
        from joblib.externals.loky import ProcessPoolExecutor
        from joblib.externals.loky.backend import get_context

        # loky replaces a process that has grown by 100 MB, and says so if a job is waiting already.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        threads = dict.fromkeys(_THREADS, "1")
        self._bell = get_context().SimpleQueue()
        self._began: float | None = None
        mine = os.getpid(), self._bell
        self._executor = ProcessPoolExecutor(1, initializer=_get_ready, initargs=mine, env=threads)
        self._ready = self.submit(os.getpid)

    def submit(self, function: Any) -> Future[Any]:
        with _deaf_to_ctrl_c():
            future: Future[Any] = self._executor.submit(function)
        return future

    def began(self) -> float | None:
        """Return when the estimate that runs now was first heard of, or None if none runs; empty the pipe."""
        while not self._bell.empty():
            self._began = time.monotonic() if self._bell.get() else None
        return self._began

    def stillborn(self) -> bool:
        """Tell whether the process died before it was ready."""
        return self._ready.exception() is not None

    def close(self) -> None:
        """Kill the process."""
        self._executor.shutdown(wait=True, kill_workers=True)


_idle: list[_Place] = []
atexit.register(_idle.clear)  # loky cannot be taken down after the modules that it needs


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Let processes that are started here ignore Ctrl-C, which the terminal sends to all: the parent acts."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # its start, with the first worker, would lift the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_bell: Any = None


def _get_ready(parent: int, bell: Any) -> None:
    """In a worker: see to it that it ends with its parent, and import what points need."""
    global _bell
    _bell = bell
    threading.Thread(target=_end_with, args=(parent,), name="parent", daemon=True).start()
    from fracbench.harness import task  # noqa: F401


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_SECONDS)
    os._exit(1)


def _compute(job: Job, folder: Path, parent: int) -> None:
    """In a worker: compute a job and leave its row in the spool."""
    from fracbench.harness import task

    row = job.row(task.run_point(job.point, job.folder, _timed))
    if os.getppid() != parent:
        os._exit(1)  # a sweep that was started since may be computing this point
    spool.write(folder, row)


@contextmanager
def _timed() -> Iterator[None]:
    """Let the parent, whose clock no computation stops, know that an estimate runs."""
    _bell.put(True)
    try:
        yield
    finally:
        _bell.put(False)


def _explain(error: BaseException, folder: Path) -> str:
    if isinstance(error, OSError):
        return f"{folder}: {error.strerror}; free some space or make it writable, and run the same command again"
    return f"a worker process failed: {type(error).__name__}: {error}"
