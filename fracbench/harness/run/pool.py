"""Worker processes on this machine: joblib's, one a place."""

from __future__ import annotations

import enum
import os
import signal
import threading
import time
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol, TypeVar

from fracbench.errors import FracbenchError
from fracbench.harness.run import provenance, spool
from fracbench.harness.run.message import Job
from fracbench.harness.run.provenance import return_what_is_freed
from fracbench.harness.run.store import Row

T = TypeVar("T")

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

    A death concerns one job and no other. A row comes by the spool: a process that dies right after it has written
    one has lost nothing. Idle processes stay for the next crew, as starting one takes a second. The time that a
    job may take is kept here, where nothing that it does can stop the clock.

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
        self._spare: list[_Place] = []
        self._stillborn = 0

    def free(self) -> int:
        """Return the number of places without a job."""
        return self._jobs - len(self._busy)

    def start(self, job: Job) -> None:
        """Start a job in an idle process, or in a new one."""
        while True:
            place = self._spare.pop() if self._spare else _idle.pop() if _idle else _Place()
            if place.give(job, self._folder):
                self._busy[place.line] = place
                return
            place.close()  # it died while it was idle

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
            self._spare.append(place)
            return [(place.job.key, spool.read(self._folder, place.job.key))]
        if isinstance(said, str):
            raise FracbenchError(said)
        return []

    def _bury(self, place: _Place) -> list[tuple[str, Row | None]]:
        del self._busy[place.line]
        place.close()
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
        place.close()
        return place.job.key, spool.read(self._folder, place.job.key) or place.job.expired(provenance.machine())

    def close(self) -> None:
        """Kill the processes that have a job, which is given up."""
        for place in self._busy.values():
            place.close()
        _idle.extend(self._spare)
        self._busy, self._spare = {}, []


def side_by_side(
    function: Callable[..., T], arguments: Sequence[tuple[Any, ...]], jobs: int, kept: str
) -> Iterator[T]:
    """Call a function with each of some arguments in joblib's processes, from now on; yield the results in order.

    Parameters
    ----------
    function : callable
        What to call; in a process that may have been started in another folder.
    arguments : sequence of tuple
        A tuple a call.
    jobs : int
        Processes; if they are one, the calls are made here, each as its result is asked for.
    kept : str
        What is not lost if one of them dies, for the message.

    Raises
    ------
    FracbenchError
        A process died.
    """
    from joblib import Parallel, delayed, parallel_config

    with parallel_config("loky", inner_max_num_threads=1):
        pool = Parallel(min(jobs, max(len(arguments), 1)), return_as="generator", batch_size=1)
    return _outcomes(pool(delayed(function)(*each) for each in arguments), kept)


def _outcomes(outcomes: Iterator[T], kept: str) -> Iterator[T]:
    from joblib.externals.loky.process_executor import BrokenProcessPool

    try:
        yield from outcomes
    except BrokenProcessPool as exc:
        raise FracbenchError(
            f"a worker process died (out of memory, or a crash); {kept}, and the same command goes on from there"
        ) from exc


class _Word(enum.Enum):
    """What a worker says; a sentence instead says what went wrong."""

    READY = enum.auto()
    ESTIMATING = enum.auto()
    ESTIMATED = enum.auto()
    ENDED = enum.auto()


class _Place:
    """A process that computes the jobs which come over a line, and says over it how far it is.

    A line takes a fraction of the time that a task of an executor does; it breaks with the process.
    """

    def __init__(self) -> None:
        from joblib.externals.loky.backend import get_context

        context = get_context("loky")
        self.line, theirs = context.Pipe()
        threads = dict.fromkeys(_THREADS, "1")
        self._process = context.Process(target=_serve, args=(theirs, os.getpid()), daemon=True, env=threads)
        with _deaf_to_ctrl_c():
            self._process.start()
        theirs.close()  # or the line would not break

    @property
    def pid(self) -> int:
        """The number that the system gives the process."""
        pid: int = self._process.pid
        return pid

    def give(self, job: Job, folder: Path) -> bool:
        """Start a job; False if the process has died while it was idle."""
        from joblib.externals.loky.backend.reduction import dumps

        self.job, self.ready = job, False
        self._began: float | None = None
        try:
            self.line.send_bytes(dumps((_compute, job, folder)))
        except OSError:
            return False
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

    def close(self) -> None:
        """Kill the process."""
        if self._process.exitcode is None:
            os.kill(self.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
        self._process.join()
        self.line.close()


_idle: list[_Place] = []


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


def _serve(line: Connection, parent: int) -> None:
    """In a worker: compute the jobs that come over the line until it ends, or the parent does."""
    global _line
    _line = line
    return_what_is_freed()
    threading.Thread(target=_end_with, args=(parent,), name="parent", daemon=True).start()
    from fracbench.harness.run import compute_point as task  # noqa: F401

    with suppress(EOFError, OSError):
        while True:
            compute, job, folder = line.recv()
            line.send(_Word.READY)
            try:
                compute(job, folder, parent)
            except BaseException as exc:
                line.send(_explain(exc, folder))
            else:
                line.send(_Word.ENDED)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_SECONDS)
    os._exit(1)


def _compute(job: Job, folder: Path, parent: int) -> None:
    """In a worker: compute a job and leave its row in the spool."""
    from fracbench.harness.run import compute_point as task

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
