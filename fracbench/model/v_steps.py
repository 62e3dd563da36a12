"""The v-step: a pixel-wise minimisation, with the paper's penalty or with a multiplier."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from fracbench.errors import InputError
from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.pointwise import GRADIENT_IS_ZERO, coupled_threshold, threshold
from fracbench.model.kernels.threads import LEAST_LIGHT_LINES, parallel_for
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization


class VStep(Protocol):
    """The interface of a v-step, made for the flows of a scale: it returns the target of the u-step."""

    def relinearised(self) -> None:
        """Take note that the residual has been linearised anew; by default there is no state to adapt."""
        return

    def restart(self) -> None:
        """Forget the state kept between iterations; by default there is none."""
        return

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return the next target, (2, H, W); the next call overwrites it."""


class PenaltyStep(VStep):
    """The paper's v-step: the target is v itself."""

    def __init__(self, like: Array, params: FlowParams) -> None:
        self._v = aligned(like.shape, like.dtype)
        self._lambda_theta = params.lambda_ * params.theta

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return v; see `VStep`."""
        threshold(u, linear.rho_c, linear.gradient, self._lambda_theta, self._v)
        return self._v


class UnsquaredStep(PenaltyStep):
    """The paper's v-step with the threshold ``lambda theta |grad I1|``, without the square."""

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return v; see `VStep`."""
        threshold_unsquared(u, linear.rho_c, linear.gradient, self._lambda_theta, self._v)
        return self._v


def v_step_of_penalty(like: Array, params: FlowParams) -> VStep:
    """Return the paper's v-step with the threshold that `params` ask for."""
    if params.threshold == "no_theta":
        params = params.replace({"theta": 1.0})
    return (UnsquaredStep if params.threshold == "no_square" else PenaltyStep)(like, params)


@jit
def threshold_unsquared(u: Array, rho_c: Array, gradient: Array, lambda_theta: float, v: Array) -> None:
    """Write ``v = u + TH`` as `pointwise.threshold` does, with the cases at ``|rho| = lambda theta |grad I1|``."""
    for i in range(u.shape[1]):
        for j in range(u.shape[2]):
            gx, gy = gradient[0, i, j], gradient[1, i, j]
            g2 = gx * gx + gy * gy
            rho = rho_c[i, j] + gx * u[0, i, j] + gy * u[1, i, j]
            bound = lambda_theta * np.sqrt(g2)
            if abs(rho) > bound:
                step = -lambda_theta if rho > 0.0 else lambda_theta
            else:
                step = -rho / g2 if g2 >= GRADIENT_IS_ZERO else 0.0
            v[0, i, j] = u[0, i, j] + step * gx
            v[1, i, j] = u[1, i, j] + step * gy


class MultiplierStep(VStep):
    """The v-step with a multiplier kept between iterations and warps; see `coupled_threshold`."""

    def __init__(self, like: Array, params: FlowParams) -> None:
        self._c, self._target = (aligned(like.shape, like.dtype) for _ in range(2))
        self._params = params
        self._fresh = True

    def relinearised(self) -> None:
        """Skip over-relaxation once: the last w belongs to another linearisation."""
        self._fresh = True

    def restart(self) -> None:
        """Set the multiplier to 0."""
        self._c[...] = 0.0

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return ``w - c``; see `VStep`."""
        p = self._params
        settings = p.lambda_, p.theta, p.coupling_step, self._relaxation()
        state = self._c, self._target
        parallel_for(
            lambda a, b: coupled_threshold(u, *linear, *settings, *state, a, b), u.shape[1], LEAST_LIGHT_LINES
        )
        return self._target

    def _relaxation(self) -> float:
        """Return the over-relaxation of this iteration; see `relinearised`."""
        fresh, self._fresh = self._fresh, False
        return 1.0 if fresh else self._params.relaxation


#: Sweeps over the channels' dual variables in a v-step, which starts from those of the last.
DUAL_SWEEPS = 2


class ChannelStep(MultiplierStep):
    """The v-step with a multiplier for a data term that is a sum over channels."""

    def __init__(self, like: Array, params: FlowParams) -> None:
        super().__init__(like, params)
        self._lambdas = np.array([params.lambda_, params.lambda_gradient, params.lambda_gradient], like.dtype)
        self._duals = np.zeros((len(self._lambdas), *like.shape[1:]), like.dtype)

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return ``w - c``; see `VStep`."""
        data = u, *linear, self._lambdas
        settings = self._params.theta, self._params.coupling_step, self._relaxation()
        state = self._duals, self._c, self._target
        parallel_for(lambda a, b: coupled_thresholds(*data, *settings, *state, DUAL_SWEEPS, a, b), u.shape[1])
        return self._target


@jit
def coupled_thresholds(
    u: Array,
    rho_c: Array,
    gradient: Array,
    lambdas: Array,
    theta: float,
    step: float,
    relaxation: float,
    duals: Array,
    c: Array,
    target: Array,
    sweeps: int,
    start: int,
    stop: int,
) -> None:
    """Take the v-step for ``F(w) = min_v |w - v|^2 / (2 theta) + sum_k lambda_k |rho_k(v)|`` in some rows.

    It is `coupled_threshold` with K channels first in `rho_c` and `gradient`, and finds v by its duals p_k,
    (K, H, W): ``v = z - (theta + step) sum_k p_k grad_k`` with ``|p_k| <= lambda_k``. A sweep of coordinate ascent
    replaces each p_k in turn by the best one for the others. One sweep of one channel is the thresholding
    operator TH.
    """
    part = step / (step + theta)
    tau = theta + step
    width = u.shape[2]
    for i in range(start, stop):
        for j in range(width):
            c1, c2 = c[0, i, j], c[1, i, j]
            z1 = c1 + relaxation * u[0, i, j] + (1.0 - relaxation) * (target[0, i, j] + c1)
            z2 = c2 + relaxation * u[1, i, j] + (1.0 - relaxation) * (target[1, i, j] + c2)
            move1, move2 = 0.0, 0.0
            for k in range(lambdas.size):
                move1 -= tau * duals[k, i, j] * gradient[k, 0, i, j]
                move2 -= tau * duals[k, i, j] * gradient[k, 1, i, j]
            for _ in range(sweeps):
                for k in range(lambdas.size):
                    gx, gy, old, new = gradient[k, 0, i, j], gradient[k, 1, i, j], duals[k, i, j], 0.0
                    g2 = gx * gx + gy * gy
                    if g2 >= GRADIENT_IS_ZERO:
                        rho = rho_c[k, i, j] + gx * (z1 + move1) + gy * (z2 + move2)
                        new = min(max(old + rho / (tau * g2), -lambdas[k]), lambdas[k])
                    move1 -= tau * (new - old) * gx
                    move2 -= tau * (new - old) * gy
                    duals[k, i, j] = new
            move1 *= part
            move2 *= part
            c[0, i, j], c[1, i, j] = -move1, -move2
            target[0, i, j] = z1 + 2.0 * move1
            target[1, i, j] = z2 + 2.0 * move2


def channel_step(like: Array, params: FlowParams) -> VStep | None:
    """Return the v-step for brightness and gradient constancy, or None if `params` ask for brightness alone.

    The penalty coupling has no such step: an `InputError`.
    """
    if not params.lambda_gradient:
        return None
    if params.coupling != "multiplier":
        raise InputError(f"`lambda_gradient` needs coupling=multiplier, got {params.coupling}")
    return ChannelStep(like, params)
