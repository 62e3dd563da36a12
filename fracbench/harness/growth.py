"""How time and memory grow with the image, with threads, and with worker processes."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.harness.run import sweep as execute
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.provenance import array_bytes, peak_mib, reset_peak
from fracbench.harness.run.store import Store

#: From VGA to 8 megapixels: these without a prime factor above 5, and with 17, which costs its square.
SHAPES = ((480, 640), (960, 1280), (1728, 2304), (2304, 3456), (2448, 3264))
#: All iterations that a flow may take by default, whatever the picture: growth is to be that of the work.
FIXED: Mapping[str, Any] = {"alpha": 1.2, "epsilon": 0.0, "n_scales": 4}


def texture_pair(shape: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return two 8-bit frames of smoothed noise, the second moved by (2, 1) pixels.

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)``.

    Returns
    -------
    tuple of ndarray
        Frames.
    """
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(0).normal(size=shape).astype(np.float32), 2.0, mode="wrap")
    low, high = noise.min(), noise.max()
    frame = (255.0 * (noise - low) / (high - low)).astype(np.uint8)
    return frame, np.roll(frame, (1, 2), axis=(0, 1))


def cases() -> list[tuple[str, tuple[int, int]]]:
    """Return the boundaries and sizes that `by_size` times: all under `reflect`, the least also under `zero`."""
    return [("reflect", shape) for shape in SHAPES] + [("zero", SHAPES[0])]


def turns(shape: tuple[int, int]) -> int:
    """Return how often an image of `shape` is estimated in a round: small ones more often, which vary most."""
    return min(8, max(1, 2_000_000 // math.prod(shape)))


def by_size(*, threads: int, repeats: int, on_lap: Callable[[], None] | None = None) -> list[dict[str, Any]]:
    """Time the solver on growing images, with one and with several threads; sizes and threads take turns.

    Parameters
    ----------
    threads : int
        Compared with one.
    repeats : int
        Timed rounds through all sizes; the median of all turns counts.
    on_lap : callable, optional
        Called after each estimate.

    Returns
    -------
    list of dict
        ``boundary, height, width, seconds, us_per_pixel, bytes_per_pixel, resident, speed_up``, one for each of
        `cases`: seconds on one thread; bytes a pixel at peak of an estimate, of its arrays and of resident memory
        beyond what the process held before; and one thread's time over several threads'.
    """
    from fracbench.api import estimate_flow

    estimates, records = [], []
    for boundary, shape in cases():
        pixels = math.prod(shape)
        estimate = partial(estimate_flow, *texture_pair(shape), boundary=boundary, **FIXED)
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
                if on_lap is not None:
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


def by_jobs(
    tokens: Sequence[str], jobs: int, *, repeats: int, on_lap: Callable[[], None] | None = None
) -> dict[str, Any]:
    """Time a sweep into an empty store on one and on several worker processes, interleaved.

    Parameters
    ----------
    tokens : sequence of str
        The sweep.
    jobs : int
        Compared with one.
    repeats : int
        Timed rounds after one that warms up; the median counts.
    on_lap : callable, optional
        Called after each sweep.

    Returns
    -------
    dict
        ``points, jobs, seconds_1, seconds_n, speed_up, overhead_ms``: what a point costs on one job beyond the
        seconds that its computation takes.
    """
    plan = make_plan(tokens)
    took: dict[int, list[float]] = {1: [], jobs: []}
    overheads = []
    for round_number in range(repeats + 1):
        for number, times in took.items():
            with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "store.sqlite") as store:
                started = time.perf_counter()
                report = execute.run(plan, store, jobs=number)
                seconds = time.perf_counter() - started
            if round_number == 0:
                continue
            times.append(seconds)
            if number == 1:
                computing = sum(row.seconds or 0.0 for row in report.rows.values())
                overheads.append(1e3 * (seconds - computing) / len(report.rows))
            if on_lap is not None:
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


#: Reads and writes of one array of H x W, a component: d - b (8), the right-hand side (13), the division (4),
#: back to u and its derivatives (11), the update of z (12).
_PASSES_A_COMPONENT = 48
#: The v-step reads 9 and writes 4, the stopping measure reads 4.
_PASSES_BESIDE = 17
#: Line transforms a component (docs/performance.md), and other operations a pixel.
_TRANSFORMS, _OTHER_FLOPS = 14, 90


def roofline(shape: tuple[int, int], *, repeats: int) -> dict[str, float]:
    """Compare one iteration under `reflect` in float32 with what memory and arithmetic of the machine allow.

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)``.
    repeats : int
        Timed rounds of each; the median counts.

    Returns
    -------
    dict
        ``mflop, mbyte`` of an iteration (v-step and u-step), ``gflops, gbyte_s``: the machine's matrix product and
        copy on one thread, ``ms_by_flops, ms_by_bytes``: what they would take, ``ms``: what an iteration takes.
    """
    from threadpoolctl import threadpool_limits

    from fracbench.studies.solvers.linearised_problem import iterate_once

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
        seconds = _median_seconds(iterate_once(texture_pair(shape), FIXED["alpha"]), 10 * repeats)
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
    took = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        took.append(time.perf_counter() - started)
    return median(took)
