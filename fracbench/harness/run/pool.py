"""Worker processes: the pools that compute points, and a parallel map; here they are joblib's.

joblib ends all workers of a pool when one dies. So a worker stores the row of its point itself, and keeps a file,
its mark, while it computes one: the marks that remain tell which points may have been the cause.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Protocol, TextIO, TypeVar

from fracbench.errors import FracbenchError
from fracbench.harness.run import provenance
from fracbench.harness.run.point import Job
from fracbench.harness.run.store import Store, Values, encode

T = TypeVar("T")

#: The keys of jobs that ended, and their encoded rows: None if a worker died.
Ended = Generator[tuple[str, Values | None], None, None]

#: So many times in a row the workers may die before they begin with a point.
MAX_FALSE_STARTS = 2

_LOOK_SECONDS = 0.5
#: After its time an estimate is interrupted; if that does not help, the process ends this many seconds later.
_GRACE_SECONDS = 1.0


class Pool(Protocol):
    """Worker processes, each of which computes one point at a time."""

    #: Whether a job whose worker has died may have died with another's, and has to be computed alone next.
    retry_alone: bool
    #: The number of jobs that are claimed at once.
    ahead: int

    def compute(self, jobs: Iterable[Job]) -> Ended:
        """Compute jobs, taken as workers become free, maybe in another thread; yield their keys and rows.

        A row is in the store; it is None if the worker died. When the workers of all jobs die at once, the jobs
        that had not begun are left out. `jobs` may tell by ``__length_hint__`` how many they are.
        """
        ...

    def close(self) -> None:
        """Leave the workers."""
        ...


class LocalPool:
    """Processes of joblib on this machine, which stay for the next pool and put their rows into the store."""

    retry_alone = True
    ahead = 1

    def __init__(self, jobs: int, store: Store) -> None:
        self._jobs, self._store, self._path = jobs, store, store.path.resolve()
        self._marks = tempfile.TemporaryDirectory(prefix="fracbench-", ignore_cleanup_errors=True)
        self._false_starts = 0

    def compute(self, jobs: Iterable[Job]) -> Ended:
        """Compute jobs; see `Pool`. FracbenchError: workers die before they begin, or the store fails."""
        given: dict[str, Job] = {}
        failures: list[Exception] = []

        def calls() -> Iterator[Any]:
            from joblib import delayed

            try:
                for job in jobs:
                    given[job.key] = job
                    yield delayed(_compute)(job, self._path, self._marks.name, os.getpid())
            except Exception as exc:  # joblib would wait forever: it takes the jobs in a thread of its own
                failures.append(exc)

        # With one process joblib would compute in this one; of two, one is idle when one job is out at a time.
        ahead = 1 if self._jobs == 1 else 2 * self._jobs
        try:
            with closing(_unordered(calls(), max(self._jobs, 2), ahead)) as rows:
                for key, row in rows:
                    del given[key]
                    os.unlink(_mark(self._marks.name, key))  # noqa: PTH108  see `_mark`
                    self._false_starts = 0
                    yield key, row
        except BrokenProcessPool:
            yield from self._died([*given.values()])
        if failures:
            raise failures[0]

    def _died(self, jobs: Sequence[Job]) -> Ended:
        """Yield the jobs that had begun when the workers died: without a row, unless their time was over."""
        begun = [(job, mark) for job in jobs if (mark := Path(_mark(self._marks.name, job.key))).exists()]
        self._false_starts = 0 if begun else self._false_starts + 1
        if self._false_starts == MAX_FALSE_STARTS:
            raise FracbenchError("worker processes die before they begin with a point (out of memory?)")
        for job, mark in begun:
            over_time = mark.stat().st_size > 0
            mark.unlink()
            if over_time:
                self._store.put(job.expired(provenance.machine()))
            yield job.key, self._store.get_encoded([job.key]).get(job.key) if over_time else None

    def close(self) -> None:
        """Remove the marks."""
        self._marks.cleanup()


def parallel_map(
    function: Callable[..., T], arguments: Sequence[tuple[Any, ...]], jobs: int, kept: str
) -> Iterator[T]:
    """Call a function with each of some arguments in joblib's processes, from now on; yield the results in order.

    With one process the calls are made here, each as its result is asked for. `kept` names, for the message, the
    work that is not lost if a process dies. The function may run in a process that was started in another folder.
    """
    from joblib import delayed

    pool = _parallel(min(jobs, max(len(arguments), 1)), return_as="generator")
    with _ctrl_c_ignored():
        results = pool(delayed(function)(*each) for each in arguments)
    return _results(results, kept)


def _results(results: Iterator[T], kept: str) -> Iterator[T]:
    try:
        yield from results
    except BrokenProcessPool as exc:
        raise FracbenchError(
            f"a worker process died (out of memory, or a crash); {kept}, and the same command resumes"
        ) from exc


def _parallel(jobs: int, **options: Any) -> Any:
    from joblib import Parallel, parallel_config

    with parallel_config("loky", inner_max_num_threads=1, initializer=_prepare, initargs=(os.getpid(),)):
        return Parallel(jobs, batch_size=1, max_nbytes=None, **options)


def _unordered(calls: Iterator[Any], jobs: int, ahead: int) -> Ended:
    pool = _parallel(jobs, pre_dispatch=ahead, return_as="generator_unordered")
    with _ctrl_c_ignored():
        rows = pool(calls)
    try:
        for row in rows:  # noqa: UP028 (`yield from` would close it without the filter)
            yield row
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # some results were not asked for
            rows.close()


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Let processes that are started here ignore Ctrl-C, which a terminal sends to all: the parent acts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _mark(marks: str, key: str) -> str:
    """Return the mark of a point. It is no Path, which interns each name: Python 3.12 keeps those for ever."""
    return f"{marks}/{key}"


# -- in a worker -------------------------------------------------------------------------------------------------


def _compute(job: Job, store: Path, marks: str, parent: int) -> tuple[str, Values]:
    """Compute a job, store its row and return its key and the row."""
    from fracbench.harness.run import compute_point

    try:
        with open(_mark(marks, job.key), "w") as file:  # noqa: PTH123  see `_mark`
            try:
                row = job.row(compute_point.run_point(job.point, job.folder, lambda: _timed(job.timeout, file)))
            except _OverTime:
                row = job.expired(provenance.machine())
        if os.getppid() != parent:
            os._exit(1)  # a sweep that was started since may be computing this point
        with Store(store) as opened:
            values = encode(row)
            opened.put_many([values])
    except OSError as exc:
        raise FracbenchError(f"{exc.filename}: {exc.strerror}; free some space or make it writable") from exc
    return job.key, values


def _prepare(parent: int) -> None:
    """Let this process end with its parent and leave Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), name="parent", daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_SECONDS)
    os._exit(1)


class _OverTime(BaseException):
    """The time that an estimate may take is over."""


def _interrupt(*_: object) -> None:
    raise _OverTime


@contextmanager
def _timed(seconds: float | None, mark: TextIO) -> Iterator[None]:
    """Interrupt an estimate that takes too long; if that does not help, write to the mark and end the process."""
    if seconds is None:
        yield
        return
    gentle = hasattr(signal, "setitimer")
    faulthandler.dump_traceback_later(seconds + _GRACE_SECONDS * gentle, exit=True, file=mark)
    if gentle:
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        if gentle:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        faulthandler.cancel_dump_traceback_later()
