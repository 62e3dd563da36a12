"""One point, computed in a worker process."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from fracbench.data.regions import Region, crop
from fracbench.data.sequence import Sequence, load_sequence
from fracbench.errors import FracbenchError, InputError
from fracbench.evaluation.metrics import flow_errors
from fracbench.harness import provenance
from fracbench.harness.memory import peak_mib, reset_peak
from fracbench.harness.plan import Point
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams


@dataclass(frozen=True)
class Outcome:
    """How a point ended.

    Attributes
    ----------
    status : str
        ``done``, ``failed`` or ``diverged``; the parent adds ``crashed`` and ``timeout``.
    error : str or None
        What went wrong.
    result : dict
        Errors, iterations, stop reason, seconds by phase, notices.
    seconds : float or None
        Of the estimate alone.
    peak_mib : float or None
        Largest resident memory of the process while the point ran.
    machine : dict
        Where it ran.
    """

    status: str
    error: str | None
    result: dict[str, Any]
    seconds: float | None
    peak_mib: float | None
    machine: dict[str, Any]


def run_point(point: Point, folder: Path | None) -> Outcome:
    """Compute a point; whatever goes wrong becomes its outcome.

    Parameters
    ----------
    point : Point
        What to compute.
    folder : Path or None
        Where the Middlebury data are.

    Returns
    -------
    Outcome
        Never raises, but for what ends the process.
    """
    machine = provenance.machine()
    try:
        with threadpool_limits(1):  # one thread a point, always: tables do not depend on the number of jobs
            return _compute(point, folder, machine)
    except FracbenchError as exc:
        return Outcome("failed", str(exc), {}, None, None, machine)
    except Exception as exc:
        place = traceback.extract_tb(exc.__traceback__)[-1]
        message = f"{type(exc).__name__}: {exc} ({Path(place.filename).name}:{place.lineno})"
        return Outcome("failed", " ".join(message.split()), {}, None, None, machine)


def _compute(point: Point, folder: Path | None, machine: dict[str, Any]) -> Outcome:
    frame0, frame1, truth, inner = point_arrays(point, folder)
    if truth is None:
        raise InputError(f"sequence {point.sequence}: has no true flow to compare with")
    method = get_method(point.method)
    params = FlowParams().replace(point.params)
    _warm_up(point.method, params)
    reset_peak()
    started = time.perf_counter()
    flow_result = method.estimate(frame0, frame1, params)
    seconds = time.perf_counter() - started
    errors = flow_errors(flow_result.flow[(slice(None), *inner)], truth[(slice(None), *inner)])
    result = {
        "aae": errors.aae,
        "aepe": errors.aepe,
        "sdae": errors.sdae,
        "n_pixels": errors.n_pixels,
        "n_unknown": errors.n_unknown,
        "n_nonfinite": errors.n_nonfinite,
        "iterations": flow_result.iterations,
        "inner_iterations": [level.inner_iterations for level in flow_result.levels],
        "stop": flow_result.stop_reason,
        "phases": flow_result.seconds,
        "notices": flow_result.notices,
    }
    diverged = flow_result.stop_reason == "diverged"
    error = f"diverged: {errors.n_nonfinite} pixels of the flow are not finite" if diverged else None
    return Outcome("diverged" if diverged else "done", error, result, seconds, peak_mib(), machine)


@lru_cache(maxsize=8)
def _sequence(name: str, dataset: str, folder: Path | None) -> Sequence:
    return load_sequence(name, dataset, folder)


def point_arrays(point: Point, folder: Path | None) -> tuple[Any, Any, Any, tuple[slice, slice]]:
    """Return the frames and the true flow that a point computes on.

    Parameters
    ----------
    point : Point
        The point.
    folder : Path or None
        Where the Middlebury data are.

    Returns
    -------
    frame0, frame1 : ndarray, shape (h, w)
        The frames, cut to the box with its context.
    truth : ndarray, shape (2, h, w), or None
        The true flow there.
    inner : tuple of slice
        The box within them.

    Raises
    ------
    InputError
        The data are not what the point was planned for.
    """
    sequence = _sequence(point.sequence, point.dataset, folder)
    if sequence.digest != point.data_digest:
        raise InputError(f"sequence {point.sequence}: the data changed while the sweep was running")
    if point.box is None:
        return sequence.frame0, sequence.frame1, sequence.truth, (slice(None), slice(None))
    row0, row1, col0, col1 = point.box
    region = Region("box", sequence.name, (row0, row1), (col0, col1))
    return crop(sequence, region, point.context)


_warmed: set[tuple[str, ...]] = set()


def _warm_up(name: str, params: FlowParams) -> None:
    """Compile, or load from numba's cache, all that a method calls, outside every timing."""
    variant = (name, params.dtype, params.u_solver, params.inner, params.boundary)
    if variant not in _warmed:
        tiny = np.random.default_rng(0).uniform(0.0, 255.0, (2, 32, 32))
        small = params.replace({"n_scales": 2, "n_warps": 1, "max_iter": 2, "max_inner": 2})
        get_method(name).estimate(tiny[0], tiny[1], small)
        _warmed.add(variant)
