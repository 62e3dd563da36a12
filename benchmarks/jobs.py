"""Measure the gain of worker processes in a sweep, and the cost of a point beyond its computation."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import common

from fracbench.commands import console
from fracbench.commands.bench import results_stem, write_results
from fracbench.harness.run import sweep
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import Store

SWEEP = ("region=grove2_A", "alpha=0:2:0.05")


def by_jobs(tokens: Sequence[str], jobs: int, *, repeats: int, on_lap: Callable[[], None]) -> dict[str, Any]:
    """Time a sweep into an empty store on one and on `jobs` worker processes, interleaved, after a warm-up.

    `overhead_ms` is the cost of a point on one process beyond the seconds that its computation takes.
    """
    plan = make_plan(tokens)
    took: dict[int, list[float]] = {1: [], jobs: []}
    overheads = []
    for round_number in range(repeats + 1):
        for number, times in took.items():
            with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "store.sqlite") as store:
                started = time.perf_counter()
                report = sweep.run(plan, store, jobs=number)
                seconds = time.perf_counter() - started
                rows = [*report.rows.values()]
            if round_number == 0:
                continue
            times.append(seconds)
            if number == 1:
                computing = sum(row.seconds or 0.0 for row in rows)
                overheads.append(1e3 * (seconds - computing) / len(rows))
            on_lap()
    one, several = median(took[1]), median(took[jobs])
    return {
        "points": len(plan.points),
        "jobs": jobs,
        "seconds_1": one,
        "seconds_n": several,
        "speed_up": one / several,
        "overhead_ms": median(overheads),
    }


def measure(arguments: argparse.Namespace) -> None:
    """Measure, print and write the table."""
    tokens = arguments.overrides or SWEEP
    stem = results_stem(tokens, f"jobs_{arguments.jobs}")
    with console.progress(2 * arguments.repeats, "jobs") as advance:
        record = by_jobs(tokens, arguments.jobs, repeats=arguments.repeats, on_lap=advance)
    write_results([record], stem, " ".join(tokens))


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    return common.run(measure, common.parser(__doc__, against="jobs", default=" ".join(SWEEP)), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
