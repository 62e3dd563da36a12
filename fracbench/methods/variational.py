"""The paper's methods: each is Algorithm 1 with its own u-step."""

from __future__ import annotations

import numpy as np

from fracbench.model.arrays import Array
from fracbench.model.estimator import FlowResult, coarse_to_fine
from fracbench.model.fractional import make_operator
from fracbench.model.gradient import GradientOperator
from fracbench.model.params import FlowParams
from fracbench.model.reflected import NaturalGradient
from fracbench.model.regularizers import Regularizer, SplitBregman, TVDual
from fracbench.model.solver import MultiplierStep, PenaltyStep, VStep


def tvl1(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Compute TV-L1 flow; see `fracbench.methods.registry.Method` for the signature."""
    return coarse_to_fine(frame0, frame1, params, _tv_dual, method="tvl1", trace=trace)


def tvl1_sb(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Compute TV-L1-SB flow (Algorithm 3)."""
    return coarse_to_fine(frame0, frame1, params, _split_bregman, v_step, method="tvl1_sb", trace=trace)


def tvl1_sb_alpha(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Compute TV-L1-SB-alpha flow (Algorithm 4)."""
    return coarse_to_fine(frame0, frame1, params, split_bregman_alpha, v_step, method="tvl1_sb_alpha", trace=trace)


def v_step(like: Array, params: FlowParams) -> VStep:
    """Return the v-step that `params` ask for, for a scale of the shape of the flow `like`."""
    return MultiplierStep(like, params) if params.coupling == "multiplier" else PenaltyStep(like, params)


def _tv_dual(params: FlowParams, shape: tuple[int, int], dtype: np.dtype) -> Regularizer:
    return TVDual(shape, params.theta, params.tau, dtype)


def _split_bregman(params: FlowParams, shape: tuple[int, int], dtype: np.dtype) -> Regularizer:
    return _bregman(NaturalGradient(1.0, shape, dtype), params)


def split_bregman_alpha(params: FlowParams, shape: tuple[int, int], dtype: np.dtype) -> Regularizer:
    """Return the u-step of Algorithm 4 that `params` ask for, for a scale of this shape."""
    return _bregman(make_operator(params.boundary, params.alpha, shape, dtype, params.pad), params)


def _bregman(operator: GradientOperator, params: FlowParams) -> SplitBregman:
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
    )
