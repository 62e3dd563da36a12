"""The workers of a Dask cluster, which need share neither a disk nor the data with this machine.

A task is a batch of points (`fracbench.harness.run.batches`): to send one costs Dask as much time as a point of a
small image takes. A worker has a second batch waiting while it computes the first.
"""

from __future__ import annotations

import importlib.util
import logging
import operator
import time
import uuid
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from fracbench.errors import RESUME, FracbenchError, InputError
from fracbench.harness.run.batches import Batch, contents_of, run_batch
from fracbench.harness.run.cost import Pace
from fracbench.harness.run.point import Job, Point
from fracbench.harness.run.pool import Ended
from fracbench.harness.run.store import Store, Values, status_of

_log = logging.getLogger(__name__)

#: The seconds of work of a batch: for a worker that has none, and at most. Dask's scheduler takes about 2 ms for a
#: batch (``benchmarks/cluster.py``): the more workers there are, the larger are their batches.
LEAST_SECONDS, MOST_SECONDS = 1.0, 5.0
LEAST_PER_WORKER = 0.003
#: The seconds that a row waits for others: the cluster as a whole sends 1,000 blocks a second at most.
LEAST_PAUSE, PAUSE_PER_WORKER = 0.1, 0.001

_CONNECT_SECONDS = 10
_GATHER_SECONDS = 5.0
_POLL_SECONDS = 1.0
_LOOK_SECONDS = 0.2
#: While workers are without work, rows are written at this interval: a transaction waits for the disk.
_WRITE_SECONDS = 0.2
#: A worker that is missing in this many looks in a row is given up: by then its last event has arrived.
_MISSES = 2
#: Batches that are sent before the rows that have arrived meanwhile are looked at.
_BATCHES_AT_ONCE = 32


@dataclass(eq=False)
class _Batch:
    """Jobs that a worker was sent together: those that have not ended, by key."""

    worker: str
    jobs: dict[str, Job]
    future: Any = None
    seconds: float = 0.0
    innocent: bool = False  #: whether its worker ended itself over a time limit, or died before it began


@dataclass(eq=False)
class _Worker:
    """A worker with its batches in order, and the digests of the data that it was sent."""

    batches: deque[_Batch] = field(default_factory=deque)
    holds: set[str] = field(default_factory=set)
    misses: int = 0


