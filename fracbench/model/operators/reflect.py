"""Gradients of images mirrored about their edges: the DCT-II diagonalises their normal operators."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import scipy.fft

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.cosine import cosine, cosine_back, derivatives, derivatives_adjoint
from fracbench.model.kernels.fft import line_plan
from fracbench.model.kernels.pointwise import add_and_divide
from fracbench.model.kernels.simd import AVAILABLE
from fracbench.model.kernels.threads import parallel_for
from fracbench.model.operators.base import GradientOperator, System


class CosineGradient(GradientOperator):
    """The base of the operators whose normal operator the DCT-II diagonalises.

    All methods use SciPy's transforms but for `solve` and `differentiate`, which take nearly all of the time: they
    use the vectorised ones of `kernels.cosine` where these are available.
    """

    def __init__(self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64) -> None:
        super().__init__(alpha, shape, dtype)
        self._plan_y, self._plan_x = (line_plan(n, self.dtype) for n in shape)
        self._one_y, self._one_x = (np.ones(n, self.dtype) for n in shape)

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

    def divide(self, w: Array, system: System) -> None:
        """Solve the u-system whose right-hand side is given in two parts, each in the basis of one axis.

        Parameters
        ----------
        w : ndarray, shape `range_shape`
            ``w[0, 0]``, cosine coefficients along x, and ``w[0, 1]``, along y, sum up to the right-hand side;
            overwritten by the cosine coefficients of u along x and those along y.
        system
            See `solve`.
        """
        height, width = self.shape
        plan_y, plan_x, one_y, one_x = self._plan_y, self._plan_x, self._one_y, self._one_x
        in_x, in_y = w[0]
        along_y, along_x = system
        parallel_for(lambda a, b: cosine(in_x, 0, a, b, one_y, plan_y, in_x), width)
        parallel_for(lambda a, b: cosine(in_y, 1, a, b, one_x, plan_x, in_y), height)
        parallel_for(lambda a, b: add_and_divide(in_x, in_y, along_y, along_x, a, b), height)
        parallel_for(lambda a, b: cosine_back(in_x, 1, a, b, one_x, plan_x, in_y), height)
        parallel_for(lambda a, b: cosine_back(in_x, 0, a, b, one_y, plan_y, in_x), width)

    def transform(self, u: Array, w: Array) -> None:
        """Write the cosine coefficients of `u` along x and along y to ``w[0, 0]`` and ``w[0, 1]``."""
        plan_y, plan_x, one_y, one_x = self._plan_y, self._plan_x, self._one_y, self._one_x
        parallel_for(lambda a, b: cosine(u, 1, a, b, one_x, plan_x, w[0, 0]), self.shape[0])
        parallel_for(lambda a, b: cosine(u, 0, a, b, one_y, plan_y, w[0, 1]), self.shape[1])

    def back(self, w: Array, u: Array) -> None:
        """Write u from its cosine coefficients along x, ``w[0, 0]``."""
        plan, one = self._plan_x, self._one_x
        parallel_for(lambda a, b: cosine_back(w[0, 0], 1, a, b, one, plan, u), self.shape[0])


def _from_cosine_basis(eigenvalues: Float64Array) -> Float64Array:
    cosines = scipy.fft.dct(np.eye(eigenvalues.size), axis=0, norm="ortho")
    return scipy.fft.idct(eigenvalues[:, None] * cosines, axis=0, norm="ortho")


def _sine_symbol(n: int) -> Float64Array:
    return 2.0 * np.sin(np.pi * np.arange(n) / (2 * n))


class ReflectGradient(CosineGradient):
    r"""Left and right derivatives of u extended evenly about the edges.

    On the 2n-periodic even extension the Gruenwald-Letnikov sum is the Fourier multiplier
    ``(1 - e^{-iw})^alpha = (2 sin(w/2))^alpha e^{i alpha (pi - w)/2}``. Of a cosine series it makes a cosine
    and a sine series, ``D_- u = A - B`` and ``D_+ u = A + B``, so both derivatives cost one inverse
    DCT and one inverse DST.
    """

    pairs = 2
    weight: ClassVar[float] = 0.5

    def __init__(self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64) -> None:
        super().__init__(alpha, shape, dtype)
        self._cos_y, self._sin_y = self._multipliers(shape[0])
        self._cos_x, self._sin_x = self._multipliers(shape[1])

    def _multipliers(self, n: int) -> tuple[Array, Array]:
        modulus = _sine_symbol(n) ** self.alpha
        phase = self.alpha * (np.pi - np.pi * np.arange(n) / n) / 2.0
        return (modulus * np.cos(phase)).astype(self.dtype), (modulus * np.sin(phase)).astype(self.dtype)

    def apply(self, u: Array) -> Array:
        d = np.empty(self.range_shape, self.dtype)
        self._derivatives(_dct(u, 1), self._cos_x, self._sin_x, 1, d[:, 0])
        self._derivatives(_dct(u, 0), self._cos_y[:, None], self._sin_y[:, None], 0, d[:, 1])
        return d

    def adjoint(self, d: Array) -> Array:
        along_x = _idct(self._adjoint_coefficients(d[:, 0], self._cos_x, self._sin_x, 1), 1)
        along_y = _idct(self._adjoint_coefficients(d[:, 1], self._cos_y[:, None], self._sin_y[:, None], 0), 0)
        return along_x + along_y

    def differentiate(self, u: Array, d: Array) -> None:
        if not AVAILABLE:
            super().differentiate(u, d)
            return
        self.transform(u, d)
        self.spread(d[0], d)

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        if not AVAILABLE:
            super().solve(v, w, theta, mu, system, u)
            return
        self.collect(v, w, theta, mu)
        self.divide(w, system)
        self.back(w, u)
        self.spread(w[0], w)

    def collect(self, v: Array, w: Array, theta: float, mu: float) -> None:
        """Write the right-hand side ``v / theta + mu weight D^T w`` in two parts, each in the basis of one axis.

        Parameters
        ----------
        v, w, theta, mu
            See `solve`; ``theta = inf`` leaves `v` out. ``w[0, 0]`` is overwritten by the cosine coefficients
            along x of the terms of v and of the x-derivatives, ``w[0, 1]`` by those along y of the
            y-derivatives' term.
        """
        height, width = self.shape
        step, one = self.dtype.type(mu * self.weight), self._one_x
        direct = one[:0] if math.isinf(theta) else one / self.dtype.type(theta)
        to_x = step * self._cos_x, step * self._sin_x, direct, self._plan_x, w[0, 0]
        to_y = step * self._cos_y, step * self._sin_y, one[:0], self._plan_y, w[0, 1]
        parallel_for(lambda a, b: derivatives_adjoint(w, v, 1, a, b, *to_x), height)
        parallel_for(lambda a, b: derivatives_adjoint(w, v, 0, a, b, *to_y), width)

    def spread(self, cosines: Array, d: Array) -> None:
        """Write u's derivatives.

        Parameters
        ----------
        cosines : ndarray, shape (2, H, W)
            u's cosine coefficients along x and along y; may be ``d[0]``.
        d : ndarray, shape `range_shape`
            The derivatives, overwritten.
        """
        height, width = self.shape
        to_x, to_y = (self._cos_x, self._sin_x, self._plan_x), (self._cos_y, self._sin_y, self._plan_y)
        parallel_for(lambda a, b: derivatives(cosines[0], 1, a, b, *to_x, d), height)
        parallel_for(lambda a, b: derivatives(cosines[1], 0, a, b, *to_y, d), width)

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
    # The coefficient of frequency 0 is 0 and takes the place of frequency n, absent from a cosine series.
    return scipy.fft.idst(np.roll(x, -1, axis=axis), type=2, norm="ortho", axis=axis, workers=1)
