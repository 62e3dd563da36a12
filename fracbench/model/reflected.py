"""Gradients of images mirrored about their edges: the DCT-II diagonalises their normal operators."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import scipy.fft

from fracbench.model.arrays import Array, Float64Array
from fracbench.model.fourier import line_plan
from fracbench.model.gradient import GradientOperator
from fracbench.model.threads import share
from fracbench.model.transforms import cosine, cosine_back, derivatives, derivatives_adjoint, multiply_sum


class CosineGradient(GradientOperator):
    """What the operators share whose normal operator the DCT-II diagonalises.

    All is written with SciPy's transforms but for `solve`, where the time goes: it has our own.
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

    def divide(self, in_x: Array, in_y: Array, inverse: Array) -> None:
        """Bring both parts of the right-hand side into the basis, divide, and go back along either axis.

        Parameters
        ----------
        in_x, in_y : ndarray, shape (H, W)
            From `collect`; overwritten by u's cosine coefficients along x and along y.
        inverse : ndarray, shape (H, W)
            See `solve`.
        """
        height, width = self.shape
        plan_y, plan_x, one_y, one_x = self._plan_y, self._plan_x, self._one_y, self._one_x
        share(lambda a, b: cosine(in_x, 0, a, b, one_y, plan_y, in_x), width)
        share(lambda a, b: cosine(in_y, 1, a, b, one_x, plan_x, in_y), height)
        multiply_sum(in_x, in_y, inverse)
        share(lambda a, b: cosine_back(in_x, 1, a, b, one_x, plan_x, in_y), height)
        share(lambda a, b: cosine_back(in_x, 0, a, b, one_y, plan_y, in_x), width)

    def finish(self, in_x: Array, u: Array) -> None:
        """Write u from its cosine coefficients along x; both of shape (H, W)."""
        plan, one = self._plan_x, self._one_x
        share(lambda a, b: cosine_back(in_x, 1, a, b, one, plan, u), self.shape[0])


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
        self._work = np.empty(shape, self.dtype)

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

    def solve(self, v: Array, g: Array, theta: float, mu: float, inverse: Array, u: Array, du: Array) -> None:
        in_x, in_y = self._work, u  # u itself is written last
        self.collect(v, g, theta, mu, in_x, in_y)
        self.divide(in_x, in_y, inverse)
        self.spread(in_x, in_y, du)
        self.finish(in_x, u)

    def collect(self, v: Array, g: Array, theta: float, mu: float, in_x: Array, in_y: Array) -> None:
        """Write the right-hand side ``v / theta + mu weight D^T g``, each part along its own axis only.

        Parameters
        ----------
        v, g, theta, mu
            See `solve`; ``theta = inf`` leaves `v` out.
        in_x, in_y : ndarray, shape (H, W)
            Cosine coefficients along x of v's part and of that of g's x-derivatives, and along y of that of
            its y-derivatives; overwritten.
        """
        height, width = self.shape
        step, one = self.dtype.type(mu * self.weight), self._one_x
        direct = one[:0] if math.isinf(theta) else one / self.dtype.type(theta)
        to_x = step * self._cos_x, step * self._sin_x, direct, self._plan_x
        to_y = step * self._cos_y, step * self._sin_y, one[:0], self._plan_y
        share(lambda a, b: derivatives_adjoint(g, v, 1, a, b, *to_x, in_x), height)
        share(lambda a, b: derivatives_adjoint(g, v, 0, a, b, *to_y, in_y), width)

    def spread(self, in_x: Array, in_y: Array, du: Array) -> None:
        """Write u's derivatives.

        Parameters
        ----------
        in_x, in_y : ndarray, shape (H, W)
            u's cosine coefficients along x and along y.
        du : ndarray, shape `range_shape`
            The derivatives, overwritten.
        """
        height, width = self.shape
        to_x, to_y = (self._cos_x, self._sin_x, self._plan_x), (self._cos_y, self._sin_y, self._plan_y)
        share(lambda a, b: derivatives(in_y, 0, a, b, *to_y, du), width)
        share(lambda a, b: derivatives(in_x, 1, a, b, *to_x, du), height)

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


class NaturalGradient(CosineGradient):
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

    def solve(self, v: Array, g: Array, theta: float, mu: float, inverse: Array, u: Array, du: Array) -> None:
        height, width = self.shape
        real = self.dtype.type
        np.multiply(v, real(1.0 / theta), out=u)
        u += real(mu) * self.adjoint(g)
        plan_y, plan_x, one_y, one_x = self._plan_y, self._plan_x, self._one_y, self._one_x
        share(lambda a, b: cosine(u, 1, a, b, one_x, plan_x, u), height)
        share(lambda a, b: cosine(u, 0, a, b, one_y, plan_y, u), width)
        u *= inverse
        share(lambda a, b: cosine_back(u, 0, a, b, one_y, plan_y, u), width)
        share(lambda a, b: cosine_back(u, 1, a, b, one_x, plan_x, u), height)
        du[...] = self.apply(u)


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
