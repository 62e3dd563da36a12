"""Measure the cost of a sweep beyond its points, and extrapolate it to 100,000 points.

40 points are computed on one worker process and on two; with the address of a Dask scheduler, 400 on its workers.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from statistics import mean

import common

from fracbench.commands import console
from fracbench.commands.bench import results_stem, write_results
from fracbench.commands.parser import Parser
from fracbench.harness.run import provenance, sweep
from fracbench.harness.run.batches import Batch
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.point import Job
from fracbench.harness.run.store import Row, Store, encode
from fracbench.model import SOLVER_VERSION

GRID = ("sequence=synthetic_edge", "alpha=0.05:2:0.05")
LARGER_GRID = (*GRID, "lambda=0.1:1:0.1")
_WARM = ("sequence=synthetic_edge", "alpha=2.0", "lambda=0.5,0.6", "max_iter=1")
N_POINTS = 100_000
_BATCH = 20


@dataclass(frozen=True)
class Lap:
    """One run of the grid, with its times in seconds."""

    wall: float
    parent: float  #: this process's processor time per point
    point: float  #: mean time of an estimate
    rows: list[Row]


def run(plan: Plan, jobs: int) -> Lap:
    """Compute a plan in a store of its own and time it."""
    with tempfile.TemporaryDirectory(prefix="fracbench-") as folder, Store(Path(folder) / "store.sqlite") as store:
        wall, parent = time.perf_counter(), time.process_time()
        rows = list(sweep.run(plan, store, jobs=jobs).rows.values())
        wall, parent = time.perf_counter() - wall, time.process_time() - parent
    return Lap(wall, parent / len(rows), mean(row.seconds or 0.0 for row in rows), rows)


def write_seconds(rows: list[Row], block: int = 1) -> tuple[float, float]:
    """Return the seconds that storing one row takes, in blocks of so many, and the bytes of the row."""
    with tempfile.TemporaryDirectory(prefix="fracbench-", dir=Path.cwd()) as folder:
        path = Path(folder) / "store.sqlite"
        Store(path).close()
        before = path.stat().st_size
        with Store(path) as store:
            started = time.perf_counter()
            for first in range(0, len(rows), block):
                store.put_many([encode(row) for row in rows[first : first + block]])
            seconds = time.perf_counter() - started
        # Rows lie in the journal until the store is closed.
        return seconds / len(rows), (path.stat().st_size - before) / len(rows)


def message_bytes(plan: Plan, row: Row) -> tuple[int, int]:
    """Return the bytes that a point sends to a worker, and those that come back."""
    points = [*plan.unique().items()][:_BATCH]
    jobs = [Job(key, point, 1, SOLVER_VERSION, provenance.commit()) for key, point in points]
    return len(ForkingPickler.dumps(Batch(jobs))) // len(jobs), len(row.to_json())


def hours(n_points: int, workers: int, point: float, overhead: float, parent: float) -> float:
    """Return the hours that a sweep takes: its workers' time or its parent's, whichever is longer.

    `point`, `overhead` and `parent` are seconds per point: of the estimate, of the worker's other work, and of the
    parent.
    """
    return n_points * max((point + overhead) / workers, parent) / 3600.0


def measure(arguments: argparse.Namespace) -> None:
    """Measure, print and write the hours that `N_POINTS` points take."""
    stem = results_stem([], "scaling")
    plan = make_plan(GRID)
    laps = {}
    for jobs in (1, 2):
        run(make_plan(_WARM), jobs)  # the workers start and compile, as in every sweep once
        laps[jobs] = run(plan, jobs)
    for jobs, lap in laps.items():
        _say(f"{jobs} worker(s)", lap, jobs)
    console.say(f"two workers are {laps[1].wall / laps[2].wall:.2f} times as fast as one")
    parent = laps[1].parent
    if arguments.address is not None:
        settings = ("parallel=dask", f"parallel.address={arguments.address}")
        run(make_plan([*_WARM, *settings]), 1)
        lap = run(make_plan([*LARGER_GRID, *settings]), 1)
        _say(f"workers of {arguments.address}", lap, None)
        parent = lap.parent
    seconds, size = write_seconds(laps[1].rows, 1 if arguments.address is None else _BATCH)
    there, back = message_bytes(plan, laps[1].rows[0])
    console.say(f"store: {1 / seconds:.0f} rows a second, {size:.0f} bytes a row")
    console.say(f"messages: {there} bytes to a worker, {back} bytes back")
    console.say(f"{N_POINTS} points: {N_POINTS * size / 2**20:.0f} MiB of store")
    point = laps[1].point
    overhead = laps[1].wall / len(laps[1].rows) - point
    paces = {w: hours(N_POINTS, w, point, overhead, parent + seconds) for w in (2, 16, 128, 1024)}
    records = [{"points": N_POINTS, "workers": workers, "hours": pace} for workers, pace in paces.items()]
    write_results(records, stem, f"hours of {N_POINTS} points", "extrapolated from one run")


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    parser = Parser(description=__doc__)
    parser.add_argument("address", nargs="?", help="address of a Dask scheduler, e.g. tcp://127.0.0.1:8786")
    return common.run(measure, parser, argv)


def _say(who: str, lap: Lap, jobs: int | None) -> None:
    text = f"{who}: {len(lap.rows)} points in {lap.wall:.2f} s, estimates of {1e3 * lap.point:.1f} ms"
    if jobs is not None:
        besides = lap.wall * jobs / len(lap.rows) - lap.point
        text += f", {1e3 * besides:.1f} ms a point besides"
    console.say(f"{text}, {1e3 * lap.parent:.1f} ms of this process a point")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