class DaskPool:
    """The workers of a cluster that is running; they may come and go. See `fracbench.harness.run.pool.Pool`."""

    retry_alone = False
    ahead = 64

    def __init__(self, address: str | None, store: Store, client: Any = None) -> None:
        self._address, self._store = address, store
        self._client = _connect(address) if client is None else client
        self._topic = f"fracbench-{uuid.uuid4().hex}"
        self._messages: SimpleQueue[tuple[_Batch | None, Any]] = SimpleQueue()  # from the client's thread
        self._client.subscribe_topic(self._topic, lambda event: self._messages.put((None, event[1])))
        self._workers: dict[str, _Worker] = {}
        # Workers that are there, without a batch and with one: dictionaries for the sake of their order.
        self._idle: dict[str, None] = {}
        self._busy: dict[str, None] = {}
        self._out: dict[str, _Batch] = {}  # by the keys of jobs that have not ended
        self._again: deque[Job] = deque()  # not begun when their worker died
        self._pace = Pace()
        self._whole: Job | None = None  # the last that was sent with all its parameters
        self._next_look = 0.0

    def compute(self, jobs: Iterable[Job]) -> Ended:
        """Compute jobs; see `Pool`. FracbenchError: the scheduler has gone, or a worker cannot run jobs at all."""
        source = _Source(jobs, self._again)
        ended = list[tuple[str, Values | None]]()
        next_write = 0.0
        try:
            while True:
                self._look()
                full = self._fill(source)
                if ended and (full or time.monotonic() >= next_write):  # no worker waits for the disk
                    self._put(ended)
                    now, ended = ended, []
                    yield from now
                    next_write = time.monotonic() + _WRITE_SECONDS
                if source.peek() is None and not any(worker.batches for worker in self._workers.values()):
                    return  # to leave before a batch has ended would end its worker
                ended += self._wait(_LOOK_SECONDS if full else 0.0)
        finally:
            self._put(ended)

    def _put(self, ended: Iterable[tuple[str, Values | None]]) -> None:
        if rows := [values for _, values in ended if values is not None]:
            self._store.put_many(rows)

    def close(self) -> None:
        """Leave the cluster; points under way there are given up, and their workers start anew."""
        for worker in self._workers.values():
            for batch in worker.batches:
                batch.future.release()
        with suppress(TimeoutError):  # the rest ends with this process
            self._client.close(timeout=1)

    # -- who is there ------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Ask the scheduler, once a second, which workers there are."""
        if time.monotonic() < self._next_look:
            return
        try:
            if self._client.status != "running":  # it forgets our points when it loses us, if only for a moment
                raise OSError("the connection is lost")
            present = set(self._client.nthreads())
        except (OSError, RuntimeError, ValueError) as exc:
            raise FracbenchError(f"the scheduler at {self._address} does not answer any more; {RESUME}") from exc
        if not present and not self._next_look:
            _log.warning("%s has no workers yet; waiting for them", self._address)
        self._next_look = time.monotonic() + _POLL_SECONDS
        for name in present - self._workers.keys():
            self._workers[name] = _Worker()
        for name, worker in self._workers.items():
            worker.misses = 0 if name in present else worker.misses + 1
            self._sort(name)

    def _sort(self, name: str) -> None:
        """Put a worker where it belongs by the number of its batches."""
        self._idle.pop(name, None)
        self._busy.pop(name, None)
        worker = self._workers.get(name)
        if worker is None or worker.misses or len(worker.batches) > 1:
            return
        if not worker.batches:
            self._idle[name] = None
        elif len(worker.batches[0].jobs) > 1 or worker.batches[0].seconds < LEAST_SECONDS:
            self._busy[name] = None  # no point waits behind a single one that takes long

    # -- what is sent ------------------------------------------------------------------------------------------

    def _fill(self, source: _Source) -> bool:
        """Send batches to workers that have room, first to those without any; False if there is more to send."""
        for _ in range(_BATCHES_AT_ONCE):
            free = self._idle or self._busy
            if not free or source.peek() is None:
                return True
            name = next(iter(free))
            self._send(_Batch(name, {job.key: job for job in self._take(source, least=free is self._idle)}))
        return False

    def _take(self, source: _Source, *, least: bool) -> Iterator[Job]:
        """Yield the jobs of the next batch: 1 to 5 s of work, at most a worker's share of what is left."""
        first = source.peek()
        share = source.left() / len(self._idle if least else self._workers)
        wanted = min(max(LEAST_SECONDS, LEAST_PER_WORKER * len(self._workers)), MOST_SECONDS)
        count, seconds = 0, 0.0
        while (job := source.peek()) is not None:
            expected = self._pace.seconds(job.point)
            if count:
                enough = seconds >= wanted and (least or count >= share / 4)
                if enough or count >= share or expected is None or seconds + expected > MOST_SECONDS:
                    return
                # The files of one pair go with a batch; a point that is tried again may take its worker along.
                if first is None or job.attempt > 1 or first.attempt > 1 or _other_files(first.point, job.point):
                    return
            yield source.take()
            count += 1
            seconds += MOST_SECONDS if expected is None else expected

    def _send(self, batch: _Batch) -> None:
        """Send a batch to a worker, and before its first point of a sequence the files."""
        worker, jobs = self._workers[batch.worker], list(batch.jobs.values())
        digest = jobs[0].point.data_digest
        files = {} if digest in worker.holds else _files(jobs[0])
        worker.holds.add(digest)
        packed = Batch(jobs, self._whole)
        self._whole = packed.whole
        pause = max(LEAST_PAUSE, PAUSE_PER_WORKER * len(self._workers))
        future = self._client.submit(
            run_batch,
            packed,
            files,
            self._topic,
            pause,
            workers=[batch.worker],
            pure=False,
            key=f"{jobs[0].key}-{uuid.uuid4().hex}",
        )
        batch.future = future
        batch.seconds = sum(self._pace.seconds(job.point) or MOST_SECONDS for job in jobs)
        if batch not in worker.batches:
            worker.batches.append(batch)
        self._out.update(dict.fromkeys(batch.jobs, batch))
        self._sort(batch.worker)
        future.add_done_callback(lambda ended: self._messages.put((batch, ended)))

    # -- what comes back ---------------------------------------------------------------------------------------

    def _wait(self, seconds: float) -> list[tuple[str, Values | None]]:
        """Return the keys of jobs that ended, with their rows; no row if the worker has gone."""
        ended: list[tuple[str, Values | None]] = []
        with suppress(Empty):
            batch, message = self._messages.get(timeout=seconds) if seconds else self._messages.get_nowait()
            while True:
                ended += self._read(*message) if batch is None else self._end(batch, message)
                batch, message = self._messages.get_nowait()
        for name in [name for name, worker in self._workers.items() if worker.misses >= _MISSES]:
            ended += self._give_up(name)
        return ended

    def _read(self, seconds: float, rows: Iterable[Sequence[Any]]) -> list[tuple[str, Values | None]]:
        """Take the rows of a block; those that came before, from a worker that was given up, are left out."""
        ended: list[tuple[str, Values | None]] = []
        points = []
        for row in map(tuple, rows):
            key = row[0]
            batch = self._out.pop(key, None)
            if batch is not None:
                points.append(batch.jobs.pop(key).point)
                batch.innocent = status_of(row) == "timeout"
                ended.append((key, row))
        if points:
            self._pace.learn(points, seconds)
        return ended

    def _end(self, batch: _Batch, future: Any) -> list[tuple[str, Values | None]]:
        worker = self._workers.get(batch.worker)
        if worker is None or batch.future is not future or batch not in worker.batches:
            return []  # of a worker that was given up
        if future.status == "error":
            self._raise_unless_killed(batch.worker, future.exception())
        elif future.status == "finished" and batch.jobs and self._lacked_data(future):
            worker.holds.clear()  # it has been started anew and lacks the data
            self._send(batch)
            return []
        worker.batches.remove(batch)
        self._sort(batch.worker)
        return self._unfinished(batch)

    def _give_up(self, name: str) -> list[tuple[str, Values | None]]:
        """End the batches of a worker that has gone: the first counts an attempt, those behind it do not."""
        worker = self._workers.pop(name)
        self._sort(name)
        ended: list[tuple[str, Values | None]] = []
        begun = next((batch for batch in worker.batches if batch.jobs or batch.innocent), None)
        for batch in worker.batches:
            batch.future.cancel()
            batch.innocent |= batch is not begun
            ended += self._unfinished(batch)
        return ended

    def _unfinished(self, batch: _Batch) -> list[tuple[str, Values | None]]:
        """Return the jobs of a batch, without rows; those that had not begun are sent again."""
        for key in batch.jobs:
            del self._out[key]
        if batch.innocent:
            self._again.extend(batch.jobs.values())
            return []
        return [(key, None) for key in batch.jobs]

    def _lacked_data(self, future: Any) -> bool:
        """Tell whether the worker could not begin; not if it died right after it had ended."""
        with suppress(TimeoutError):  # its result is gone with it, and would be waited for forever
            return not future.result(timeout=_GATHER_SECONDS)
        return False

    def _raise_unless_killed(self, worker: str, error: BaseException) -> None:
        from distributed.scheduler import KilledWorker

        if not isinstance(error, KilledWorker):
            raise FracbenchError(f"worker {worker}: {type(error).__name__}: {error}") from error


class _Source:
    """The jobs that are still to be sent: those that came back, then the others."""

    def __init__(self, jobs: Iterable[Job], again: deque[Job]) -> None:
        self._jobs, self._again = iter(jobs), again
        self._next: Job | None = None

    def peek(self) -> Job | None:
        """Return the next job and leave it there; None at the end."""
        if self._again:
            return self._again[0]
        if self._next is None:
            self._next = next(self._jobs, None)
        return self._next

    def take(self) -> Job:
        """Return the next job; there must be one."""
        if self._again:
            return self._again.popleft()
        job, self._next = self._next, None
        assert job is not None
        return job

    def left(self) -> int:
        """Return about how many jobs there are."""
        return len(self._again) + (self._next is not None) + operator.length_hint(self._jobs)


def _other_files(one: Point, other: Point) -> bool:
    return one.data_digest != other.data_digest and bool(contents_of(one) or contents_of(other))


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


def _files(job: Job) -> Mapping[str, bytes]:
    contents = contents_of(job.point)
    return {} if contents is None else contents(job.point.sequence, job.folder)
