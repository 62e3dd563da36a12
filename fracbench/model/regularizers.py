"""The u-step, ``min_u R(u) + |u - v|^2 / (2 theta)``: Chambolle's dual step and split Bregman iteration.

Both keep their state (dual or Bregman variables) between calls; `restart` forgets it.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from fracbench.model.data_terms.occlusion import slope
from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.pointwise import (
    bregman_update,
    mean_squared_change,
    shrink_difference,
    shrink_each,
    update_each,
)
from fracbench.model.kernels.threads import count, parallel_for, parallel_map
from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.infimal import InfimalGradient
from fracbench.model.sweeps import FivePoint, gauss_seidel_dense, gauss_seidel_natural, jacobi_sweep


class Regularizer(Protocol):
    """The interface of a u-step; the energy needs its `operator`, the gradient whose norm is minimised."""

    operator: GradientOperator

    def restart(self) -> None:
        """Forget the state kept between calls."""

    def step(self, v: Array, u: Array, out: Array) -> int:
        """Write the next flow to `out` from `v` and the current `u`, all (2, H, W); return inner iterations."""


class TVDual:
    """Chambolle's dual step for TV with forward differences (Zach et al. 2007; IPOL's numerics).

    The dual time step `tau` may be up to 1/4, where it still converges. A call takes `sweeps` steps.
    """

    def __init__(
        self, shape: tuple[int, int], theta: float, tau: float, dtype: np.dtype | type, sweeps: int = 1
    ) -> None:
        self.operator: GradientOperator = ForwardDifferences(1.0, shape, dtype)
        self._theta = theta
        self._step = tau / theta
        self._sweeps = sweeps
        self._p = np.zeros((2, 2, *shape), dtype)

    def restart(self) -> None:
        """Set the dual variable to 0."""
        self._p[...] = 0.0

    def step(self, v: Array, u: Array, out: Array) -> int:
        """Write ``v + theta div p`` to `out` and move p along its gradient; see `Regularizer.step`."""

        def take(component: int) -> None:
            for _ in range(self._sweeps):
                dual_primal(v[component], self._p[component], self._theta, out[component])
                dual_ascent(out[component], self._step, self._p[component])

        parallel_map(take, range(2))
        return 1


@jit
def dual_primal(v: Array, p: Array, theta: float, u: Array) -> None:
    """Write ``u = v + theta div p``, (H, W); backward differences are the adjoint of `dual_ascent`'s gradient."""
    height, width = v.shape
    step = v.dtype.type(theta)  # or all would be computed in float64
    for i in range(height):
        px, above, here = p[0, i], p[1, max(i - 1, 0)], p[1, i]
        into, out_of = v.dtype.type(i > 0), v.dtype.type(i < height - 1)  # 0 across the border
        for j in range(width):
            u[i, j] = v[i, j] + step * (out_of * here[j] - into * above[j])
        for j in range(width - 1):
            u[i, j] += step * px[j]
        for j in range(1, width):
            u[i, j] -= step * px[j - 1]


@jit
def dual_ascent(u: Array, step: float, p: Array) -> None:
    """Update p, (2, H, W), by ``(p + step grad u) / (1 + step |grad u|)``, ``step = tau / theta``.

    The gradient consists of forward differences, 0 across the border.
    """
    height, width = u.shape
    real = u.dtype.type  # or all would be computed in float64
    rate, one = real(step), real(1.0)
    ux = np.zeros(width, u.dtype)
    for i in range(height):
        px, py, below = p[0, i], p[1, i], u[min(i + 1, height - 1)]
        for j in range(width - 1):
            ux[j] = u[i, j + 1] - u[i, j]
        for j in range(width):
            uy = below[j] - u[i, j]
            scale = one / (one + rate * np.sqrt(ux[j] * ux[j] + uy * uy))
            px[j] = (px[j] + rate * ux[j]) * scale
            py[j] = (py[j] + rate * uy) * scale


