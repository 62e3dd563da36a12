"""Fractional gradients of Gruenwald-Letnikov type under three boundary rules (sections 2 and 3.2 of the paper).

An operator maps an image ``u`` of shape ``(H, W)`` to ``pairs`` of (x, y) derivatives of shape
``(pairs, 2, h, w)`` and stands for the regulariser ``R(u) = weight * sum_pairs sum_pixels |D_pair u|``.
Each knows its exact adjoint and the basis in which its normal operator
``weight * sum_pairs D_pair^T D_pair`` is the sum of two diagonals, one an axis: that is what makes the
u-step a division.

==========  =========================================  =====================================  ============
boundary    u outside the image                        derivatives (pairs)                    basis
==========  =========================================  =====================================  ============
`zero`      0 (the paper's Dirichlet condition)        left                                   eigenvectors
`reflect`   mirrored about the edges                   left and right, each weighing 1/2      DCT-II
`natural`   no flux (alpha = 1 only; Algorithm 3)      forward differences                    DCT-II
==========  =========================================  =====================================  ============

The adjoint under `zero` is the right derivative (the paper's integration by parts, made exact).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import ClassVar

import numpy as np
import scipy.fft
import scipy.linalg

from fracbench.errors import InputError, unknown_name
from fracbench.model.arrays import Array, Float64Array
from fracbench.model.transforms import (
    cosine,
    cosine_back,
    derivatives,
    derivatives_adjoint,
    line_plan,
    multiply_sum,
)

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


class GradientOperator(ABC):
    """A discrete gradient, its adjoint and the basis that diagonalises its normal operator.

    Parameters
    ----------
    alpha : float
        Order of the derivative.
    shape : tuple of int
        ``(H, W)`` of the images it acts on.
    dtype : dtype-like
        float32 or float64: the precision of all results.

    Attributes
    ----------
    pairs : int
        Number of (x, y) pairs of derivatives.
    weight : float
        Weight of each pair in the regulariser.
    range_shape : tuple of int
        Shape of ``apply(u)``.
    """

    pairs: ClassVar[int] = 1
    weight: ClassVar[float] = 1.0

    def __init__(self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64) -> None:
        self.alpha = float(alpha)
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self.range_shape: tuple[int, int, int, int] = (self.pairs, 2, *shape)

    @abstractmethod
    def apply(self, u: Array) -> Array:
        """Return all derivatives of `u`, shape `range_shape`."""

    @abstractmethod
    def adjoint(self, d: Array) -> Array:
        """Return ``sum_pairs D_pair^T d_pair``, shape ``(H, W)`` (without `weight`)."""

    @abstractmethod
    def to_basis(self, u: Array) -> Array:
        """Return the coefficients of `u` in the orthonormal basis of the normal operator."""

    @abstractmethod
    def from_basis(self, coefficients: Array) -> Array:
        """Return the image with these `coefficients`; the inverse of `to_basis`."""

    @abstractmethod
    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        """Return the eigenvalues of the normal operator along y and x, shapes ``(H,)`` and ``(W,)``."""

    @abstractmethod
    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        """Return the normal operator along y and x as dense matrices, ``(H, H)`` and ``(W, W)``."""

    def u_step(self, rhs: Array, inverse: Array) -> tuple[Array, Array]:
        """Solve the u-system and differentiate the solution.

        Parameters
        ----------
        rhs : ndarray, shape (H, W)
            Right-hand side.
        inverse : ndarray, shape (H, W)
            Inverse of the system's eigenvalues, ``1 / (1/theta + mu (ly_i + lx_j))``.

        Returns
        -------
        u : ndarray, shape (H, W)
            The solution.
        du : ndarray, shape `range_shape`
            ``apply(u)``.
        """
        u = self.from_basis(self.to_basis(rhs) * inverse)
        return u, self.apply(u)


    def solve(self, v: Array, g: Array, theta: float, mu: float, inverse: Array, u: Array, du: Array) -> None:
        """Take the u-step of both components: minimise ``|u - v|^2 / (2 theta) + mu/2 weight |D u - g|^2``.

        The default is the formula; an operator that knows a faster way to the same numbers overrides it.

        Parameters
        ----------
        v : ndarray, shape (2, H, W)
            Data.
        g : ndarray, shape (2, *range_shape)
            ``d - b``.
        theta, mu : float
            Tightness and split Bregman parameter.
        inverse : ndarray, shape (H, W)
            See `u_step`.
        u : ndarray, shape (2, H, W)
            The minimiser, overwritten.
        du : ndarray, shape (2, *range_shape)
            Its derivatives, overwritten; may be `g`.
        """
        real = self.dtype.type
        for component in range(2):
            rhs = v[component] / real(theta) + real(mu * self.weight) * self.adjoint(g[component])
            u[component], du[component] = self.u_step(rhs, inverse)


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


class _CosineGradient(GradientOperator):
    """What the two operators share whose normal operator the DCT-II diagonalises."""

    def to_basis(self, u: Array) -> Array:
        return scipy.fft.dctn(u, type=2, norm="ortho", workers=1)

    def from_basis(self, coefficients: Array) -> Array:
        return scipy.fft.idctn(coefficients, type=2, norm="ortho", workers=1)

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        ly, lx = (_sine_symbol(n) ** (2.0 * self.alpha) for n in self.shape)
        return ly, lx

    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        ny, nx = (_from_cosine_basis(eigenvalues) for eigenvalues in self.eigenvalues())
        return ny, nx


def _from_cosine_basis(eigenvalues: Float64Array) -> Float64Array:
    cosines = scipy.fft.dct(np.eye(eigenvalues.size), axis=0, norm="ortho")
    return scipy.fft.idct(eigenvalues[:, None] * cosines, axis=0, norm="ortho")


def _sine_symbol(n: int) -> Float64Array:
    return 2.0 * np.sin(np.pi * np.arange(n) / (2 * n))


class ReflectGradient(_CosineGradient):
    r"""Left and right derivatives of u extended evenly about the edges.

    On the 2n-periodic even extension the Gruenwald-Letnikov sum is the Fourier multiplier
    ``(1 - e^{-iw})^alpha = (2 sin(w/2))^alpha e^{i alpha (pi - w)/2}``. Of a cosine series it makes a cosine
    and a sine series, ``D_- u = A - B`` and ``D_+ u = A + B``, so both derivatives cost one inverse
    DCT and one inverse DST.
    """

    pairs: ClassVar[int] = 2
    weight: ClassVar[float] = 0.5

    def __init__(self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64) -> None:
        super().__init__(alpha, shape, dtype)
        self._cos_y, self._sin_y = (m[:, None] for m in self._multipliers(shape[0]))
        self._cos_x, self._sin_x = self._multipliers(shape[1])
        self._work = np.empty((2, 2, *shape), self.dtype)

    def _multipliers(self, n: int) -> tuple[Array, Array]:
        modulus = _sine_symbol(n) ** self.alpha
        phase = self.alpha * (np.pi - np.pi * np.arange(n) / n) / 2.0
        return (modulus * np.cos(phase)).astype(self.dtype), (modulus * np.sin(phase)).astype(self.dtype)

    def apply(self, u: Array) -> Array:
        d = np.empty(self.range_shape, self.dtype)
        self._derivatives(_dct(u, 1), self._cos_x, self._sin_x, 1, d[:, 0])
        self._derivatives(_dct(u, 0), self._cos_y, self._sin_y, 0, d[:, 1])
        return d

    def adjoint(self, d: Array) -> Array:
        along_x = _idct(self._adjoint_coefficients(d[:, 0], self._cos_x, self._sin_x, 1), 1)
        along_y = _idct(self._adjoint_coefficients(d[:, 1], self._cos_y, self._sin_y, 0), 0)
        return along_x + along_y

    def solve(self, v: Array, g: Array, theta: float, mu: float, inverse: Array, u: Array, du: Array) -> None:
        plan_y, plan_x = (line_plan(n, self.dtype) for n in self.shape)
        ones_y, ones_x = (np.ones(n, self.dtype) for n in self.shape)
        cos_y, sin_y = self._cos_y.ravel(), self._sin_y.ravel()
        height, width = self.shape
        step = self.dtype.type(mu * self.weight)
        direct, nothing = ones_x / self.dtype.type(theta), ones_x[:0]
        # The right-hand side: first along each axis alone, then both in the basis of both axes ...
        in_x, in_y = self._work
        derivatives_adjoint(
            g, v, 1, 0, height, step * self._cos_x, step * self._sin_x, direct, plan_x, in_x
        )
        derivatives_adjoint(g, v, 0, 0, width, step * cos_y, step * sin_y, nothing, plan_y, in_y)
        cosine(in_x, 0, 0, width, ones_y, plan_y, in_x)
        cosine(in_y, 1, 0, height, ones_x, plan_x, in_y)
        # ... where the system is a division; and the same way back to u and its derivatives.
        multiply_sum(in_x, in_y, inverse)
        cosine_back(in_x, 1, 0, height, ones_x, plan_x, in_y)
        cosine_back(in_x, 0, 0, width, ones_y, plan_y, in_x)
        cosine_back(in_x, 1, 0, height, ones_x, plan_x, u)
        derivatives(in_x, 1, 0, height, self._cos_x, self._sin_x, plan_x, du)
        derivatives(in_y, 0, 0, width, cos_y, sin_y, plan_y, du)

    @staticmethod
    def _derivatives(coefficients: Array, cosine: Array, sine: Array, axis: int, out: Array) -> None:
        even = _idct(coefficients * cosine, axis)
        odd = _idst(coefficients * sine, axis)
        np.subtract(even, odd, out=out[0])
        np.add(even, odd, out=out[1])

    @staticmethod
    def _adjoint_coefficients(d: Array, cosine: Array, sine: Array, axis: int) -> Array:
        coefficients: Array = cosine * _dct(d[0] + d[1], axis)
        coefficients += sine * _dst(d[1] - d[0], axis)
        return coefficients


class NaturalGradient(_CosineGradient):
    """Forward differences without flux through the border: the gradient of Algorithm 3 and of TV-L1."""

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


def _dct(x: Array, axis: int) -> Array:
    return scipy.fft.dct(x, type=2, norm="ortho", axis=axis, workers=1)


def _idct(x: Array, axis: int) -> Array:
    return scipy.fft.idct(x, type=2, norm="ortho", axis=axis, workers=1)


def _dst(x: Array, axis: int) -> Array:
    # DST-II numbers its frequencies 1..n; shift them to the DCT's 0..n-1 (frequency 0 has no sine).
    result = np.roll(scipy.fft.dst(x, type=2, norm="ortho", axis=axis, workers=1), 1, axis=axis)
    result[(slice(None),) * axis + (0,)] = 0.0
    return result


def _idst(x: Array, axis: int) -> Array:
    # The coefficient of frequency 0 is 0 and comes to stand for frequency n, which a cosine series lacks.
    return scipy.fft.idst(np.roll(x, -1, axis=axis), type=2, norm="ortho", axis=axis, workers=1)


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
