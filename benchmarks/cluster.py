"""Measure what a sweep on a Dask cluster costs this process a point, and how busy it keeps the workers.

The workers of a simulated cluster, which is one process, sleep and answer with made-up rows: their number and the
seconds of a point are free. Dask has no part in it. The sleeping cluster has Dask's scheduler, and many of Dask's
workers in one process, whose points sleep as well. The real cluster has two worker processes on this machine.
"""

from __future__ import annotations

import argparse
import asyncio
import heapq
import importlib.util
import logging
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import common

from fracbench.commands.bench import results_stem, write_results
from fracbench.errors import FracbenchError, InputError
from fracbench.harness.config.experiment import MAIN, Experiment
from fracbench.harness.run import sweep
from fracbench.harness.run.batches import Batch
from fracbench.harness.run.dask import DaskPool
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.point import Job, Outcome
from fracbench.harness.run.pool import Pool
from fracbench.harness.run.provenance import peak_mib, reset_peak
from fracbench.harness.run.store import Store, Values, encode
from fracbench.studies.sweep import sweep as write_artefact

_ROWS, _ENDED = 0, 1
#: The result of a point that sleeps: of the usual size.
_COUNTS = {"n_pixels": 9216, "n_unknown": 0, "n_nonfinite": 0}
_RESULT = {"aae": 0.1, "aepe": 0.2, "sdae": 0.1, **_COUNTS, "phases": {"solving": 0.1}}
_SMALL = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1")
_CLUSTER = """
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.readline()
"""


def _slept(seconds: float) -> Outcome:
    return Outcome("done", None, _RESULT, seconds, 100.0, {"host": "nowhere"})


@dataclass(eq=False)
class _Batch:
    number: int
    keys: list[str]
    pause: float
    due: float = 0.0  #: when its next block is sent
    begun: float = 0.0
    sent: int = 0  #: rows


@dataclass
class _Worker:
    batches: deque[_Batch] = field(default_factory=deque)


class SimulatedWorkers:
    """Workers that take the same seconds for each point, and send blocks of rows as real ones do."""

    def __init__(self, connection: Connection, seconds: float) -> None:
        self._connection, self._seconds = connection, seconds
        self._workers: dict[str, _Worker] = {}
        self._due: list[tuple[float, int, _Worker]] = []
        self._row: Values = ()
        self._computed, self._first, self._last = 0, 0.0, 0.0

    def run(self) -> None:
        """Answer until the parent asks for the sums: points computed, and seconds from first to last."""
        while True:
            wait = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None
            while self._connection.poll(wait):
                message = self._connection.recv()
                if message is None:
                    self._connection.send((self._computed, self._last - self._first))
                    return
                self._take(*message)
                wait = 0.0
            self._send_due()

    def _take(self, name: str, number: int, batch: Batch, pause: float) -> None:
        if not self._row:
            self._row = encode(next(batch.jobs()).row(_slept(self._seconds)))
            self._first = time.monotonic()
        worker = self._workers.setdefault(name, _Worker())
        worker.batches.append(_Batch(number, batch.keys, pause))
        if len(worker.batches) == 1:
            self._begin(worker, time.monotonic())

    def _begin(self, worker: _Worker, now: float) -> None:
        batch = worker.batches[0]
        batch.begun = now
        self._plan(worker, now)

    def _plan(self, worker: _Worker, now: float) -> None:
        batch = worker.batches[0]
        end = batch.begun + len(batch.keys) * self._seconds
        batch.due = min(end, max(now + batch.pause, batch.begun + (batch.sent + 1) * self._seconds))
        heapq.heappush(self._due, (batch.due, batch.number, worker))

    def _send_due(self) -> None:
        while self._due and self._due[0][0] <= time.monotonic():
            due, _, worker = heapq.heappop(self._due)
            batch = worker.batches[0]
            done = min(len(batch.keys), round((due - batch.begun) / self._seconds))
            rows = [(key, key[::-1], *self._row[2:]) for key in batch.keys[batch.sent : done]]
            if rows:
                self._connection.send((_ROWS, [len(rows) * self._seconds, rows]))
                self._computed += len(rows)
                batch.sent, self._last = done, due
            if batch.sent < len(batch.keys):
                self._plan(worker, due)
                continue
            self._connection.send((_ENDED, batch.number))
            worker.batches.popleft()
            if worker.batches:
                self._begin(worker, due)  # it was there, so that the worker did not wait


class SimulatedFuture(Future[bool]):
    """The end of a batch, whose result is that the data were there; see `distributed.Future`."""

    @property
    def status(self) -> str:
        """``pending`` or ``finished``."""
        return "finished" if self.done() else "pending"

    def release(self) -> None:
        """Do nothing: there is no result to be kept."""


