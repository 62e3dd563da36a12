"""One point, computed in a worker process."""

from __future__ import annotations

import pkgutil
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from fracbench.data.datasets.registry import get_dataset, load_sequence
from fracbench.data.files import write_flow
from fracbench.data.pair import FramePair
from fracbench.data.regions import Crop, boxes, crop
from fracbench.entry_points import described
from fracbench.errors import FracbenchError, InputError
from fracbench.evaluation.class_errors import errors_by_class, errors_by_mask
from fracbench.evaluation.fluid_errors import GRID, derivative_errors, errors_by_gradient, grid_points
from fracbench.evaluation.metrics import flow_errors, outliers, with_unknown_as_zero
from fracbench.harness.run import provenance
from fracbench.harness.run.point import MEASURES, Outcome, Point, Scene
from fracbench.harness.run.provenance import peak_mib, reset_peak
from fracbench.methods.method import Method
from fracbench.methods.paper import energy_growth
from fracbench.methods.registry import get_method
from fracbench.methods.warmup import variant, warm_up
from fracbench.model.structure import structure_classes

#: A flow has diverged if its regularity is this many times the energy of no flow at all. For a minimiser the ratio
#: is below 1; it has been seen near 40 where the data term has next to no weight (lambda = 1e-5).
GROWN = 100.0

Guard = Callable[[], AbstractContextManager[Any]]


def run_point(point: Point, folder: Path | None, guard: Guard = nullcontext) -> Outcome:
    """Compute a point; whatever goes wrong becomes its outcome.

    The estimate alone runs in the context of `guard`, after all preparations.
    """
    machine = provenance.machine()
    try:
        return _compute(point, folder, machine, guard)
    except FracbenchError as exc:
        return Outcome("failed", str(exc), {}, None, None, machine)
    except Exception as exc:
        return Outcome("failed", described(exc), {}, None, None, machine)


def _compute(point: Point, folder: Path | None, machine: dict[str, Any], guard: Guard) -> Outcome:
    if point.score in MEASURES:
        return _measure(point, folder, machine, guard)
    frame0, frame1, truth, inner = point_arrays(point, folder)
    method = get_method(point.method).require()
    if method.stamp != point.version:
        versions = f"this worker has {method.stamp!r}, the sweep {point.version!r}"
        raise InputError(f"{method.origin}: {versions}; install the same version")
    if method.package:
        machine = {**machine, "versions": {**machine["versions"], method.package: method.release}}
    params, options = method.restored(point.params), point_options(point, folder)
    _warm_up(method, params)
    reset_peak()
    started = time.perf_counter()
    with guard():
        flow_result = method.compute(frame0, frame1, params, **options)
    seconds = time.perf_counter() - started
    flow = flow_result.flow[(slice(None), *inner)]
    result: dict[str, Any] = {
        **_errors(point, folder, flow, None if truth is None else truth[(slice(None), *inner)]),
        "iterations": flow_result.iterations,
        "inner_iterations": [level.inner_iterations for level in flow_result.levels],
        "stop": flow_result.stop_reason,
        "phases": flow_result.seconds,
        "notices": flow_result.notices,
    }
    peak = peak_mib()
    n_bad = result["n_nonfinite"]
    error = _divergence(point.method, frame0, frame1, flow_result.flow, params, result["stop"], n_bad)
    return Outcome("done" if error is None else "diverged", error, result, seconds, peak, machine)


def _measure(point: Point, folder: Path | None, machine: dict[str, Any], guard: Guard) -> Outcome:
    measure = pkgutil.resolve_name(MEASURES[point.score])
    _warm_up(get_method(point.method), point.params)
    reset_peak()
    started = time.perf_counter()
    with threadpool_limits(1), guard():  # a measure may have loaded further libraries
        result = measure(point, folder)
    return Outcome("done", None, result, time.perf_counter() - started, peak_mib(), machine)


def _errors(point: Point, folder: Path | None, flow: Any, truth: Any) -> dict[str, Any]:
    """Return the errors that a row keeps; without a true flow only the number of its pixels."""
    if truth is None:
        n_bad = int((~np.isfinite(flow)).any(axis=0).sum())
        return {"n_pixels": 0, "n_unknown": flow[0].size, "n_nonfinite": n_bad}
    pair = _sequence_of(point, folder)
    inside = (slice(None), slice(None)) if point.region is None else point.region.inside
    if point.score == "unknown_as_zero":
        truth = with_unknown_as_zero(truth)
    errors = vars(flow_errors(flow, truth))
    names = ("aae", "aepe", "sdae", "n_pixels", "n_unknown", "n_nonfinite")
    result: dict[str, Any] = {name: errors[name] for name in names}
    if get_dataset(point.dataset).outliers:
        result["fl_all"] = outliers(flow, truth)
    if point.score == "structure":
        by_class = errors_by_class(flow, truth, structure_classes(pair.frame0)[inside])
        result["classes"] = {name: vars(found) for name, found in by_class.items()}
    if pair.matched is not None:
        masks = {"matched": pair.matched[inside], "unmatched": ~pair.matched[inside]}
        result["masks"] = {name: vars(found) for name, found in errors_by_mask(flow, truth, masks).items()}
    if point.score == "fluid":
        result |= _fluid(point, flow, truth)
    return result


