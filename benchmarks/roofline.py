"""Compare one iteration of the solver with the memory and the arithmetic of the machine."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from statistics import median
from timeit import repeat

import common
import numpy as np
from threadpoolctl import threadpool_limits

from fracbench.commands.bench import results_stem, write_results
from fracbench.studies.solvers.linearised_problem import iterate_once

SHAPES = ((480, 640), (960, 1280))
#: Reads and writes of one array of H x W, a component: d - b (8), the right-hand side (13), the division (4),
#: back to u and its derivatives (11), the update of z (12).
_PASSES_A_COMPONENT = 48
#: The v-step reads 9 and writes 4, the stopping measure reads 4.
_PASSES_BESIDE = 17
#: Line transforms a component (docs/performance.md), and other operations a pixel.
_TRANSFORMS, _OTHER_FLOPS = 14, 90


def roofline(shape: tuple[int, int], *, repeats: int) -> dict[str, float]:
    """Compare one iteration (v-step and u-step) under `reflect` in float32 with the limits of the machine.

    `gflops` and `gbyte_s` are the rates of a matrix product and of a copy on one thread. `ms_by_flops` and
    `ms_by_bytes` are the times of the iteration's `mflop` and `mbyte` at these rates; `ms` is the measured time.
    """
    height, width = shape
    pixels = height * width
    bits = (width * height * np.log2(width) + height * width * np.log2(height)) / 2.0
    mflop = 2e-6 * (_TRANSFORMS * 2.5 * bits + _OTHER_FLOPS * pixels)
    mbyte = 4e-6 * pixels * (2 * _PASSES_A_COMPONENT + _PASSES_BESIDE)
    a, b = np.ones((2, 1024, 1024), np.float32)
    source, copy = np.ones((2, 32 * 2**20), np.float32)
    with threadpool_limits(1):
        product = _median_seconds(lambda: a @ b, repeats)
        copying = _median_seconds(lambda: np.copyto(copy, source), repeats)
        seconds = _median_seconds(iterate_once(common.texture_pair(shape), common.FIXED["alpha"]), 10 * repeats)
    gflops, gbyte_s = 2e-9 * 1024**3 / product, 1e-9 * (source.nbytes + copy.nbytes) / copying
    return {
        "height": height,
        "width": width,
        "mflop": mflop,
        "mbyte": mbyte,
        "gflops": gflops,
        "gbyte_s": gbyte_s,
        "ms_by_flops": mflop / gflops,
        "ms_by_bytes": mbyte / gbyte_s,
        "ms": 1e3 * seconds,
    }


def _median_seconds(work: Callable[[], object], repeats: int) -> float:
    work()
    return median(repeat(work, number=1, repeat=repeats))


def measure(arguments: argparse.Namespace) -> None:
    """Measure, print and write the table."""
    stem = results_stem(arguments.overrides, "roofline")
    records = [roofline(shape, repeats=arguments.repeats) for shape in SHAPES]
    write_results(records, stem, "one iteration, reflect, float32, one thread")


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    return common.run(measure, common.parser(__doc__), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
