"""Batches of points for the workers of a Dask cluster: what is sent to a worker, and what the worker does with it.

A worker process computes one point at a time, whatever its number of threads. Rows do not come back as the result
of a task, which lives in its worker until it is fetched: they are sent in blocks, as events by way of the
scheduler, encoded as the store keeps them. A worker that dies later takes nothing of them with it.
"""

from __future__ import annotations

import operator
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain, compress
from pathlib import Path
from typing import Any

from fracbench.data.datasets.registry import get_dataset
from fracbench.errors import InputError
from fracbench.harness.run import provenance
from fracbench.harness.run.point import NO_DATA, Job, Point
from fracbench.harness.run.store import Row, Values, encode
from fracbench.methods.registry import get_method
from fracbench.model import SOLVER_VERSION
from fracbench.model.params import FlowParams

_FLUSH_SECONDS = 1.0
_LOOK_SECONDS = 0.2
_same = operator.attrgetter(
    "method", "dataset", "sequence", "region", "context", "data_digest", "noise", "seed", "scene", "score",
    "options", "version", "shape",
)  # fmt: skip
#: Held while a batch is computed: a worker with several threads would begin with the next one.
one_at_a_time = threading.Lock()


class Batch:
    """Jobs on their way to a worker: where points differ in parameters only, just these are sent.

    `whole` is a job of a batch before, of which a canonical form need not be made again.
    """

    def __init__(self, jobs: Iterable[Job], whole: Job | None = None) -> None:
        # A job, or the key, the attempt and the parameters in which a point differs from that of the job before.
        self._entries: list[Any] = []
        self._first = self.whole = whole
        for job in jobs:
            changes = None if self.whole is None else _changes(job.point, self.whole.point)
            if changes is None:
                self.whole = job
                self._entries.append(job)
            else:
                self._entries.append((job.key, job.attempt, changes))

    @property
    def keys(self) -> list[str]:
        """The keys of the jobs."""
        return [entry.key if isinstance(entry, Job) else entry[0] for entry in self._entries]

    def jobs(self) -> Iterator[Job]:
        """Yield the jobs, made one by one. InputError: this fracbench makes other keys."""
        whole: Any = self._first
        for entry in self._entries:
            if isinstance(entry, Job):
                whole = entry
                yield whole
                continue
            key, attempt, changes = entry
            point = replace(whole.point, params=replace(whole.point.params, **changes))
            if point.key != key:
                raise InputError("makes another key of the same point: install the same fracbench")
            yield replace(whole, key=key, attempt=attempt, point=point)


def _changes(point: Point, other: Point) -> dict[str, Any] | None:
    """Return the parameters in which a point differs from another; None where that does not tell it."""
    if _same(point) != _same(other):
        return None
    # A worker may lack the package of a method, and says so in a row, which takes the point's canonical form.
    if get_method(point.method).package or type(point.params) is not FlowParams:
        return None
    values, before = vars(point.params), vars(other.params)
    others = compress(values, map(operator.is_not, values.values(), before.values()))
    return {name: values[name] for name in others if values[name] != before[name]}


def contents_of(point: Point) -> Any:
    """Return the function that reads the files which a worker needs for a point; None if it needs none."""
    return None if point.dataset == NO_DATA else get_dataset(point.dataset).contents


# -- in a worker -------------------------------------------------------------------------------------------------


def run_batch(batch: Batch, files: Mapping[str, bytes], topic: str, pause: float) -> bool:
    """Compute the points of a batch and send their rows; False if data are wanted first.

    A row waits at most `pause` seconds for the next ones, so that the cluster as a whole sends no more blocks than
    the parent can take.
    """
    from fracbench.harness.run import compute_point

    jobs = batch.jobs()
    with one_at_a_time:
        first = next(jobs)
        if first.solver_version != SOLVER_VERSION:
            raise InputError(
                f"has solver version {SOLVER_VERSION}, not {first.solver_version}: install the same fracbench"
            )
        if files:
            load_files(first, files)
        elif contents_of(first.point) and not compute_point.holds(first.point.data_digest):
            return False
        mail = Mail(topic, pause)
        with _wanted(mail):
            try:
                for job in chain([first], jobs):
                    compute(job, mail)
            finally:
                mail.flush()
    return True


class Mail:
    """The rows of a worker on their way to the parent, with the seconds that they took."""

    def __init__(self, topic: str, pause: float) -> None:
        from distributed import get_worker

        self._worker, self._topic, self.pause = get_worker(), topic, pause
        self._lock = threading.RLock()
        self._rows: list[Values] = []
        self._since = self._sent = time.monotonic()

    def put(self, row: Row) -> None:
        """Send a row, unless a block has just been sent: then it goes with the next one."""
        with self._lock:
            self._rows.append(encode(row))
            self.flush_if_due()

    def flush_if_due(self) -> None:
        """Send the rows that wait, if the last block is old enough."""
        if time.monotonic() >= self._sent + self.pause:
            self.flush()

    def flush(self) -> None:
        """Send the rows that wait."""
        with self._lock:
            if self._rows:
                self._sent = time.monotonic()
                self._worker.log_event(self._topic, [self._sent - self._since, self._rows])
                self._rows, self._since = [], self._sent


def compute(job: Job, mail: Mail) -> None:
    """Compute a job and send its row; when its time is over, send the row that says so and end the process."""
    from fracbench.harness.run import compute_point

    settled = threading.Lock()  # taken by the first: the result or the clock

    def expire() -> None:
        if settled.acquire(blocking=False):
            mail.put(job.expired(provenance.machine()))
            mail.flush()
            time.sleep(_FLUSH_SECONDS)  # it is on its way
            os._exit(1)

    row = job.row(compute_point.run_point(job.point, job.folder, lambda: _alarm(job.timeout, expire)))
    if not settled.acquire(blocking=False):
        threading.Event().wait()  # the process is about to end
    mail.put(row)


@contextmanager
def _wanted(mail: Mail) -> Iterator[None]:
    """End this process when nobody waits for its points any more: Dask cannot stop a task that runs.

    The same thread sends the rows that have waited long enough while a point takes its time.
    """
    from distributed import get_worker

    worker, ended = get_worker(), threading.Event()
    key = worker.get_current_task()

    def watch() -> None:
        while not ended.wait(min(_LOOK_SECONDS, mail.pause)):
            mail.flush_if_due()
            if worker.state.tasks[key].state == "cancelled":
                os._exit(1)

    threading.Thread(target=watch, name="wanted", daemon=True).start()
    try:
        yield
    finally:
        ended.set()


@contextmanager
def _alarm(seconds: float | None, ring: Callable[[], None]) -> Iterator[None]:
    if seconds is None:
        yield
        return
    timer = threading.Timer(seconds, ring)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def load_files(job: Job, files: Mapping[str, bytes]) -> None:
    """Load the pair of a job from the files that were sent."""
    from fracbench.harness.run import compute_point

    with tempfile.TemporaryDirectory(prefix="fracbench-") as name:
        for file, content in files.items():
            path = Path(name, file)
            if ".." in path.parts or not path.is_relative_to(name):
                raise InputError(f"dataset {job.point.dataset}: the file {file!r} leads out of its folder")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        point = job.point
        load = get_dataset(point.dataset).load
        compute_point.hold(
            load(point.sequence, Path(name), noise=point.noise, seed=point.seed, **dict(point.scene))
        )