class SplitBregman:
    """Split Bregman iteration, Algorithms 3 and 4: u-step, shrinkage, Bregman update.

    Parameters
    ----------
    operator : GradientOperator
        The gradient; `ForwardDifferences` makes it Algorithm 3, the others Algorithm 4.
    theta, mu : float
        Tightness of the coupling of u and v, and split Bregman parameter lambda_sb.
    u_solver : {'exact', 'gauss_seidel', 'jacobi'}
        The operator's own `solve`, one sweep in raster order, or one of the printed fixed point.
    inner : {'warm', 'cold'}
        `warm` keeps d and b between calls and takes one Bregman step per call. `cold` is the paper's rule:
        each call starts from u = v, d = b = 0 and iterates until the root mean square of a component's change is
        at most `tol` pixels, or `max_inner` times.
    relaxation : float
        Over-relaxation, in (0, 2), of warm steps that are solved exactly; a cold step is a step of the
        paper, and a single sweep is too rough to be relaxed.
    penalty : float, optional
        The u-step's parameter lambda_l where it is not `mu`, that of the shrinkage.
    isotropic : bool
        Shrink the derivatives of a pair by their norm; else each by itself.
    tol_norm : {'rms', 'max', 'sum', 'relative'}
        The norm of the change that `tol` bounds.

    Attributes
    ----------
    five_point : FivePoint or None
        The sweep over the 5-point stencil where it is not the usual one; for `ForwardDifferences` alone.
    """

    five_point: FivePoint | None = None

    def __init__(
        self,
        operator: GradientOperator,
        theta: float,
        mu: float,
        *,
        u_solver: str = "exact",
        inner: str = "warm",
        relaxation: float = 1.0,
        tol: float = 0.01,
        max_inner: int = 30,
        penalty: float | None = None,
        isotropic: bool = True,
        tol_norm: str = "rms",
    ) -> None:
        self.operator = operator
        self._theta, self._mu = theta, penalty or mu
        self._shrink = shrink_difference if isotropic else shrink_each
        self._update = bregman_update if isotropic else update_each
        self._tol_norm = tol_norm
        weights = operator.pixel_weights
        # Not 0, which would be divided by norms whose squares underflow.
        self._least = float(np.finfo(operator.dtype).eps ** 2)
        self._threshold = (
            1.0 / mu if weights is None else np.maximum(weights / weights.dtype.type(mu), self._least)
        )
        self._solver = u_solver
        self._cold = inner == "cold"
        self._relaxation = relaxation if u_solver == "exact" and not self._cold else 1.0
        self._tol, self._max_inner = tol, max_inner
        self._z = aligned((2, *operator.range_shape), operator.dtype)
        self._w = [aligned(operator.range_shape, operator.dtype)]  # alternately d - b and D u
        self._started = [False, False]
        self._fused = u_solver == "gauss_seidel" and isinstance(operator, ForwardDifferences)
        if u_solver == "exact":
            self._system = operator.factor(theta, self._mu)
        elif not self._fused:
            self._ny, self._nx = (matrix.astype(operator.dtype) for matrix in operator.normal_matrices())

    def restart(self) -> None:
        """Set d and b to 0."""
        self._z[...] = 0.0
        self._started = [False, False]

    def step(self, v: Array, u: Array, out: Array) -> int:
        """Take one warm step, or iterate from a cold start; see `Regularizer.step`."""
        if count() > 1 and len(self._w) == 1:  # both components at once
            self._w.append(aligned(self._w[0].shape, self._w[0].dtype))
        inner = parallel_map(lambda c: self._take_component(c, v[c], u[c], out[c]), range(2))
        return sum(inner) if self._cold else 1

    def _take_component(self, component: int, v: Array, u: Array, out: Array) -> int:
        if self._cold:
            return self._iterate(component, v, out)
        if self._solver != "exact" or not self._started[component]:
            out[...] = u
        self.bregman_step(component, v, out, warm=True)
        return 1

    def _iterate(self, component: int, v: Array, out: Array) -> int:
        self._z[component] = 0.0
        out[...] = v
        change, count = math.inf, 0
        while change > self._tol**2 and count < self._max_inner:
            before = out[None].copy()
            self.bregman_step(component, v, out)
            change = squared_change(out[None], before, self._tol_norm)
            count += 1
        return count

    def bregman_step(self, component: int, v: Array, u: Array, *, warm: bool = False) -> None:
        """Take one step (u, then d, then b) for a component of the flow, 0 or 1; the next iterate overwrites `u`.

        If `warm`, the first step starts from d = D u, because d = 0 would smooth u away.
        """
        z, w = self._z[component], self._w[component % len(self._w)]
        gamma, relaxation = self._threshold, self._relaxation
        if warm and not self._started[component]:
            self._started[component] = True
            self.operator.differentiate(u, z)
            gamma = self._least  # all of z is d, and b = 0
        parallel_for(lambda a, b: self._shrink(z, gamma, w, a, b), w.shape[2])
        self._u_step(v, w, u)
        parallel_for(lambda a, b: self._update(w, gamma, relaxation, z, a, b), w.shape[2])

    def _u_step(self, v: Array, w: Array, u: Array) -> None:
        """Replace d - b in `w` by the derivatives of the next u."""
        operator = self.operator
        if self._solver == "exact":
            operator.solve(v, w, self._theta, self._mu, self._system, u)
        elif self.five_point is not None:
            self.five_point.step(u, v, w, self._theta, self._mu)
        elif self._fused:
            gauss_seidel_natural(u, v, w, self._theta, self._mu)
        else:
            real = u.dtype.type
            rhs = v / real(self._theta) + real(self._mu * operator.weight) * operator.adjoint(w)
            system = self._ny, self._nx, self._theta, self._mu
            if self._solver == "jacobi":
                u[...] = jacobi_sweep(u, rhs, *system)
            else:
                gauss_seidel_dense(u, rhs, *system)
            operator.differentiate(u, w)


