"""The paper's methods: each is Algorithm 1 with its own u-step."""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np

from fracbench.errors import InputError
from fracbench.model import pyramid
from fracbench.model.coarse_to_fine import FlowResult, ResidualFactory, RunOptions, coarse_to_fine
from fracbench.model.data_terms.switched import switched_residual
from fracbench.model.energy import regularity
from fracbench.model.kernels.arrays import Array
from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import Regularizer, SplitBregman, TVDual
from fracbench.model.sweeps import five_point_switches
from fracbench.model.v_steps import MultiplierStep, VStep, v_step_of_penalty


def tvl1(frame0: Array, frame1: Array, params: FlowParams, **options: Unpack[RunOptions]) -> FlowResult:
    """Compute TV-L1 flow; see `fracbench.methods.registry.Method` for the signature."""
    return coarse_to_fine(
        frame0, frame1, params, _tv_dual, v_step_of_penalty, prepare_data=_data, method="tvl1", **options
    )


def tvl1_sb(frame0: Array, frame1: Array, params: FlowParams, **options: Unpack[RunOptions]) -> FlowResult:
    """Compute TV-L1-SB flow (Algorithm 3)."""
    return coarse_to_fine(
        frame0, frame1, params, _split_bregman, v_step, prepare_data=_data, method="tvl1_sb", **options
    )


def tvl1_sb_alpha(frame0: Array, frame1: Array, params: FlowParams, **options: Unpack[RunOptions]) -> FlowResult:
    """Compute TV-L1-SB-alpha flow (Algorithm 4)."""
    return coarse_to_fine(
        frame0, frame1, params, split_bregman_alpha, v_step, prepare_data=_data, method="tvl1_sb_alpha", **options
    )


def v_step(like: Array, params: FlowParams) -> VStep:
    """Return the v-step that `params` ask for, for a scale of the shape of the flow `like`."""
    if params.coupling == "penalty":
        return v_step_of_penalty(like, params)
    if params.threshold != "full":
        raise InputError(f"`threshold` needs coupling=penalty, got {params.threshold} with {params.coupling}")
    return MultiplierStep(like, params)


def _data(frame0: Array, frame1: Array, params: FlowParams) -> ResidualFactory:
    return switched_residual


def _tv_dual(params: FlowParams, frame0: Array) -> Regularizer:
    return TVDual(_shape(frame0), params.theta, params.tau, frame0.dtype, params.sweeps)


def _split_bregman(params: FlowParams, frame0: Array) -> Regularizer:
    bregman = split_bregman(_forward_differences(params, frame0), params)
    if params.u_solver != "exact":
        bregman.five_point = five_point_switches(params)
    return bregman


def split_bregman_alpha(params: FlowParams, frame0: Array) -> Regularizer:
    """Return the u-step of Algorithm 4 that `params` ask for, for a scale of which this is frame 0."""
    return split_bregman(_fractional(params, frame0), params)


def _forward_differences(params: FlowParams, frame0: Array) -> GradientOperator:
    return ForwardDifferences(1.0, _shape(frame0), frame0.dtype)


def _fractional(params: FlowParams, frame0: Array) -> GradientOperator:
    return make_operator(params.boundary, params.alpha, _shape(frame0), frame0.dtype, params.pad)


def _shape(image: Array) -> tuple[int, int]:
    height, width = image.shape
    return height, width


def split_bregman(operator: GradientOperator, params: FlowParams) -> SplitBregman:
    """Return the u-step that `params` ask for, with this gradient."""
    multiplier = params.coupling == "multiplier"
    return SplitBregman(
        operator,
        params.coupling_step if multiplier else params.theta,
        params.lambda_sb,
        u_solver=params.u_solver,
        inner=params.inner,
        relaxation=params.relaxation if multiplier else 1.0,
        tol=params.tol,
        max_inner=params.max_inner,
        penalty=params.lambda_l,
        isotropic=params.shrinkage == "isotropic",
        tol_norm=params.tol_norm,
    )


_GRADIENTS = {"tvl1": _forward_differences, "tvl1_sb": _forward_differences, "tvl1_sb_alpha": _fractional}


def energy_growth(
    name: str, frame0: Array, frame1: Array, flow: Array, params: FlowParams, enough: float = 0.0
) -> float | None:
    """Return the regularity of a flow, (2, H, W), relative to the energy of no flow.

    That is ``(R(u1) + R(u2)) / (lambda sum |I1 - I0|)``. The data term is bounded, so that an energy that grows
    without bound does so in R. Below `enough` an upper bound is returned, which takes a tenth of the time. The
    result is None for a method that minimises another energy; it is infinite or NaN where the sums overflow, or
    for a flow between equal frames.
    """
    if name not in _GRADIENTS:
        return None
    params = params.weighted()
    _, gain = pyramid.scaling(frame0, frame1, params.intensity)
    change = np.subtract(frame1, frame0, dtype=np.float64)
    before = params.lambda_ * gain * float(np.abs(change, out=change).sum())
    with np.errstate(over="ignore", invalid="ignore"):
        bound = _largest_regularity(name, flow, params)
        if bound < enough * before:
            return bound / before
        dtype = np.dtype(params.dtype)
        operator = _GRADIENTS[name](params, frame0.astype(dtype))
        after = sum(regularity(operator, component) for component in np.asarray(flow, dtype))
    return after / before if before else (math.inf if after else 0.0)


def _largest_regularity(name: str, flow: Array, params: FlowParams) -> float:
    """Return an upper bound of R(u1) + R(u2), by the norm of the derivatives, ``2^alpha``, and of the flow."""
    alpha = params.alpha if _GRADIENTS[name] is _fractional else 1.0
    pixels = math.prod(n + params.pad for n in flow.shape[1:])
    return 2.0 ** (alpha + 1.0) * math.sqrt(pixels) * math.sqrt(np.vdot(flow, flow))
