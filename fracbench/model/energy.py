"""The energy E^alpha_theta(u, v) of equation (Ethetaalpha): the one that is minimised, logged and tested."""

from __future__ import annotations

import numpy as np

from fracbench.model.kernels.arrays import Array
from fracbench.model.operators.base import GradientOperator
from fracbench.model.warping import Linearization


def regularity(operator: GradientOperator, u: Array) -> float:
    """Return ``R(u)`` of one component: the weighted sum of the norms of its derivatives.

    Parameters
    ----------
    operator : GradientOperator
        The gradient.
    u : ndarray, shape (H, W)
        One component of the flow.

    Returns
    -------
    float
        Summed in float64.
    """
    norms = np.sqrt(np.square(operator.apply(u), dtype=np.float64).sum(axis=1))
    if operator.pixel_weights is not None:
        norms *= np.repeat(operator.pixel_weights, operator.pairs // len(operator.pixel_weights), axis=0)
    return operator.weight * float(norms.sum())


def coupling(u: Array, v: Array, theta: float) -> float:
    """Return ``|u - v|^2 / (2 theta)``, summed in float64.

    Parameters
    ----------
    u, v : ndarray
        Arrays of one shape.
    theta : float
        Tightness.

    Returns
    -------
    float
        The term.
    """
    return float(np.square(u - v, dtype=np.float64).sum()) / (2.0 * theta)


def attachment(v: Array, linearization: Linearization, lambda_: float) -> float:
    """Return ``lambda |rho(v)|``, summed in float64.

    Parameters
    ----------
    v : ndarray, shape (2, H, W)
        Flow.
    linearization : Linearization
        The residual.
    lambda_ : float
        Data attachment weight.

    Returns
    -------
    float
        The term.
    """
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
        The flow and its partner.
    linearization : Linearization
        The residual.
    lambda_, theta : float
        Data attachment weight and tightness.

    Returns
    -------
    float
        The energy.
    """
    regular = sum(regularity(operator, component) for component in u)
    return regular + coupling(u, v, theta) + attachment(v, linearization, lambda_)
