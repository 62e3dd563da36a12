"""Solvers of one linearised problem: how their energy falls to its minimum, by iterations and seconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.point import Point
from fracbench.methods.paper import split_bregman_alpha, v_step
from fracbench.methods.registry import get_method
from fracbench.model.data_terms.brightness import Brightness
from fracbench.model.energy import energy
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.pointwise import threshold
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.zero import gl_weights
from fracbench.model.params import FlowParams
from fracbench.model.pyramid import stretch
from fracbench.model.sweeps import gauss_seidel_dense, gauss_seidel_literal
from fracbench.model.warping import Linearization

_PAPER = {"inner": "cold", "coupling": "penalty", "tol": 0.01, "max_inner": 30}
#: The contestants: parameters by name, the paper's way first, the default last.
SOLVERS: Mapping[str, Mapping[str, Any]] = {
    "printed sweep, cold": {"u_solver": "jacobi", **_PAPER},
    "Gauss-Seidel, cold": {"u_solver": "gauss_seidel", **_PAPER},
    "Gauss-Seidel, warm": {"u_solver": "gauss_seidel", "inner": "warm", "coupling": "penalty"},
    "exact, cold": {"u_solver": "exact", **_PAPER},
    "exact, warm": {"u_solver": "exact", "inner": "warm", "coupling": "penalty"},
    "exact, warm, multiplier": {"relaxation": 1.0},
    "exact, warm, multiplier, over-relaxed (default)": {},
}
DEFAULT = "exact, warm, multiplier, over-relaxed (default)"
#: Solvers whose sweeps the paper prints as double sums, and their names then.
LITERAL = {name: f"{name}, by the printed double sums" for name in ("Gauss-Seidel, cold", "Gauss-Seidel, warm")}

#: Seconds of a run that is worth being timed again.
_SHORT = 2.0


@dataclass(frozen=True)
class Problem:
    """Minimise E(u, v) for frames linearised at a flow; every solver begins with `start`, shape (2, H, W)."""

    linear: Linearization
    start: Array
    params: FlowParams


def courses(point: Point, folder: Path | None) -> dict[str, Any]:
    """Run every solver on a point's problem, linearised at the flow of its method with default parameters.

    The point's options are those of `course`, and `reference_iterations` for the minimum. The result holds the
    `courses` by solver and the `sweep_seconds`.
    """
    frame0, frame1, _, _ = point_arrays(point, folder)
    own = get_method(point.method).estimate(frame0, frame1, FlowParams()).flow
    problem = linearised_problem(*stretch(frame0, frame1, np.dtype(np.float64)), own, point.params)
    options = dict(point.options)
    least = minimum(problem, options.pop("reference_iterations"))
    limits = {"gap": options.pop("last_gap"), **options}
    return {
        "courses": {name: course(problem, solver, least, **limits) for name, solver in SOLVERS.items()},
        "sweep_seconds": sweep_seconds(problem.start.shape[1:], problem.params),
    }


def linearised_problem(frame0: Array, frame1: Array, at: Array, params: FlowParams) -> Problem:
    """Linearise two frames (H, W), 0..255, at a flow, in float64; the solvers start from 0."""
    first, second, flow = (np.ascontiguousarray(array, np.float64) for array in (frame0, frame1, at))
    return Problem(Brightness(first, second, params).at(flow), np.zeros_like(flow), params)


def energy_at(problem: Problem, u: Array) -> float:
    """Return E(u, v) at the best v for `u`, computed in float64."""
    params, flow = problem.params, np.asarray(u, np.float64)
    v = np.empty_like(flow)
    threshold(flow, problem.linear.rho_c, problem.linear.gradient, params.lambda_ * params.theta, v)
    operator = make_operator(params.boundary, params.alpha, flow.shape[1:])
    return energy(operator, flow, v, problem.linear, params.lambda_, params.theta)


def minimum(problem: Problem, iterations: int) -> float:
    """Return the least energy of a long run of the default solver in float64."""
    params = problem.params.replace({**SOLVERS[DEFAULT], "dtype": "float64"})
    run = _Run(problem, params)
    for _ in range(iterations):
        run.step()
    return energy_at(problem, run.u)


def course(
    problem: Problem, solver: Mapping[str, Any], least: float, *, gap: float, seconds: float, iterations: int
) -> list[tuple[int, int, float, float]]:
    """Run a solver, parameters as in `SOLVERS`, until its relative gap to the energy `least` is `gap`, or a limit.

    Returns ``(iteration, u-steps of both components so far, seconds so far, relative gap)``, from iteration 0, the
    start; the energies are not in the seconds. A run that is short is timed three times, and an iteration takes
    the least of its times.
    """
    params = problem.params.replace(solver)
    _Run(problem, params).step()  # compilation
    run = _Run(problem, params)
    inner, gaps, times = [0], [energy_at(problem, run.u) / least - 1.0], [0.0]
    while len(times) <= iterations and sum(times) < seconds and gaps[-1] > gap:
        steps, spent = run.timed_step()
        inner.append(steps)
        times.append(spent)
        gaps.append(energy_at(problem, run.u) / least - 1.0)
    for _ in range(2 if sum(times) < _SHORT else 0):
        run = _Run(problem, params)
        times[1:] = [min(spent, run.timed_step()[1]) for spent in times[1:]]
    return list(zip(range(len(times)), accumulate(inner), accumulate(times), gaps, strict=True))


class _Run:
    """Algorithm 2's loop, one iteration at a time."""

    def __init__(self, problem: Problem, params: FlowParams) -> None:
        dtype = np.dtype(params.dtype)
        self.u = problem.start.astype(dtype)
        self._after = np.empty_like(self.u)
        self._linear = Linearization(*(array.astype(dtype) for array in problem.linear))
        self._regularizer = split_bregman_alpha(params, self._linear.rho_c)
        self._v_step = v_step(self.u, params)

    def step(self) -> int:
        inner = self._regularizer.step(self._v_step.target(self.u, self._linear), self.u, self._after)
        self.u, self._after = self._after, self.u
        return inner if inner > 1 else 2

    def timed_step(self) -> tuple[int, float]:
        began = time.perf_counter()
        return self.step(), time.perf_counter() - began