def _fluid(point: Point, flow: Any, truth: Any) -> dict[str, Any]:
    """Return the errors of derivatives, of all pixels and on the grid of a cross-correlation, and by gradient."""
    box = point.region
    start = (0, 0) if box is None else tuple(min(point.context, begin) for begin, _ in (box.rows, box.cols))
    on_grid = (slice(None), *grid_points((start[0], start[1]), flow.shape[1:]))
    coarse, true = flow[on_grid], truth[on_grid]
    grid = {"aepe": flow_errors(coarse, true).aepe, **vars(derivative_errors(coarse, true, GRID))}
    return {
        "fluid": {
            **vars(derivative_errors(flow, truth)),
            **{f"{name}_grid": value for name, value in grid.items()},
        },
        "gradients": errors_by_gradient(flow, truth),
    }


def _divergence(name: str, frame0: Any, frame1: Any, flow: Any, params: Any, stop: str, n_bad: int) -> str | None:
    if stop == "diverged":
        return f"diverged: {n_bad} pixels of the flow are not finite"
    growth = energy_growth(name, frame0, frame1, flow, params, enough=GROWN)
    if growth is not None and not growth <= GROWN:  # NaN counts as grown
        return f"diverged: the energy of the flow is at least {growth:.3g} times that of no flow"
    return None


@lru_cache(maxsize=8)
def _sequence(
    name: str, dataset: str, folder: Path | None, noise: float, seed: int, scene: Scene, _: str
) -> FramePair:
    return load_sequence(name, dataset, folder, noise=noise, seed=seed, **dict(scene))


_held: dict[str, FramePair] = {}
_crops: dict[Any, Crop] = {}


def hold(sequence: FramePair) -> None:
    """Keep a sequence for the points of this process, which may have no data folder."""
    _held[sequence.digest] = sequence


def holds(digest: str) -> bool:
    """Tell whether a sequence is kept."""
    return digest in _held


def point_arrays(point: Point, folder: Path | None) -> tuple[Any, Any, Any, tuple[slice, slice]]:
    """Return the frames cut to the region with its context, the true flow or None, and the region within them."""
    sequence = _sequence_of(point, folder)
    if point.region is None:
        return sequence.frame0, sequence.frame1, sequence.truth, (slice(None), slice(None))
    key = sequence.digest, point.region, point.context
    if key not in _crops:
        cut = crop(sequence, point.region, point.context)
        _crops.clear()  # the points of a sweep come region by region
        _crops[key] = cut
    return _crops[key]


def point_options(point: Point, folder: Path | None) -> dict[str, Any]:
    """Return all that the point's method takes besides gray frames: their colour, where the data have it."""
    if "color" not in get_method(point.method).options:
        return {}
    sequence = _sequence_of(point, folder)
    color = sequence.frame0_color
    if color is None:
        return {}
    return {
        "color": color if point.region is None else color[boxes(point.region, sequence.shape, point.context)[0]]
    }


def flow_file(point: Point, folder: Path) -> Path:
    """Return where a point's flow is kept: the name changes with everything that the flow depends on."""
    return folder / f"{point.key}.flo"


def keep_flow(point: Point, data: Path | None, path: Path) -> None:
    """Compute the flow of a point and write it, unless the file is there: it is there whole or not at all."""
    if path.is_file():
        return
    frame0, frame1, _, inner = point_arrays(point, data)
    with threadpool_limits(1):  # as for every stored number
        result = get_method(point.method).compute(frame0, frame1, point.params, **point_options(point, data))
    write_flow(path, result.flow[(slice(None), *inner)])


def _sequence_of(point: Point, folder: Path | None) -> FramePair:
    sequence = _held.get(point.data_digest)
    if sequence is None:
        data = point.sequence, point.dataset, folder, point.noise, point.seed, point.scene
        sequence = _sequence(*data, point.data_digest)
    if sequence.digest != point.data_digest:
        raise InputError(f"sequence {point.sequence}: the data changed while the sweep was running")
    return sequence


_warmed: set[tuple[str | bool, ...]] = set()


def _warm_up(method: Method, params: Any) -> None:
    """Compile, or load from numba's cache, all that a method calls, outside every timing.

    From then on the process computes on one thread: tables must not depend on the number of jobs.
    """
    chosen = variant(method.name, params)
    if chosen not in _warmed:
        warm_up(method, params, alone=True)
        threadpool_limits(1)  # of all libraries that are loaded by now
        _warmed.add(chosen)
