"""Gradients of images mirrored about their edges: the DCT-II diagonalises their normal operators."""

from __future__ import annotations

import math
from typing import Any, ClassVar

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

    `solve` and `differentiate`, which take nearly all of the time, use the vectorised transforms of
    `kernels.cosine` where these are available; the other methods use SciPy's.
    """

    def __init__(self, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64) -> None:
        super().__init__(alpha, shape, dtype)
        # The scale and the plan of a plain transform along each axis.
        self._unscaled_y, self._unscaled_x = ((np.ones(n, self.dtype), line_plan(n, self.dtype)) for n in shape)

    def to_basis(self, u: Array) -> Array:
        return scipy.fft.dctn(u, type=2, axes=(-2, -1), norm="ortho", workers=1)

    def from_basis(self, coefficients: Array) -> Array:
        return scipy.fft.idctn(coefficients, type=2, axes=(-2, -1), norm="ortho", workers=1)

    def eigenvalues(self) -> tuple[Float64Array, Float64Array]:
        ly, lx = (_sine_symbol(n) ** (2.0 * self.alpha) for n in self.shape)
        return ly, lx

    def normal_matrices(self) -> tuple[Float64Array, Float64Array]:
        ny, nx = (_idct(values[:, None] * _dct(np.eye(values.size), 0), 0) for values in self.eigenvalues())
        return ny, nx

    def divide(self, w: Array, system: System) -> None:
        """Solve the u-system whose right-hand side is given in two parts, each in the basis of one axis.

        The sum of ``w[0, 0]``, cosine coefficients along x, and ``w[0, 1]``, along y, is the right-hand side. The
        cosine coefficients of u along x and along y overwrite them.
        """
        in_x, in_y = w[0]
        along_y, along_x = system
        self.complete(w)
        parallel_for(lambda a, b: add_and_divide(in_x, in_y, along_y, along_x, a, b), self.shape[0])
        self.halve(w)

    def complete(self, w: Array) -> None:
        """Turn both parts of a right-hand side, ``w[0]`` of `divide`, into cosine coefficients along both axes."""
        parallel_for(lambda a, b: cosine(w[0, 0], 0, a, b, *self._unscaled_y, w[0, 0]), self.shape[1])
        parallel_for(lambda a, b: cosine(w[0, 1], 1, a, b, *self._unscaled_x, w[0, 1]), self.shape[0])

    def halve(self, w: Array) -> None:
        """Turn cosine coefficients along both axes, ``w[0, 0]``, into those along x, and along y, ``w[0, 1]``."""
        parallel_for(lambda a, b: cosine_back(w[0, 0], 1, a, b, *self._unscaled_x, w[0, 1]), self.shape[0])
        parallel_for(lambda a, b: cosine_back(w[0, 0], 0, a, b, *self._unscaled_y, w[0, 0]), self.shape[1])

    def transform(self, u: Array, w: Array) -> None:
        """Write the cosine coefficients of `u` along x and along y to ``w[0, 0]`` and ``w[0, 1]``."""
        parallel_for(lambda a, b: cosine(u, 1, a, b, *self._unscaled_x, w[0, 0]), self.shape[0])
        parallel_for(lambda a, b: cosine(u, 0, a, b, *self._unscaled_y, w[0, 1]), self.shape[1])

    def back(self, w: Array, u: Array) -> None:
        """Write u from its cosine coefficients along x, ``w[0, 0]``."""
        parallel_for(lambda a, b: cosine_back(w[0, 0], 1, a, b, *self._unscaled_x, u), self.shape[0])


def _sine_symbol(n: int) -> Float64Array:
    return 2.0 * np.sin(np.pi * np.arange(n) / (2 * n))


class ReflectGradient(CosineGradient):
    r"""Left and right derivatives of u extended evenly about the edges.

    On the 2n-periodic even extension the Gruenwald-Letnikov sum is the Fourier multiplier
    ``(1 - e^{-iw})^alpha = (2 sin(w/2))^alpha e^{i alpha (pi - w)/2}``. It turns a cosine series into a cosine
    series A and a sine series B with ``D_- u = A - B`` and ``D_+ u = A + B``, so that both derivatives together
    cost one inverse DCT and one inverse DST.
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

        ``w[0, 0]`` receives the cosine coefficients along x of the terms of v and of the x-derivatives, and
        ``w[0, 1]`` those along y of the term of the y-derivatives; ``theta = inf`` leaves `v` out.
        """
        height, width = self.shape
        step, (one, plan_x), (_, plan_y) = self.dtype.type(mu * self.weight), self._unscaled_x, self._unscaled_y
        direct = one[:0] if math.isinf(theta) else one / self.dtype.type(theta)
        to_x = step * self._cos_x, step * self._sin_x, direct, plan_x, w[0, 0]
        to_y = step * self._cos_y, step * self._sin_y, one[:0], plan_y, w[0, 1]
        parallel_for(lambda a, b: derivatives_adjoint(w, v, 1, a, b, *to_x), height)
        parallel_for(lambda a, b: derivatives_adjoint(w, v, 0, a, b, *to_y), width)

    def spread(self, cosines: Array, d: Array) -> None:
        """Write u's derivatives to `d` from its `cosines` along x and along y, (2, H, W); they may be ``d[0]``."""
        height, width = self.shape
        to_x = self._cos_x, self._sin_x, self._unscaled_x[1]
        to_y = self._cos_y, self._sin_y, self._unscaled_y[1]
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


def _dct(x: Array, axis: int) -> Any:
    return scipy.fft.dct(x, type=2, norm="ortho", axis=axis, workers=1)


def _idct(x: Array, axis: int) -> Any:
    return scipy.fft.idct(x, type=2, norm="ortho", axis=axis, workers=1)


def _dst(x: Array, axis: int) -> Array:
    # DST-II numbers its frequencies 1..n; shift them to the DCT's 0..n-1 (frequency 0 has no sine).
    result = np.roll(scipy.fft.dst(x, type=2, norm="ortho", axis=axis, workers=1), 1, axis=axis)
    result[(slice(None),) * axis + (0,)] = 0.0
    return result


def _idst(x: Array, axis: int) -> Array:
    # The coefficient of frequency 0 is 0 and takes the place of frequency n, absent from a cosine series.
    return scipy.fft.idst(np.roll(x, -1, axis=axis), type=2, norm="ortho", axis=axis, workers=1)
