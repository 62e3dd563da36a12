"""Worker processes on this machine: joblib's executor, one process a place."""

from __future__ import annotations

import atexit
import enum
import os
import signal
import threading
import time
import typing
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import connection
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from fracbench.errors import FracbenchError
from fracbench.harness import provenance, spool
from fracbench.harness.job import Job
from fracbench.harness.memory import return_what_is_freed
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
        self._busy: dict[Connection, _Place] = {}
        self._rested: list[_Place] = []
        self._stillborn = 0

    def free(self) -> int:
        """Return the number of places without a job."""
        return self._jobs - len(self._busy)

    def start(self, job: Job) -> None:
        """Start a job in an idle process, or in a new one."""
        while True:
            place = self._rested.pop() if self._rested else _idle.pop() if _idle else _Place()
            if place.give(job, self._folder):
                self._busy[place.line] = place
                return
            _close([place])  # it died while it was idle

    def wait(self, seconds: float) -> list[tuple[str, Row | None]]:
        """Return the keys of jobs that ended or took too long, with their rows; no row if the process died.

        Raises
        ------
        FracbenchError
            Processes die before they are ready, or a row could not be written to the spool.
        """
        if not self._busy:
            time.sleep(seconds)
        until = time.monotonic() + seconds
        found: list[tuple[str, Row | None]] = []
        while not found and (left := until - time.monotonic()) > 0.0 and self._busy:
            for line in connection.wait(list(self._busy), left):
                found += self._hear(self._busy[typing.cast("Connection", line)])
        overdue = [place for place in self._busy.values() if place.overdue()]
        return [*found, *map(self._give_up, overdue)]

    def _hear(self, place: _Place) -> list[tuple[str, Row | None]]:
        """Take what a process says: nothing if its job goes on."""
        try:
            said = place.hear()
        except (EOFError, OSError):
            return self._bury(place)
        if said is _Word.ENDED:
            self._stillborn = 0
            del self._busy[place.line]
            self._rested.append(place)
            return [(place.job.key, spool.read(self._folder, place.job.key))]
        if isinstance(said, str):
            raise FracbenchError(said)
        return []

    def _bury(self, place: _Place) -> list[tuple[str, Row | None]]:
        del self._busy[place.line]
        _close([place])
        if place.ready:
            self._stillborn = 0
            return [(place.job.key, spool.read(self._folder, place.job.key))]
        self._stillborn += 1
        if self._stillborn == MAX_STILLBORN:
            raise FracbenchError("worker processes die before they begin with a point (out of memory?)")
        self.start(place.job)
        return []

    def _give_up(self, place: _Place) -> tuple[str, Row]:
        del self._busy[place.line]
        _close([place])
        return place.job.key, spool.read(self._folder, place.job.key) or place.job.expired(provenance.machine())

    def close(self) -> None:
        """Kill the processes that have a job, which is given up."""
        _close(list(self._busy.values()))
        for place in self._rested:
            place.rest()
        _idle.extend(self._rested)
        self._busy, self._rested = {}, []


def dismiss() -> None:
    """Kill the idle processes: they have nothing to lose, and loky would wait for one after the other."""
    _close(_idle)
    _idle.clear()


def _close(places: Sequence[_Place]) -> None:
    with warnings.catch_warnings(), ThreadPoolExecutor(max(1, len(places))) as side_by_side:
        warnings.simplefilter("ignore")  # that there is no `pgrep` to find the children of a worker
        list(side_by_side.map(_Place.close, places))


class _Word(enum.Enum):
    """What a worker says; a sentence instead says what went wrong."""

    READY = enum.auto()
    ESTIMATING = enum.auto()
    ESTIMATED = enum.auto()
    ENDED = enum.auto()


class _Place:
    """One executor with one process, and a line to it.

    The executor starts the process and takes it down. While a crew works, the process serves: jobs go to it, and
    its words come back, over the line, which takes a fraction of the time that a task of the executor does. The
    line breaks with the process.
    """

    def __init__(self) -> None:
        from joblib.externals.loky import ProcessPoolExecutor
        from joblib.externals.loky.backend import get_context

        # loky ends a process that has grown by 100 MB when it rests, and says so if it is to serve again already.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        threads = dict.fromkeys(_THREADS, "1")
        self.line, theirs = get_context().Pipe()
        mine = os.getpid(), theirs
        self._executor = ProcessPoolExecutor(1, initializer=_get_ready, initargs=mine, env=threads)
        self._submit(os.getpid)
        theirs.close()  # or the line would not break
        self._serving = self.ready = False
        self._began: float | None = None

    def _submit(self, function: Callable[[], Any]) -> None:
        with _deaf_to_ctrl_c():
            self._executor.submit(function)

    def give(self, job: Job, folder: Path) -> bool:
        """Start a job; False if the process has died while it was idle."""
        from joblib.externals.loky.process_executor import BrokenProcessPool

        try:
            if not self._serving:
                self._submit(partial(_serve, _compute, folder, os.getpid()))
                self._serving, self.ready = True, False
            self.line.send(job)
        except (BrokenProcessPool, OSError):
            return False
        self.job = job
        return True

    def hear(self) -> _Word | str:
        """Return the next thing that the process says; EOFError or OSError if it has died."""
        said: _Word | str = self.line.recv()
        self.ready = True
        self._began = time.monotonic() if said is _Word.ESTIMATING else None
        return said

    def overdue(self) -> bool:
        """Tell whether the estimate, which alone is timed, runs for longer than it may."""
        allowed = self.job.timeout
        return self._began is not None and allowed is not None and time.monotonic() - self._began > allowed

    def rest(self) -> None:
        """Let the process serve no longer: the interpreter's exit would wait for it."""
        self._serving = False
        with suppress(OSError):
            self.line.send(None)

    def close(self) -> None:
        """Kill the process."""
        self._executor.shutdown(wait=True, kill_workers=True)
        self.line.close()


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


_line: Connection  # a worker's, to its parent


def _get_ready(parent: int, line: Connection) -> None:
    """In a worker: see to it that it ends with its parent, and import what points need."""
    global _line
    _line = line
    return_what_is_freed()
    threading.Thread(target=_end_with, args=(parent,), name="parent", daemon=True).start()
    from fracbench.harness import task  # noqa: F401


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_SECONDS)
    os._exit(1)


def _serve(compute: Callable[[Job, Path, int], None], folder: Path, parent: int) -> None:
    """In a worker: take jobs from the line and compute them, until there is None."""
    _line.send(_Word.READY)
    while (job := _line.recv()) is not None:
        try:
            compute(job, folder, parent)
        except BaseException as exc:
            _line.send(_explain(exc, folder))
        else:
            _line.send(_Word.ENDED)


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
    _line.send(_Word.ESTIMATING)
    try:
        yield
    finally:
        _line.send(_Word.ESTIMATED)


def _explain(error: BaseException, folder: Path) -> str:
    if isinstance(error, OSError):
        return f"{folder}: {error.strerror}; free some space or make it writable, and run the same command again"
    return f"a worker process failed: {type(error).__name__}: {error}"
