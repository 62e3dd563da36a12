"""A gradient whose order varies from pixel to pixel: several orders with pixelwise weights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from fracbench.errors import InputError
from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.simd import AVAILABLE
from fracbench.model.operators.base import System
from fracbench.model.operators.reflect import CosineGradient, ReflectGradient


class MappedGradient(CosineGradient):
    r"""Left and right derivatives of several orders, of u mirrored about its edges.

    It stands for ``R(u) = 1/2 sum_k sum_p w_k(p) (|D_-^{a_k} u|(p) + |D_+^{a_k} u|(p))``. With weights that are 1
    for one order and 0 for the others this is ``sum_p |D^{alpha(p)} u|(p)``, the regulariser of an order that
    varies in space. The weights change no linear algebra: each order has a split variable of its own, the
    normal operators add up in the basis that all share, and a weight is a factor on a shrinkage's threshold.

    Parameters
    ----------
    alphas : sequence of float
        The orders ``a_k``, K of them.
    weights : ndarray, shape (K, H, W)
        ``w_k(p)``, finite and at least 0; else an `InputError`.
    dtype : dtype-like
        float32 or float64: the precision of all results.
    """

    weight: ClassVar[float] = ReflectGradient.weight

    def __init__(self, alphas: Sequence[float], weights: Array, dtype: np.dtype | type = np.float64) -> None:
        if not alphas or weights.ndim != 3 or len(weights) != len(alphas):
            size = " x ".join(str(n) for n in weights.shape)
            raise InputError(f"{len(alphas)} orders need as many planes of weights, got an array of {size}")
        if not (np.isfinite(weights).all() and (weights >= 0.0).all()):
            raise InputError("weights of orders must be finite and at least 0")
        shape = (weights.shape[1], weights.shape[2])
        self.pairs = ReflectGradient.pairs * len(alphas)
        super().__init__(alphas[0], shape, dtype)
        self._orders = [ReflectGradient(alpha, shape, dtype) for alpha in alphas]
        self.pixel_weights = weights.astype(self.dtype)

    def _of_orders(self, d: Array) -> list[Array]:
        return np.split(d, len(self._orders))

    def apply(self, u: Array) -> Array:
        return np.concatenate([order.apply(u) for order in self._orders])

    def adjoint(self, d: Array) -> Array:
        parts = zip(self._orders, self._of_orders(d), strict=True)
        return np.sum([order.adjoint(part) for order, part in parts], axis=0)

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        ly, lx = zip(*(order.eigenvalues() for order in self._orders), strict=True)
        return sum(ly), sum(lx)

    def differentiate(self, u: Array, d: Array) -> None:
        if not AVAILABLE:
            super().differentiate(u, d)
            return
        self.transform(u, d)
        self._spread(d)

    def _spread(self, d: Array) -> None:
        # The first order's array holds the coefficients that all orders read: overwrite it last.
        for order, part in reversed(list(zip(self._orders, self._of_orders(d), strict=True))):
            order.spread(d[0], part)

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        if not AVAILABLE:
            super().solve(v, w, theta, mu, system, u)
            return
        for k, (order, part) in enumerate(zip(self._orders, self._of_orders(w), strict=True)):
            order.collect(v, part, math.inf if k else theta, mu)
            if k:
                w[0] += part[0]
        self.divide(w, system)
        self.back(w, u)
        self._spread(w)
