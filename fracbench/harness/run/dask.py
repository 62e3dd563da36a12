"""The workers of a Dask cluster, which need share neither a disk nor the data with this machine.

Each worker process has one point at a time, whatever its number of threads. A row does not come back as the
result of a task, which lives in its worker until it is fetched: it is sent as an event, by way of the scheduler,
before the task ends. A worker that dies later takes nothing with it.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from fracbench.data.datasets.registry import get_dataset
from fracbench.errors import RESUME, FracbenchError, InputError
from fracbench.harness.run import provenance
from fracbench.harness.run.point import NO_DATA, Job, Point
from fracbench.harness.run.pool import Ended
from fracbench.harness.run.store import Row, Store
from fracbench.model import SOLVER_VERSION

_log = logging.getLogger(__name__)

_CONNECT_SECONDS = 10
_GATHER_SECONDS = 5.0
_POLL_SECONDS = 1.0
_FLUSH_SECONDS = 1.0
_LOOK_SECONDS = 0.2
#: A worker that is missing in this many looks in a row is given up: by then its last event has arrived.
_MISSES = 2


class DaskPool:
    """The workers of a cluster that is running; they may come and go. See `fracbench.harness.run.pool.Pool`."""

    retry_alone = False

    def __init__(self, address: str | None, store: Store) -> None:
        self._address, self._store = address, store
        self._client = _connect(address)
        self._topic = f"fracbench-{uuid.uuid4().hex}"
        self._client.subscribe_topic(self._topic, self._receive)
        self._rows: dict[str, Row] = {}
        self._ended: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._busy: dict[str, tuple[Job, Any]] = {}  # by worker
        self._present: list[str] = []
        self._misses: dict[str, int] = {}
        self._holds: dict[str, set[str]] = {}  # digests of the data that a worker has been sent
        self._next_look = 0.0

    def _receive(self, event: tuple[float, str]) -> None:
        row = Row.from_json(event[1])
        self._rows[row.key] = row

    def compute(self, jobs: Iterable[Job]) -> Ended:
        """Compute jobs; see `Pool`. FracbenchError: the scheduler has gone, or a worker cannot run jobs at all."""
        jobs, ended = iter(jobs), list[tuple[str, Row | None]]()
        job = next(jobs, None)
        while True:
            self._look()
            for worker in self._idle():
                if job is not None:
                    self._send(worker, job)
                    job = next(jobs, None)
            for key, row in ended:  # after sending, so that no worker waits for the disk
                if row is not None:
                    self._store.put(row)
                yield key, row
            if job is None and not self._busy:
                return
            ended = self._wait(_LOOK_SECONDS)

    def _idle(self) -> list[str]:
        return [worker for worker in self._present if worker not in self._busy]

    def _look(self) -> None:
        """Ask the scheduler, once a second, which workers there are."""
        if time.monotonic() < self._next_look:
            return
        try:
            if self._client.status != "running":  # it forgets our points when it loses us, if only for a moment
                raise OSError("the connection is lost")
            self._present = list(self._client.nthreads())
        except (OSError, RuntimeError, ValueError) as exc:
            raise FracbenchError(f"the scheduler at {self._address} does not answer any more; {RESUME}") from exc
        if not self._present and not self._next_look:
            _log.warning("%s has no workers yet; waiting for them", self._address)
        self._next_look = time.monotonic() + _POLL_SECONDS
        for worker in self._busy:
            self._misses[worker] = 0 if worker in self._present else self._misses.get(worker, 0) + 1

    def _send(self, worker: str, job: Job) -> None:
        """Send a job to an idle worker, and before its first point of a sequence the files."""
        digest, held = job.point.data_digest, self._holds.setdefault(worker, set())
        files = {} if digest in held else _files(job)
        held.add(digest)
        future = self._client.submit(
            _compute, job, files, self._topic, workers=[worker], pure=False, key=f"{job.key}-{uuid.uuid4().hex}"
        )
        self._busy[worker] = (job, future)
        self._misses[worker] = 0
        future.add_done_callback(lambda ended: self._ended.put((worker, ended)))

    def _wait(self, seconds: float) -> list[tuple[str, Row | None]]:
        """Return the keys of jobs that ended, with their rows; no row if the worker has gone."""
        ended: list[tuple[str, Row | None]] = []
        with suppress(Empty):
            message = self._ended.get(timeout=seconds)
            while True:
                ended += self._end(*message)
                message = self._ended.get_nowait()
        self._look()
        for worker in [worker for worker in self._busy if self._misses[worker] >= _MISSES]:
            job, future = self._busy.pop(worker)
            self._holds.pop(worker, None)
            future.cancel()
            ended.append((job.key, self._rows.pop(job.key, None)))
        return ended

    def _end(self, worker: str, future: Any) -> list[tuple[str, Row | None]]:
        if worker not in self._busy or self._busy[worker][1] is not future:
            return []  # of a worker that was given up
        job = self._busy[worker][0]
        if future.status == "error":
            self._raise_unless_killed(worker, future.exception())
        elif future.status == "finished" and self._lacked_data(future):
            self._holds.pop(worker, None)  # it has been started anew and lacks the data
            self._send(worker, job)
            return []
        del self._busy[worker]
        return [(job.key, self._rows.pop(job.key, None))]

    def _lacked_data(self, future: Any) -> bool:
        """Tell whether the worker could not begin; not if it died right after it had ended."""
        with suppress(TimeoutError):  # its result is gone with it, and would be waited for forever
            return not future.result(timeout=_GATHER_SECONDS)
        return False

    def _raise_unless_killed(self, worker: str, error: BaseException) -> None:
        from distributed.scheduler import KilledWorker

        if not isinstance(error, KilledWorker):
            raise FracbenchError(f"worker {worker}: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """Leave the cluster; points under way there are given up, and their workers start anew."""
        for _, future in self._busy.values():
            future.release()
        with suppress(TimeoutError):  # the rest ends with this process
            self._client.close(timeout=1)


def _connect(address: str | None) -> Any:
    if importlib.util.find_spec("distributed") is None:
        raise InputError("parallel=dask needs Dask: pip install 'fracbench[dask]'")
    if address is None:
        raise InputError("parallel=dask needs the address of a scheduler: parallel.address=tcp://HOST:8786")
    from distributed import Client

    connect: Any = Client
    for name in ("distributed.client", "distributed.comm", "distributed.core", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # an error is told in one line
    try:
        return connect(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as exc:
        reason = " ".join(str(exc).split()) or type(exc).__name__
        raise InputError(
            f"parallel.address={address}: no Dask scheduler answers there within {_CONNECT_SECONDS} s ({reason})"
        ) from exc


def _contents(point: Point) -> Any:
    return None if point.dataset == NO_DATA else get_dataset(point.dataset).contents


def _files(job: Job) -> Mapping[str, bytes]:
    contents = _contents(job.point)
    return {} if contents is None else contents(job.point.sequence, job.folder)


def _compute(job: Job, files: Mapping[str, bytes], topic: str) -> bool:
    """In a worker: compute a job and send its row; False if the data are wanted first."""
    from fracbench.harness.run import compute_point

    if job.solver_version != SOLVER_VERSION:
        raise InputError(
            f"has solver version {SOLVER_VERSION}, not {job.solver_version}: install the same fracbench"
        )
    if files:
        _unpack(job, files)
    elif _contents(job.point) and not compute_point.holds(job.point.data_digest):
        return False
    with _wanted():
        _work(job, topic)
    return True


@contextmanager
def _wanted() -> Iterator[None]:
    """End this process when nobody waits for its point any more: Dask cannot stop a task that runs."""
    from distributed import get_worker

    worker, ended = get_worker(), threading.Event()
    key = worker.get_current_task()

    def watch() -> None:
        while not ended.wait(_LOOK_SECONDS):
            if worker.state.tasks[key].state == "cancelled":
                os._exit(1)

    threading.Thread(target=watch, name="wanted", daemon=True).start()
    try:
        yield
    finally:
        ended.set()


def _work(job: Job, topic: str) -> None:
    """Compute a job and send its row; when its time is over, send the row that says so and end the process."""
    from distributed import get_worker

    from fracbench.harness.run import compute_point

    worker = get_worker()
    settled = threading.Lock()  # taken by the first: the result or the clock

    def expire() -> None:
        if settled.acquire(blocking=False):
            worker.log_event(topic, job.expired(provenance.machine()).to_json())
            time.sleep(_FLUSH_SECONDS)  # it is on its way
            os._exit(1)

    row = job.row(compute_point.run_point(job.point, job.folder, lambda: _alarm(job.timeout, expire)))
    if not settled.acquire(blocking=False):
        threading.Event().wait()  # the process is about to end
    worker.log_event(topic, row.to_json())


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


def _unpack(job: Job, files: Mapping[str, bytes]) -> None:
    """Load the pair from the files that were sent."""
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
