"""The single-level solver (Algorithm 2): warps, and in each warp the alternation of v-step and u-step."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fracbench.model.data_terms.brightness import Residual
from fracbench.model.energy import energy
from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.pointwise import mean_squared_change, threshold
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import Regularizer
from fracbench.model.v_steps import VStep
from fracbench.model.warping import Linearization, around


@dataclass
class LevelReport:
    """Iterations and stop reasons at one scale; each list has one item per warp.

    Attributes
    ----------
    shape : tuple of int
        ``(H, W)`` of the scale.
    iterations : list of int
        Passes of Algorithm 2's loop.
    inner_iterations : list of int
        Iterations of the u-step's inner loop; the sum over both components if it starts cold.
    stop : list of str
        ``"converged"``, ``"max_iter"`` or ``"diverged"``.
    change : list of float
        Root mean squared change of the flow in the last iteration, pixels of the scale.
    energy : list of list of float
        E(u, v) after each iteration, at the best v for its u; empty unless traced.
    """

    shape: tuple[int, int]
    iterations: list[int] = field(default_factory=list)
    inner_iterations: list[int] = field(default_factory=list)
    stop: list[str] = field(default_factory=list)
    change: list[float] = field(default_factory=list)
    energy: list[list[float]] = field(default_factory=list)


class Stopwatch:
    """Seconds by phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._last = time.perf_counter()

    def lap(self, phase: str) -> None:
        """Add the time since the last call to `phase`."""
        now = time.perf_counter()
        self.seconds[phase] += now - self._last
        self._last = now


def solve_single_level(
    residual: Residual,
    u: Array,
    params: FlowParams,
    regularizer: Regularizer,
    v_step: VStep,
    watch: Stopwatch,
    *,
    filter_flow: Callable[[Array], Array] | None = None,
    trace: bool = False,
) -> tuple[Array, LevelReport]:
    """Run Algorithm 2 at one scale: return the flow (2, H, W) and its report.

    `residual` is the data term, `regularizer` the u-step. The initial flow `u` is overwritten. `filter_flow`, e.g.
    a median filter, acts on the flow after each warp. `trace` records the energy after each iteration (slow).
    """
    report = LevelReport(shape=(u.shape[1], u.shape[2]))
    after = aligned(u.shape, u.dtype)
    still = np.zeros_like(u) if not params.relinearise else u.copy() if params.u0_per_scale else None
    in_steps = params.unknown == "increment"
    before = np.empty_like(u) if in_steps else None
    for _ in range(params.n_warps):
        u0 = u if still is None else still
        linear = residual.at(u0)
        if in_steps or not params.residual_u0:
            linear = around(u0, linear)
        v_step.relinearised()
        watch.lap("warping")
        if params.dual_restart:
            regularizer.restart()
            v_step.restart()
        if before is not None:  # the unknown is the change of the flow
            before[...] = u
            u[...] = 0.0
        u, after = _alternate(u, after, linear, params, regularizer, v_step, report, trace)
        if before is not None:
            u += before
        watch.lap("solving")
        if report.stop[-1] == "diverged":
            break
        if filter_flow is not None:
            u = filter_flow(u)
            watch.lap("filtering")
    return u, report


def _alternate(
    u: Array,
    after: Array,
    linear: Linearization,
    params: FlowParams,
    regularizer: Regularizer,
    v_step: VStep,
    report: LevelReport,
    trace: bool,
) -> tuple[Array, Array]:
    """Minimise E(u, v) for one linearisation by alternation of v and u; return u and the spare array."""
    limit = params.epsilon**2 if params.epsilon_squared else params.epsilon
    stop, count, inner, energies, change = "max_iter", 0, 0, [], math.inf
    while count < params.max_iter:
        count += 1
        inner += regularizer.step(v_step.target(u, linear), u, after)
        change = mean_squared_change(after, u)
        u, after = after, u
        if trace:
            energies.append(_energy(u, linear, params, regularizer))
        if not np.isfinite(change):
            stop = "diverged"
            break
        if change < limit:
            stop = "converged"
            break
    report.iterations.append(count)
    report.inner_iterations.append(inner)
    report.stop.append(stop)
    report.change.append(math.sqrt(change))
    if trace:
        report.energy.append(energies)
    return u, after


def _energy(u: Array, linear: Linearization, params: FlowParams, regularizer: Regularizer) -> float:
    """Return E(u, v) at the best v for this u."""
    v = np.empty_like(u)
    threshold(u, linear.rho_c, linear.gradient, params.lambda_ * params.theta, v)
    return energy(regularizer.operator, u, v, linear, params.lambda_, params.theta)
