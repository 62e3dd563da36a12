"""The energy E^alpha_theta(u, v) of equation (Ethetaalpha): the one that is minimised, logged and tested.

All sums are in float64.
"""

from __future__ import annotations

import numpy as np

from fracbench.model.kernels.arrays import Array
from fracbench.model.operators.base import GradientOperator
from fracbench.model.warping import Linearization


def regularity(operator: GradientOperator, u: Array) -> float:
    """Return ``R(u)`` of one component (H, W): the weighted sum of the norms of its derivatives."""
    norms = np.sqrt(np.square(operator.apply(u), dtype=np.float64).sum(axis=1))
    if operator.pixel_weights is not None:
        norms *= np.repeat(operator.pixel_weights, operator.pairs // len(operator.pixel_weights), axis=0)
    return operator.weight * float(norms.sum())


def coupling(u: Array, v: Array, theta: float) -> float:
    """Return ``|u - v|^2 / (2 theta)`` of two arrays of one shape."""
    return float(np.square(u - v, dtype=np.float64).sum()) / (2.0 * theta)


def attachment(v: Array, linearization: Linearization, lambda_: float) -> float:
    """Return ``lambda |rho(v)|`` of a flow (2, H, W)."""
    rho = linearization.rho_c + linearization.gradient[0] * v[0] + linearization.gradient[1] * v[1]
    return lambda_ * float(np.abs(rho).sum(dtype=np.float64))


def energy(
    operator: GradientOperator, u: Array, v: Array, linearization: Linearization, lambda_: float, theta: float
) -> float:
    """Return E^alpha_theta(u, v) for one linearisation.

    Parameters
    ----------
    operator : GradientOperator
        The gradient of the regulariser.
    u, v : ndarray, shape (2, H, W)
        The flow and its auxiliary variable.
    linearization : Linearization
        The residual.
    lambda_, theta : float
        Data attachment weight and tightness.
    """
    regular = sum(regularity(operator, component) for component in u)
    return regular + coupling(u, v, theta) + attachment(v, linearization, lambda_)
