"""Gruenwald-Letnikov derivatives (sections 2 and 3.2 of the paper) and the gradient under each boundary rule."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.linalg

from fracbench.errors import InputError, unknown_name
from fracbench.model.arrays import Array, Float64Array
from fracbench.model.gradient import GradientOperator
from fracbench.model.reflected import NaturalGradient, ReflectGradient

BOUNDARIES = ("zero", "reflect", "natural")
ALPHA_RANGE = (0.0, 2.0)


def gl_weights(alpha: float, n: int) -> Float64Array:
    """Return the first `n` Gruenwald-Letnikov weights, ``(-1)^k binom(alpha, k)``.

    The recurrence of section 3.2: ``w_0 = 1``, ``w_k = (1 - (alpha + 1) / k) w_{k-1}``.

    Parameters
    ----------
    alpha : float
        Order of the derivative.
    n : int
        Number of weights.

    Returns
    -------
    ndarray, shape (n,), float64
        The weights.
    """
    factors = np.ones(n)
    k = np.arange(1, n)
    factors[1:] = 1.0 - (alpha + 1.0) / k
    return np.cumprod(factors, dtype=np.float64)


def left_derivative_matrix(alpha: float, n: int, pad: int = 0) -> Float64Array:
    """Return the left derivative on `n` samples as a dense matrix.

    Parameters
    ----------
    alpha : float
        Order of the derivative.
    n : int
        Number of samples; u is 0 outside them.
    pad : int, optional
        Number of points after the last sample at which the derivative is evaluated as well
        (before the first sample it is 0).

    Returns
    -------
    ndarray, shape (n + pad, n), float64
        Lower-triangular Toeplitz; its transpose is the right derivative.
    """
    first_row = np.zeros(n)
    first_row[0] = 1.0
    return np.asarray(scipy.linalg.toeplitz(gl_weights(alpha, n + pad), first_row))


class ZeroGradient(GradientOperator):
    """Left derivatives of u extended by 0: the operator of Algorithm 4.

    Parameters
    ----------
    alpha, shape, dtype
        See `GradientOperator`.
    pad : int, optional
        Padding in pixels, on which u = 0 but its derivatives count (section 3.2).
    """

    def __init__(
        self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64, pad: int = 0
    ) -> None:
        super().__init__(alpha, shape, dtype)
        self.pad = pad
        height, width = shape
        self.range_shape = (1, 2, height + pad, width + pad)
        self._ty = left_derivative_matrix(alpha, height, pad).astype(self.dtype)
        self._tx = left_derivative_matrix(alpha, width, pad).astype(self.dtype)
        self._ly, qy = _eigenbasis(self.alpha, height, pad)
        self._lx, qx = _eigenbasis(self.alpha, width, pad)
        self._qy, self._qx = qy.astype(self.dtype), qx.astype(self.dtype)
        self._work = np.empty((2, height, width), self.dtype)

    def apply(self, u: Array) -> Array:
        height, width = self.shape
        # D_x u(i, j) = sum_k w_k u(i, j - k),  D_y u(i, j) = sum_k w_k u(i - k, j)
        d = np.zeros(self.range_shape, self.dtype)
        np.matmul(u, self._tx.T, out=d[0, 0, :height])
        np.matmul(self._ty, u, out=d[0, 1, :, :width])
        return d

    def adjoint(self, d: Array) -> Array:
        height, width = self.shape
        # D_+ g(i, j) = sum_k w_k g(i, j + k), the transpose of the sums above
        result: Array = d[0, 0, :height] @ self._tx
        result += self._ty.T @ d[0, 1, :, :width]
        return result

    def to_basis(self, u: Array) -> Array:
        return self._qy.T @ u @ self._qx

    def from_basis(self, coefficients: Array) -> Array:
        return self._qy @ coefficients @ self._qx.T

    def solve(self, v: Array, g: Array, theta: float, mu: float, inverse: Array, u: Array, du: Array) -> None:
        height, width = self.shape
        real = self.dtype.type
        x, y = self._work
        # The formula, with nothing allocated.
        np.matmul(g[0, 0, :height], self._tx, out=x)
        np.matmul(self._ty.T, g[0, 1, :, :width], out=y)
        x += y
        x *= real(mu)
        np.multiply(v, real(1.0 / theta), out=y)
        x += y
        np.matmul(self._qy.T, x, out=y)
        np.matmul(y, self._qx, out=x)
        x *= inverse
        np.matmul(self._qy, x, out=y)
        np.matmul(y, self._qx.T, out=u)
        du[:, 0, height:] = 0.0  # on the padding below and beside the image
        du[:, 1, :, width:] = 0.0
        np.matmul(u, self._tx.T, out=du[0, 0, :height])
        np.matmul(self._ty, u, out=du[0, 1, :, :width])

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        return self._ly, self._lx

    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        ty = left_derivative_matrix(self.alpha, self.shape[0], self.pad)
        tx = left_derivative_matrix(self.alpha, self.shape[1], self.pad)
        return ty.T @ ty, tx.T @ tx


@lru_cache(maxsize=64)
def _eigenbasis(alpha: float, n: int, pad: int) -> tuple[Float64Array, Float64Array]:
    t = left_derivative_matrix(alpha, n, pad)
    # The singular values of T, squared, keep the small eigenvalues of T^T T accurate.
    _, singular, right = scipy.linalg.svd(t, full_matrices=False)
    return singular**2, np.ascontiguousarray(right.T)


def make_operator(
    boundary: str, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64, pad: int = 0
) -> GradientOperator:
    """Return the gradient operator for a boundary rule.

    Parameters
    ----------
    boundary : {'zero', 'reflect', 'natural'}
        Boundary rule, see the table in the module's docstring.
    alpha : float
        Order in [0, 2].
    shape : tuple of int
        ``(H, W)``.
    dtype : dtype-like, optional
        float32 or float64.
    pad : int, optional
        Padding in pixels; `zero` only.

    Returns
    -------
    GradientOperator
        The operator.

    Raises
    ------
    InputError
        Unknown boundary, `alpha` outside its range, or a combination that is not defined.
    """
    low, high = ALPHA_RANGE
    if not low <= alpha <= high:
        raise InputError(f"`alpha` must lie in [{low:g}, {high:g}], got {alpha:g}")
    if pad and boundary != "zero":
        raise InputError(f"`pad` belongs to boundary=zero, got pad={pad} with boundary={boundary}")
    if boundary == "zero":
        return ZeroGradient(alpha, shape, dtype, pad)
    if boundary == "reflect":
        return ReflectGradient(alpha, shape, dtype)
    if boundary == "natural":
        if alpha != 1.0:
            raise InputError(f"boundary=natural is defined for alpha = 1, got alpha = {alpha:g}")
        return NaturalGradient(alpha, shape, dtype)
    raise unknown_name("boundary", boundary, BOUNDARIES)