class SimulatedClient:
    """The client of simulated workers, as far as `DaskPool` needs it; see `distributed.Client`."""

    status = "running"

    def __init__(self, workers: int, seconds: float) -> None:
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_simulate, args=(theirs, seconds), daemon=True)
        self._process.start()
        theirs.close()
        self._names = {f"worker-{i}": 1 for i in range(workers)}
        self._futures: dict[int, SimulatedFuture] = {}  # of batches that have not ended
        self._numbers = count()
        self._receive: Callable[[tuple[float, Any]], None] = print
        self._sums = (0, 0.0)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def subscribe_topic(self, topic: str, handler: Callable[[tuple[float, Any]], None]) -> None:
        """Keep the function that is called with each block."""
        self._receive = handler

    def nthreads(self) -> dict[str, int]:
        """Return the workers."""
        return self._names

    def submit(self, function: object, batch: Batch, files: object, topic: str, pause: float, **how: Any) -> Any:
        """Send a batch to a worker."""
        (name,), number = how["workers"], next(self._numbers)
        future = self._futures[number] = SimulatedFuture()
        self._connection.send((name, number, batch, pause))
        return future

    def _listen(self) -> None:
        while True:
            message = self._connection.recv()
            if message[0] == _ROWS and isinstance(message[1], list):
                self._receive((0.0, message[1]))
            elif message[0] == _ENDED and message[1] in self._futures:
                self._futures.pop(message[1]).set_result(True)
            else:
                self._sums = message
                return

    def close(self, timeout: float = 0.0) -> None:
        """End the workers."""
        self._connection.send(None)
        self._thread.join(60)
        self._process.join(60)

    def busy(self, workers: int, seconds: float) -> float:
        """Return the share of the time from the first batch to the last row in which the workers computed."""
        computed, wall = self._sums
        return computed * seconds / (workers * wall)


def _simulate(connection: Connection, seconds: float) -> None:
    SimulatedWorkers(connection, seconds).run()


def _schedule(connection: Connection) -> None:
    from distributed import Scheduler

    logging.disable()

    async def serve() -> None:
        async with Scheduler(port=0, dashboard=False) as scheduler:
            connection.send(scheduler.address)
            await scheduler.finished()

    asyncio.run(serve())


def _sleep(connection: Connection, address: str, workers: int, seconds: float) -> None:
    """Be many workers, whose points take their time without computing."""
    from distributed import Worker

    from fracbench.harness.run import batches

    def compute(job: Job, mail: batches.Mail) -> None:
        time.sleep(seconds)
        mail.put(job.row(_slept(seconds)))

    batches.compute = compute
    batches.one_at_a_time = nullcontext()  # type: ignore[assignment]
    logging.disable()

    async def serve() -> None:
        with tempfile.TemporaryDirectory(prefix="fracbench-") as folder:
            options: dict[str, Any] = {"nthreads": 1, "dashboard": False, "local_directory": folder}
            started: list[Any] = [Worker(address, **options) for _ in range(workers)]
            await asyncio.gather(*started)
            connection.send(None)
            await asyncio.gather(*(worker.finished() for worker in started))

    asyncio.run(serve())


def sleeping(points: int, workers: int, seconds: float) -> dict[str, Any]:
    """Run a sweep by Dask's scheduler on workers that sleep, and return the scheduler's share too."""
    from distributed import Client

    class CountingClient(Client):
        batches = 0

        def submit(self, *words: Any, **how: Any) -> Any:
            self.batches += 1
            return super().submit(*words, **how)

    open_client: Any = CountingClient
    context = get_context("spawn")
    connection, theirs = context.Pipe()
    scheduler = context.Process(target=_schedule, args=(theirs,), daemon=True)
    scheduler.start()
    address = connection.recv()
    sleepers = context.Process(target=_sleep, args=(theirs, address, workers, seconds), daemon=True)
    sleepers.start()
    connection.recv()
    try:
        with (
            open_client(address, set_as_default=False) as asking,
            open_client(address, set_as_default=False) as client,
        ):
            spent = -asking.run_on_scheduler(lambda: time.process_time())
            plan = make_plan(grid_of(points), allow_download=False)
            record = lap(plan, workers, lambda store: DaskPool(None, store, client))
            spent += asking.run_on_scheduler(lambda: time.process_time())
    finally:
        for process in (sleepers, scheduler):
            process.kill()
            process.join()
    busy = record["points"] * seconds / (workers * record["seconds"])
    scheduler_ms = 1e3 * spent / client.batches
    return {"cluster": "sleeping", "point_s": seconds, **record, "busy": busy, "scheduler_ms": scheduler_ms}