def squared_change(a: Array, b: Array, norm: str) -> float:
    """Return the square of a norm of ``a - b``: of the switch `tol_norm`."""
    if norm == "max":
        return float(np.abs(a - b).max()) ** 2
    change = mean_squared_change(a, b)
    if norm == "relative":
        size = mean_squared_change(a, np.zeros_like(a))
        return change / size if size else 0.0
    return change * a[0].size if norm == "sum" else change


class InfimalBregman(SplitBregman):
    """Warm split Bregman iteration with the exact u-step for two orders, ``u = p + q`` (`InfimalGradient`).

    `smooth`, (2, H, W), is q at the start; p is the rest of the flow.
    """

    def __init__(
        self, operator: InfimalGradient, theta: float, mu: float, smooth: Array, *, relaxation: float = 1.0
    ) -> None:
        super().__init__(operator, theta, mu, relaxation=relaxation)
        penalties = operator.penalties.astype(operator.dtype)[:, None, None]
        self._threshold = np.maximum(self._threshold / penalties, self._least)
        self._parts = aligned((2, *smooth.shape), operator.dtype)  # by component of the flow, then p and q
        self._parts[:, 1] = smooth

    @property
    def smooth(self) -> Array:
        """The part q of the last step, (2, H, W)."""
        return self._parts[:, 1]

    def _take_component(self, component: int, v: Array, u: Array, out: Array) -> int:
        p, q = self._parts[component]
        if not self._started[component]:
            np.subtract(u, q, out=p)
        self.bregman_step(component, v, self._parts[component], warm=True)
        np.add(p, q, out=out)
        return 1


def edge_weights(image: Array, decay: float, power: float) -> Array:
    """Return ``exp(-k |grad I|^b)`` over its mean for an image (H, W): the regulariser is weaker at image edges.

    `decay` is k and `power` is b. The mean of 1 keeps the balance with the data term.
    """
    steepness = np.hypot(slope(image, 0), slope(image, 1))
    weights = np.exp(-decay * steepness**power)
    return weights / weights.mean(dtype=np.float64).astype(image.dtype)
