"""The interface of the gradient operators, and the u-step by diagonalisation (sections 2 and 3.2 of the paper).

An operator maps an image ``u`` of shape ``(H, W)`` to ``pairs`` of (x, y) derivatives of shape
``(pairs, 2, h, w)`` and stands for the regulariser ``R(u) = weight * sum_pairs sum_pixels |D_pair u|``, where
`MappedGradient` (`operators.alpha_map`) gives the norms weights that vary from pixel to pixel. Each knows its
exact adjoint and the basis in which its normal operator ``weight * sum_pairs D_pair^T D_pair`` is the sum of two
diagonals, one per axis, so that the u-step is a division. `operators.choose` lists the boundary rules.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array, Float64Array

#: A factorised u-system.
System: TypeAlias = tuple[NDArray[Any], ...]


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
    pixel_weights : ndarray, shape (K, h, w), or None
        Factors on the norms, each plane for ``pairs / K`` consecutive pairs; None for 1 everywhere.
    range_shape : tuple of int
        Shape of ``apply(u)``.
    """

    pairs: int = 1
    weight: ClassVar[float] = 1.0
    pixel_weights: Array | None = None

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

    def differentiate(self, u: Array, d: Array) -> None:
        """Write all derivatives of `u` to `d`, shape `range_shape`; an operator may have a faster way."""
        d[...] = self.apply(u)

    def factor(self, theta: float, mu: float) -> System:
        """Factorise the u-system ``1/theta + mu weight sum_pairs D^T D`` for `solve`, with ``mu = lambda_sb``.

        The default is the pair ``1/theta + mu ly`` and ``mu lx`` of the eigenvalues, shapes (H,) and (W,), whose
        outer sum is the system in the operator's basis.
        """
        ly, lx = self.eigenvalues()
        return 1.0 / theta + mu * ly, mu * lx

    def solve(self, v: Array, w: Array, theta: float, mu: float, system: System, u: Array) -> None:
        """Take the u-step of one component: minimise ``|u - v|^2 / (2 theta) + mu/2 weight |D u - w|^2``.

        Operators override this formula by faster algorithms with the same result.

        Parameters
        ----------
        v : ndarray, shape (H, W)
            Data.
        w : ndarray, shape `range_shape`
            ``d - b``, overwritten by the derivatives of the minimiser.
        theta, mu : float
            Tightness and split Bregman parameter.
        system
            The factorisation by `factor` for the same `theta` and `mu`.
        u : ndarray, shape (H, W)
            Output: the minimiser.
        """
        real = self.dtype.type
        rhs = v / real(theta) + real(mu * self.weight) * self.adjoint(w)
        u[...] = self.from_basis(self.to_basis(rhs) / np.add.outer(*system))
        self.differentiate(u, w)