def grid_of(points: int) -> list[str]:
    """Return the overrides of a grid of about so many points."""
    side = max(2, round((points / 10) ** 0.5))
    return [
        *_SMALL,
        f"alpha={','.join(f'{2 * i / side:.5g}' for i in range(side))}",
        f"lambda={','.join(f'{0.1 + i / side:.5g}' for i in range(side))}",
        "theta=0.1:1:0.1",
    ]


def lap(plan: Plan, workers: int, open_pool: Callable[[Store], Pool]) -> dict[str, Any]:
    """Run a plan into an empty store, write its table, and return this process's share, seconds and memory."""
    with (
        tempfile.TemporaryDirectory(prefix="fracbench-", dir=Path.cwd()) as folder,
        Store(Path(folder) / "store.sqlite") as store,
    ):
        pool = open_pool(store)
        reset_peak()
        started, used = time.perf_counter(), time.process_time()
        report = sweep.run(plan, store, jobs=1, pool=pool)
        seconds, used = time.perf_counter() - started, time.process_time() - used
        peak = peak_mib()
        del pool  # a command does not hold it either
        store.close()
        reset_peak()
        started = time.perf_counter()
        write_artefact(Experiment("cluster", "", "sweep", {MAIN: ()}), plan, report.rows, Path(folder))
        table_seconds, table_peak = time.perf_counter() - started, peak_mib()
    if report.computed != len(plan.unique()):
        raise FracbenchError(f"{report.computed} points were computed, not {len(plan.unique())}")
    return {
        "workers": workers,
        "points": report.computed,
        "seconds": seconds,
        "parent_ms": 1e3 * used / report.computed,
        "peak_mib": peak,
        "table_s": table_seconds,
        "table_mib": table_peak,
    }


def simulated(points: int, workers: int, seconds: float) -> dict[str, Any]:
    """Run a sweep on a simulated cluster."""
    plan = make_plan(grid_of(points), allow_download=False)
    client = SimulatedClient(workers, seconds)
    record = lap(plan, workers, lambda store: DaskPool(None, store, client))
    return {"cluster": "simulated", "point_s": seconds, **record, "busy": client.busy(workers, seconds)}


def real(points: int) -> dict[str, Any]:
    """Run a sweep of small points on two real workers, after a warm-up."""
    pipe, null = subprocess.PIPE, subprocess.DEVNULL
    words = [sys.executable, "-c", _CLUSTER]
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=null, text=True) as cluster:
        try:
            assert cluster.stdout is not None
            address = cluster.stdout.readline().strip()
            settings = ("parallel=dask", f"parallel.address={address}")
            for tokens in ([*_SMALL, "alpha=1,1.5", "lambda=0.5,0.6"], grid_of(points)):
                plan = make_plan([*tokens, *settings], allow_download=False)
                record = lap(plan, 2, lambda store: DaskPool(address, store))
        finally:
            cluster.communicate("\n")
    seconds = 2 * record["seconds"] / record["points"]
    return {"cluster": "real", "point_s": seconds, **record, "busy": None}


_NOTE = "busy: share of the workers' time; scheduler_ms: the scheduler's time for a batch; one run"


def measure(arguments: argparse.Namespace) -> None:
    """Measure, print and write the table."""
    if arguments.seconds <= 0:
        raise InputError(f"--seconds must be greater than 0, got {arguments.seconds:g}")
    if (arguments.sleepers or arguments.real) and importlib.util.find_spec("distributed") is None:
        raise InputError("without Dask take --sleepers 0 --real 0, or pip install 'fracbench[dask]'")
    stem = results_stem(arguments.overrides, "cluster")
    records = [simulated(arguments.points, arguments.workers, arguments.seconds)]
    if arguments.sleepers:
        points = round(20 * arguments.sleepers / arguments.seconds)  # 20 s of work for each
        records.append(sleeping(points, arguments.sleepers, arguments.seconds))
    if arguments.real:
        records.append(real(arguments.real))
    write_results(records, stem, "Sweeps on a cluster", _NOTE)


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    parser = common.parser(__doc__, repeats=False)
    parser.add_argument("--workers", type=int, default=1000, metavar="N", help="simulated workers (default: 1000)")
    parser.add_argument(
        "--points", type=int, default=100_000, metavar="N", help="about so many (default: 100,000)"
    )
    parser.add_argument("--seconds", type=float, default=0.1, metavar="S", help="of a point (default: 0.1)")
    parser.add_argument(
        "--sleepers", type=int, default=200, metavar="N", help="sleeping workers of Dask's (default: 200); 0: none"
    )
    parser.add_argument("--real", type=int, default=4000, metavar="N", help="points on two real workers; 0: none")
    return common.run(measure, parser, argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
