"""The single-level solver (Algorithm 2): warps, and within each the alternation of v-step and u-step."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from fracbench.model.energy import energy
from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.pointwise import coupled_threshold, mean_squared_change, threshold
from fracbench.model.kernels.threads import LEAST_LIGHT_LINES, share
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import Regularizer
from fracbench.model.warping import Linearization, central_gradient, interleave, linearize


@dataclass
class LevelReport:
    """What happened at one scale.

    Attributes
    ----------
    shape : tuple of int
        ``(H, W)`` of the scale.
    iterations : list of int
        Passes of Algorithm 2's loop, one number a warp.
    inner_iterations : list of int
        Calls of the u-step's inner loop (both components together when cold), one number a warp.
    stop : list of str
        ``"converged"``, ``"max_iter"`` or ``"diverged"``, one a warp.
    energy : list of list of float
        E(u, v) after each iteration at the best v for its u, a list a warp; empty unless asked for.
    """

    shape: tuple[int, int]
    iterations: list[int] = field(default_factory=list)
    inner_iterations: list[int] = field(default_factory=list)
    stop: list[str] = field(default_factory=list)
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


class VStep(Protocol):
    """What the alternation asks of a v-step: the flow that the u-step is to regularise."""

    def relinearised(self) -> None:
        """Take note that the residual is another one from now on."""
        ...

    def restart(self) -> None:
        """Forget the state kept between iterations."""
        ...

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return the next target, (2, H, W); it is overwritten by the next call."""
        ...


class PenaltyStep:
    """The paper's v-step: the target is v itself.

    Parameters
    ----------
    like : ndarray, shape (2, H, W)
        A flow of the scale.
    params : FlowParams
        Data attachment weight and tightness.
    """

    def __init__(self, like: Array, params: FlowParams) -> None:
        self._v = aligned(like.shape, like.dtype)
        self._lambda_theta = params.lambda_ * params.theta

    def relinearised(self) -> None:
        """Keep no state."""

    def restart(self) -> None:
        """Keep no state."""

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return v; see `VStep`."""
        threshold(u, linear.rho_c, linear.gradient, self._lambda_theta, self._v)
        return self._v


class MultiplierStep:
    """The v-step with a multiplier kept between iterations and warps; see `coupled_threshold`.

    Parameters
    ----------
    like : ndarray, shape (2, H, W)
        A flow of the scale.
    params : FlowParams
        Data attachment weight, tightness, step and relaxation.
    """

    def __init__(self, like: Array, params: FlowParams) -> None:
        self._c, self._target = (aligned(like.shape, like.dtype) for _ in range(2))
        self._params = params
        self._fresh = True

    def relinearised(self) -> None:
        """Not relax towards the w of another residual."""
        self._fresh = True

    def restart(self) -> None:
        """Set the multiplier to 0."""
        self._c[...] = 0.0

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return ``w - c``; see `VStep`."""
        p = self._params
        settings = p.lambda_, p.theta, p.coupling_step, self._relaxation()
        state = self._c, self._target
        share(lambda a, b: coupled_threshold(u, *linear, *settings, *state, a, b), u.shape[1], LEAST_LIGHT_LINES)
        return self._target

    def _relaxation(self) -> float:
        """Return the over-relaxation of this iteration: none where the last w belongs to another residual."""
        fresh, self._fresh = self._fresh, False
        return 1.0 if fresh else self._params.relaxation


class Residual(Protocol):
    """What the solver asks of the data at a scale: the residual, linearised at a flow."""

    def at(self, u0: Array) -> Linearization:
        """Return the residual at `u0`, (2, H, W); it is overwritten by the next call."""
        ...


class Brightness:
    """The paper's residual: the difference of brightness, linearised.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at a scale, 0..255.
    params : FlowParams
        Factor on the image gradient.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        self._frame0 = frame0
        self._samples1 = interleave(frame1, self.differentiate(frame1, params.gradient_scale))
        self._linear = Linearization(np.empty_like(frame0), np.empty((2, *frame0.shape), frame0.dtype))

    def differentiate(self, frame: Array, scale: float) -> Array:
        """Return the derivatives of a frame, (2, H, W), times `scale`."""
        return central_gradient(frame, scale)

    def at(self, u0: Array) -> Linearization:
        """Warp frame 1 and its gradient; see `Residual`."""
        arrays = self._frame0, self._samples1, u0, *self._linear
        share(lambda a, b: linearize(*arrays, a, b), u0.shape[1])
        return self._linear


def solve_level(
    residual: Residual,
    u: Array,
    params: FlowParams,
    regularizer: Regularizer,
    v_step: VStep,
    watch: Stopwatch,
    *,
    refine: Callable[[Array], Array] | None = None,
    trace: bool = False,
) -> tuple[Array, LevelReport]:
    """Run Algorithm 2 at one scale.

    Parameters
    ----------
    residual : Residual
        The data.
    u : ndarray, shape (2, H, W)
        Initial flow; overwritten.
    params : FlowParams
        Parameters.
    regularizer : Regularizer
        The u-step.
    v_step : VStep
        The v-step.
    watch : Stopwatch
        Adds up seconds by phase.
    refine : callable, optional
        What becomes of the flow after each warp, e.g. a median filter.
    trace : bool, optional
        Record the energy after each iteration (slow).

    Returns
    -------
    flow : ndarray, shape (2, H, W)
        The flow.
    report : LevelReport
        Iterations and stop reasons.
    """
    report = LevelReport(shape=(u.shape[1], u.shape[2]))
    after = aligned(u.shape, u.dtype)
    still = None if params.relinearise else np.zeros_like(u)
    for _ in range(params.n_warps):
        linear = residual.at(u if still is None else still)
        v_step.relinearised()
        watch.lap("warping")
        if params.dual_restart:
            regularizer.restart()
            v_step.restart()
        u, after = _alternate(u, after, linear, params, regularizer, v_step, report, trace)
        watch.lap("solving")
        if report.stop[-1] == "diverged":
            break
        if refine is not None:
            u = refine(u)
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
    """Minimise E(u, v) for one linearisation by turns over v and u; return u and an array that is free."""
    limit = params.epsilon**2 if params.epsilon_squared else params.epsilon
    stop, count, inner, energies = "max_iter", 0, 0, []
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
    if trace:
        report.energy.append(energies)
    return u, after


def _energy(u: Array, linear: Linearization, params: FlowParams, regularizer: Regularizer) -> float:
    """Return E(u, v) at the best v for this u."""
    v = np.empty_like(u)
    threshold(u, linear.rho_c, linear.gradient, params.lambda_ * params.theta, v)
    return energy(regularizer.operator, u, v, linear, params.lambda_, params.theta)
