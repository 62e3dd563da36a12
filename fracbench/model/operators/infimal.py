"""The infimal convolution of two orders: the flow is a sum of two parts, and each has a regulariser of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.cosine import cosine
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import AVAILABLE
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.operators.alpha_map import MappedGradient
from fracbench.model.operators.base import System


class InfimalGradient(MappedGradient):
    r"""The gradients of both parts of ``u = p + q``, each of its own order, mirrored about the edges.

    It stands for ``min_{p + q = u} R_a(p) + beta R_b(q)`` with the regularisers of `ReflectGradient`, here with
    weights that may vary from pixel to pixel. It acts on the parts: an array (2, H, W) of p and q takes the place
    of an image (H, W). The normal operator is one block for each part, and the data see the sum. The u-step is
    still exact: at each frequency of the cosine transform it is a system of two equations.

    Parameters
    ----------
    alphas, weights, dtype
        As of `MappedGradient`, for p and q.
    smooth_penalty : float
        Split Bregman penalty of q as a multiple of that of p. It changes the speed of convergence, not the
        minimum: derivatives of the higher order are smaller, so that their shrinkage needs a smaller threshold.
    """

    def __init__(
        self,
        alphas: Sequence[float],
        weights: Array,
        dtype: np.dtype | type = np.float64,
        smooth_penalty: float = 1.0,
    ) -> None:
        super().__init__(alphas, weights, dtype)
        self.penalties = np.array([1.0, smooth_penalty])

    def apply(self, u: Array) -> Array:
        return np.concatenate([order.apply(part) for order, part in zip(self._orders, u, strict=True)])

    def adjoint(self, d: Array) -> Array:
        return np.stack([order.adjoint(part) for order, part in zip(self._orders, np.split(d, 2), strict=True)])

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        """Return the eigenvalues of both parts, shapes ``(2, H)`` and ``(2, W)``."""
        ly, lx = zip(*(order.eigenvalues() for order in self._orders), strict=True)
        return np.stack(ly), np.stack(lx)

    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        """Return the normal operators of both parts, shapes ``(2, H, H)`` and ``(2, W, W)``."""
        ny, nx = zip(*(order.normal_matrices() for order in self._orders), strict=True)
        return np.stack(ny), np.stack(nx)

    def differentiate(self, u: Array, d: Array) -> None:
        for order, part, into in zip(self._orders, u, np.split(d, 2), strict=True):
            order.differentiate(part, into)

    def factor(self, theta: float, mu: float) -> System:
        """Return ``mu ly`` and ``mu lx`` of both parts, each with its mu: shapes ``(2, H)`` and ``(2, W)``."""
        ly, lx = self.eigenvalues()
        of_parts = mu * self.penalties[:, None]
        return (of_parts * ly).astype(self.dtype), (of_parts * lx).astype(self.dtype)

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        """Minimise ``|p + q - v|^2 / (2 theta) + mu/2 weight |D (p, q) - w|^2``; see `GradientOperator.solve`.

        `v` has the shape (H, W), and `u`, the parts, (2, H, W). The term of q counts `smooth_penalty` times.
        """
        height, width = self.shape
        first, second = np.split(w, 2)
        spectrum = u[0]  # of v; free until the end
        spectra = spectrum, first[0], second[0]
        along_y, along_x = system
        if not AVAILABLE:
            of_parts = (mu * self.weight * self.penalties).astype(self.dtype)
            w[::2, 0] = self.to_basis(of_parts[:, None, None] * self.adjoint(w))
            w[::2, 1] = 0.0
            spectrum[...] = self.to_basis(v)
            split_parts(*spectra, along_y, along_x, theta, 0, height)
            u[...] = self.from_basis(w[::2, 0])
            self.differentiate(u, w)
            return
        parallel_for(lambda a, b: cosine(v, 1, a, b, *self._unscaled_x, spectrum), height)
        parallel_for(lambda a, b: cosine(spectrum, 0, a, b, *self._unscaled_y, spectrum), width)
        for order, part, penalty in zip(self._orders, (first, second), self.penalties, strict=True):
            order.collect(v, part, math.inf, mu * penalty)
            order.complete(part)
        parallel_for(lambda a, b: split_parts(*spectra, along_y, along_x, theta, a, b), height)
        for order, part, out in zip(self._orders, (first, second), u, strict=True):
            order.halve(part)
            order.back(part, out)
            order.spread(part[0], part)


@jit
def split_parts(
    v: Array, first: Array, second: Array, along_y: Array, along_x: Array, theta: float, start: int, stop: int
) -> None:
    """Write the cosine coefficients of the minimising p to ``first[0]`` and those of q to ``second[0]``.

    `v`, (H, W), holds the coefficients of the data. `first` and `second`, (2, H, W), hold those of
    ``mu weight D^T w`` of p and of q as a sum of two, and `along_y`, (2, H), and `along_x`, (2, W), eigenvalues
    times the mu of each part. Rows `start` to `stop` are taken. No nearly equal numbers are subtracted: with the
    coefficients g and h of both right-hand sides and the penalties ``A = mu (ly + lx)`` of p and B of q, the
    solution of ``(p + q - v) / theta + A p = g``, ``(p + q - v) / theta + B q = h`` is
    ``p = (B v + g - h + theta B g) / (A + B + theta A B)``, and q likewise. A mean that costs nothing in either
    part belongs to p.
    """
    real = v.dtype.type  # or all would be computed in float64
    tight = real(theta)
    ay, by, ax, bx = along_y[0], along_y[1], along_x[0], along_x[1]
    for i in range(start, stop):
        for j in range(v.shape[1]):
            a, b = ay[i] + ax[j], by[i] + bx[j]
            g, h = first[0, i, j] + first[1, i, j], second[0, i, j] + second[1, i, j]
            scale = real(1.0) / (a + b + tight * a * b)
            first[0, i, j] = (b * (v[i, j] + tight * g) + (g - h)) * scale
            second[0, i, j] = (a * (v[i, j] + tight * h) + (h - g)) * scale
    if start == 0 and ay[0] + ax[0] + by[0] + bx[0] == real(0.0):
        first[0, 0, 0], second[0, 0, 0] = v[0, 0], real(0.0)