def iterate_once(frames: Sequence[NDArray[Any]], alpha: float) -> Callable[[], object]:
    """Return a function that takes one iteration of the default solver on a whole frame, linearised at 0."""
    first, second = (frame.astype(np.float64) for frame in frames)
    params = FlowParams(alpha=alpha)
    return _Run(linearised_problem(first, second, np.zeros((2, *first.shape)), params), params).step


def sweep_seconds(shape: tuple[int, int], params: FlowParams) -> tuple[float, float]:
    """Time one Gauss-Seidel sweep of one component with dense matrices and by the printed double sums.

    The boundary is `zero`; compilation is excluded.
    """
    rng = np.random.default_rng(0)
    rhs = rng.normal(size=shape).astype(params.dtype)
    ny, nx = make_operator("zero", params.alpha, shape).normal_matrices()
    weights = gl_weights(params.alpha, max(shape))
    few = rhs[:4, :4].copy()
    gauss_seidel_dense(few.copy(), few, ny[:4, :4].copy(), nx[:4, :4].copy(), 1.0, 1.0)  # compilation
    gauss_seidel_literal(few.copy(), few, weights, 1.0, 1.0)
    began = time.perf_counter()
    gauss_seidel_dense(rhs.copy(), rhs, ny, nx, params.theta, params.lambda_sb)
    middle = time.perf_counter()
    gauss_seidel_literal(rhs.copy(), rhs, weights, params.theta, params.lambda_sb)
    return middle - began, time.perf_counter() - middle
