"""Gruenwald-Letnikov derivatives of images extended by 0 (sections 2 and 3.2 of the paper): boundary `zero`."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy.linalg

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.exponential_sum import ExponentialSum, convolve, exponential_sum
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.line_elimination import LineGains, line_gains, solve_lines
from fracbench.model.kernels.pointwise import divide_by_sum
from fracbench.model.kernels.simd import AVAILABLE
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.operators.base import GradientOperator, System

#: On shorter lines a product with the matrix is faster than a sum of exponentials.
LEAST_SUMMED = 64
#: Rows of a block of a product; threads share the blocks.
BLOCK_ROWS = 240


def gl_weights(alpha: float, n: int) -> Float64Array:
    """Return the first `n` Gruenwald-Letnikov weights of the order `alpha`, ``(-1)^k binom(alpha, k)``.

    The recurrence of section 3.2: ``w_0 = 1``, ``w_k = (1 - (alpha + 1) / k) w_{k-1}``.
    """
    factors = np.ones(n)
    factors[1:] = 1.0 - (alpha + 1.0) / np.arange(1, n)
    return np.cumprod(factors, dtype=np.float64)


def left_derivative_matrix(alpha: float, n: int, pad: int = 0) -> Float64Array:
    """Return the left derivative of order `alpha` on `n` samples as a dense matrix, (n + pad, n).

    The matrix is lower-triangular Toeplitz; its transpose is the right derivative. The signal is 0 outside the
    samples, and `pad` more rows evaluate the derivative after the last one (before the first one it is 0).
    """
    return np.asarray(scipy.linalg.toeplitz(gl_weights(alpha, n + pad), np.zeros(n)))


class LeftDerivative:
    """The left derivative along one axis, `left_derivative_matrix`, in the faster of two forms.

    `memory` holds the weights as a sum of exponentials: exact for a whole order, else in single precision on long
    lines. Without it, `matrices` holds the matrix and its transpose: a product from the right is faster with the
    transpose.
    """

    def __init__(self, alpha: float, n: int, pad: int, dtype: np.dtype | type) -> None:
        self.memory = _memory(alpha, n, np.dtype(dtype)) if AVAILABLE and not pad else None
        self.matrices: tuple[Array, ...] = ()
        if self.memory is None:
            matrix = left_derivative_matrix(alpha, n, pad).astype(dtype)
            self.matrices = matrix, np.ascontiguousarray(matrix.T)

    def apply(self, x: Array, axis: int, out: Array, *, transposed: bool = False) -> None:
        """Write ``sum_k w_k x(j - k)`` along `axis` (0: y, 1: x), or the transpose, ``sum_k w_k x(j + k)``.

        Without padding `out` is C-contiguous.
        """
        weights = self.memory
        if weights is not None:
            parallel_for(lambda a, b: convolve(x, axis, a, b, weights, transposed, out), x.shape[1 - axis])
            return
        matrix, back = self.matrices[::-1] if transposed else self.matrices
        factors = (x, back) if axis == 1 else (matrix, x)
        np.matmul(*factors, out=out)


@lru_cache(maxsize=256)
def _memory(alpha: float, n: int, dtype: np.dtype) -> ExponentialSum | None:
    weights = gl_weights(alpha, max(n, 3))
    if not weights[3:].any():  # a whole order, or a short line: all further weights are 0
        rest = np.trim_zeros(weights[2:3]).astype(dtype)
        return ExponentialSum(weights[:2].astype(dtype), np.zeros_like(rest), rest)
    return exponential_sum(weights, dtype) if n >= LEAST_SUMMED and dtype == np.float32 else None


@jit
def _weigh_right_hand_side(v: Array, theta: float, mu: float, y: Array, x: Array) -> None:
    """Write ``v / theta + mu (x + y)`` to `x`."""
    real = x.dtype.type  # or all would be computed in float64
    data, penalty = real(1.0 / theta), real(mu)
    for i in range(len(x)):
        for j in range(x.shape[1]):
            x[i, j] = data * v[i, j] + penalty * (x[i, j] + y[i, j])


@jit
def _solve_small(
    v: Array, w: Array, theta: float, mu: float, matrices: tuple[Array, ...], system: System, u: Array
) -> None:
    """Take the u-step by full products, without padding: calls from Python would take longer than the products."""
    ty, ty_back, tx, tx_back, qy, qy_back, qx, qx_back = matrices
    along_y, along_x = system
    y = w[0, 0]  # free once its adjoint is taken
    np.dot(y, tx, u)
    np.dot(ty_back, w[0, 1], y)
    _weigh_right_hand_side(v, theta, mu, y, u)
    np.dot(qy_back, u, y)
    np.dot(y, qx, u)
    divide_by_sum(u, along_y, along_x)
    np.dot(qy, u, y)
    np.dot(y, qx_back, u)
    np.dot(u, tx_back, w[0, 0])
    np.dot(ty, u, w[0, 1])


class ZeroGradient(GradientOperator):
    """Left derivatives of u extended by 0: the operator of Algorithm 4.

    On `pad` pixels of padding u is 0, but its derivatives count (section 3.2).
    """

    def __init__(
        self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64, pad: int = 0
    ) -> None:
        super().__init__(alpha, shape, dtype)
        self.pad = pad
        height, width = shape
        self.range_shape = (1, 2, height + pad, width + pad)
        self._along = [LeftDerivative(self.alpha, n, pad, self.dtype) for n in shape]
        # Eliminate along the longer axis and diagonalise the other, as dense products are slower.
        axes = (1, 0) if width >= height else (0, 1)
        memories = ((axis, memory) for axis in axes if (memory := self._along[axis].memory) is not None)
        self._lines = next(memories, None)

    def apply(self, u: Array) -> Array:
        d = np.empty(self.range_shape, self.dtype)
        self.differentiate(u, d)
        return d

    def differentiate(self, u: Array, d: Array) -> None:
        height, width = self.shape
        d[0, 0, height:] = 0.0  # on the padding below and beside the image
        d[0, 1, :, width:] = 0.0
        along_y, along_x = self._along
        along_x.apply(u, 1, d[0, 0, :height])
        along_y.apply(u, 0, d[0, 1, :, :width])

    def adjoint(self, d: Array) -> Array:
        x, y = np.empty((2, *self.shape), self.dtype)
        self._adjoints(d, x, y)
        x += y
        return x

    def _adjoints(self, d: Array, x: Array, y: Array) -> None:
        """Write the adjoints of the derivatives along x and y to `x` and `y`; `y` may be ``d[0, 0]``."""
        height, width = self.shape
        along_y, along_x = self._along
        along_x.apply(d[0, 0, :height], 1, x, transposed=True)
        along_y.apply(d[0, 1, :, :width], 0, y, transposed=True)

    def to_basis(self, u: Array) -> Array:
        return self._basis(0)[2] @ u @ self._basis(1)[1]

    def from_basis(self, coefficients: Array) -> Array:
        return self._basis(0)[1] @ coefficients @ self._basis(1)[2]

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        return self._basis(0)[0], self._basis(1)[0]

    def _basis(self, axis: int) -> tuple[Float64Array, Array, Array]:
        return _eigenbasis(self.alpha, self.shape[axis], self.pad, self.dtype)

    def factor(self, theta: float, mu: float) -> System:
        """Factorise the lines' systems in the other axis' basis, if the weights are a sum of exponentials."""
        if self._lines is None:
            return super().factor(theta, mu)
        axis, weights = self._lines
        eigenvalues, _, _ = self._basis(1 - axis)
        return line_gains(weights, 1.0 / theta + mu * eigenvalues, mu, self.shape[axis])

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        if self._lines is not None:
            self._solve_by_lines(v, w, theta, mu, self._lines, LineGains(*system), u)
        elif self.pad:
            super().solve(v, w, theta, mu, system, u)
        else:
            matrices = [matrix for along in self._along for matrix in along.matrices]
            bases = [matrix for axis in (0, 1) for matrix in self._basis(axis)[1:]]
            _solve_small(v, w, theta, mu, (*matrices, *bases), system, u)

    def _solve_by_lines(
        self,
        v: Array,
        w: Array,
        theta: float,
        mu: float,
        lines: tuple[int, ExponentialSum],
        gains: LineGains,
        u: Array,
    ) -> None:
        axis, weights = lines
        _, basis, transpose = self._basis(1 - axis)
        y = w[0, 0]  # free once its adjoint is taken
        self._adjoints(w, u, y)
        _weigh_right_hand_side(v, theta, mu, y, u)
        if axis == 1:
            _product(transpose, u, y)
        else:
            _product(u, basis, y)
        parallel_for(lambda a, b: solve_lines(y, axis, a, b, weights.ratios, gains), self.shape[1 - axis])
        if axis == 1:
            _product(basis, y, u)
        else:
            _product(y, transpose, u)
        self.differentiate(u, w)

    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        ty, tx = (left_derivative_matrix(self.alpha, n, self.pad) for n in self.shape)
        return ty.T @ ty, tx.T @ tx


def _product(a: Array, b: Array, out: Array) -> None:
    """Write ``a b`` to `out`, by blocks of rows in parallel: BLAS's own threads are slower than one.

    The rounding of a row depends on its block, so the blocks are the same for any number of threads.
    """

    def take(start: int, stop: int) -> None:
        for block in range(start, stop):
            rows = slice(block * BLOCK_ROWS, (block + 1) * BLOCK_ROWS)
            np.matmul(a[rows], b, out=out[rows])

    parallel_for(take, math.ceil(len(out) / BLOCK_ROWS), least=1)


# Enough for a sweep of 21 orders at six scales (a smaller cache would be cycled through without a hit): 15 MB on a
# region, 150 MB on whole frames.
@lru_cache(maxsize=256)
def _eigenbasis(alpha: float, n: int, pad: int, dtype: np.dtype) -> tuple[Float64Array, Array, Array]:
    """Return the eigenvalues of ``T^T T``, a matrix of its eigenvectors in columns, and the transpose."""
    t = left_derivative_matrix(alpha, n, pad)
    # The singular values of T, squared, keep the small eigenvalues of T^T T accurate.
    _, singular, right = scipy.linalg.svd(t, full_matrices=False)
    back = np.ascontiguousarray(right, dtype)
    return singular**2, np.ascontiguousarray(back.T), back
