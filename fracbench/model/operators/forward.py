"""Forward differences without flux through the border: the gradient of Algorithm 3 and of TV-L1."""

from __future__ import annotations

import numpy as np

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.cosine import cosine, cosine_back
from fracbench.model.kernels.forward_rows import column_pivots, differences, right_hand_side, solve_columns
from fracbench.model.kernels.simd import AVAILABLE
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.operators.base import System
from fracbench.model.operators.reflect import CosineGradient


class ForwardDifferences(CosineGradient):
    """Forward differences; a transform along x leaves a tridiagonal system per column for the u-step."""

    def apply(self, u: Array) -> Array:
        d = np.zeros(self.range_shape, self.dtype)
        np.subtract(u[:, 1:], u[:, :-1], out=d[0, 0, :, :-1])
        np.subtract(u[1:], u[:-1], out=d[0, 1, :-1])
        return d

    def adjoint(self, d: Array) -> Array:
        result = np.zeros(self.shape, self.dtype)
        dx, dy = d[0, 0, :, :-1], d[0, 1, :-1]
        result[:, 1:] += dx
        result[:, :-1] -= dx
        result[1:] += dy
        result[:-1] -= dy
        return result

    def differentiate(self, u: Array, d: Array) -> None:
        differences(u, d)

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        if not AVAILABLE:
            super().solve(v, w, theta, mu, system, u)
            return
        height, width = self.shape
        (inverse,) = system
        right_hand_side(v, w, theta, mu, u)
        parallel_for(lambda a, b: cosine(u, 1, a, b, *self._unscaled_x, u), height)
        parallel_for(lambda a, b: solve_columns(u, mu, inverse, a, b), width)
        parallel_for(lambda a, b: cosine_back(u, 1, a, b, *self._unscaled_x, u), height)
        self.differentiate(u, w)

    def factor(self, theta: float, mu: float) -> System:
        """Return the pivots of the columns' tridiagonal systems that the DCT-II along x leaves."""
        if not AVAILABLE:
            return super().factor(theta, mu)
        _, lx = self.eigenvalues()
        return (column_pivots(1.0 / theta + mu * lx, mu, self.shape[0], self.dtype),)
