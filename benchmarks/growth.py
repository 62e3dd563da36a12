"""Measure how time and memory of a flow grow with the image, and the gain of threads."""

from __future__ import annotations

import argparse
import math
import sys
import time
import tracemalloc
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import common
import numpy as np

from fracbench.api import estimate_flow
from fracbench.commands import console
from fracbench.commands.bench import results_stem, write_results
from fracbench.harness.run.provenance import peak_mib, reset_peak

#: From VGA to 8 megapixels: these without a prime factor above 5, and with 17, which costs its square.
SHAPES = ((480, 640), (960, 1280), (1728, 2304), (2304, 3456), (2448, 3264))


def cases() -> list[tuple[str, tuple[int, int]]]:
    """Return the boundaries and sizes to be timed: all sizes under `reflect`, the smallest also under `zero`."""
    return [("reflect", shape) for shape in SHAPES] + [("zero", SHAPES[0])]


def turns(shape: tuple[int, int]) -> int:
    """Return how often an image is estimated in a round: small images, whose times vary most, more often."""
    return min(8, max(1, 2_000_000 // math.prod(shape)))


def by_size(*, threads: int, repeats: int, on_lap: Callable[[], None]) -> list[dict[str, Any]]:
    """Time the solver for each of `cases` on one thread and on `threads`; sizes and threads take turns.

    `seconds` is the median of all turns on one thread. `bytes_per_pixel` and `resident` are bytes per pixel at the
    peak of an estimate: of its arrays, and of resident memory beyond that held before. `speed_up` is one thread's
    time over that of several.
    """
    estimates, records = [], []
    for boundary, shape in cases():
        pixels = math.prod(shape)
        estimate = partial(estimate_flow, *common.texture_pair(shape), boundary=boundary, **common.FIXED)
        estimate()  # what is compiled or planned stays in memory
        reset_peak()
        before = peak_mib()
        estimate()
        resident = 2**20 * ((peak_mib() or np.nan) - (before or np.nan)) / pixels
        estimates.append(estimate)
        records.append({"boundary": boundary, "height": shape[0], "width": shape[1], "resident": resident})
    took: list[dict[int, list[float]]] = [{1: [], threads: []} for _ in estimates]
    for _ in range(repeats):
        for (_, shape), estimate, times in zip(cases(), estimates, took, strict=True):
            for number in turns(shape) * list(times):
                started = time.perf_counter()
                estimate(threads=number)
                times[number].append(time.perf_counter() - started)
                on_lap()
    for (_, shape), estimate, times, record in zip(cases(), estimates, took, records, strict=True):
        seconds, pixels = median(times[1]), math.prod(shape)
        record |= {
            "seconds": seconds,
            "us_per_pixel": 1e6 * seconds / pixels,
            "bytes_per_pixel": array_bytes(estimate) / pixels,
            "speed_up": seconds / median(times[threads]),
        }
    return records


def array_bytes(work: Callable[[], object]) -> int:
    """Call `work`, which runs slower, and return the peak of its arrays in bytes.

    Python and NumPy ask for the same amount on every system; resident memory includes what the allocator wastes.
    """
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def measure(arguments: argparse.Namespace) -> None:
    """Measure, print and write the table."""
    stem = results_stem(arguments.overrides, f"size_{arguments.threads}_threads")
    laps = 2 * arguments.repeats * sum(turns(shape) for _, shape in cases())
    with console.progress(laps, "growth") as advance:
        records = by_size(threads=arguments.threads, repeats=arguments.repeats, on_lap=advance)
    write_results(records, stem, f"alpha 1.2, fixed iterations, {arguments.threads} threads against one")


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    return common.run(measure, common.parser(__doc__, against="threads"), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
