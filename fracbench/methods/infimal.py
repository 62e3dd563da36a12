"""TV-L1-SB-alpha with flow in two parts of different orders: the flow chooses its order pixel by pixel."""

from __future__ import annotations

from typing import Unpack

import numpy as np

from fracbench.errors import InputError
from fracbench.methods.alpha_map import any_v_step
from fracbench.model import pyramid
from fracbench.model.coarse_to_fine import FlowResult, RunOptions, coarse_to_fine
from fracbench.model.data_terms.choose import residual_factory
from fracbench.model.flow_filters import filter_factory
from fracbench.model.kernels.arrays import Array
from fracbench.model.operators.infimal import InfimalGradient
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import InfimalBregman, Regularizer, edge_weights


def tvl1_sb_alpha_ic(
    frame0: Array, frame1: Array, params: FlowParams, *, color: Array | None = None, **options: Unpack[RunOptions]
) -> FlowResult:
    """Compute flow as a sum of two parts, p of order `alpha` and q of order `alpha_smooth`.

    The extensions that `params` ask for are those of `tvl1_sb_alpha_map`. The parts are in `FlowResult.parts`.
    """
    for name, only in (("boundary", "reflect"), ("u_solver", "exact"), ("inner", "warm")):
        if getattr(params, name) != only:
            raise InputError(f"tvl1_sb_alpha_ic needs {name}={only}, got {getattr(params, name)}")
    if options.get("trace"):
        raise InputError("tvl1_sb_alpha_ic has no `trace`: the energy that it records is that of one order")
    steps: list[InfimalBregman] = []  # that of the last scale

    def next_scale(params: FlowParams, frame0: Array) -> Regularizer:
        height, width = frame0.shape
        if steps:
            smooth = pyramid.upsample_flow(steps.pop().smooth, (height, width), params.upsample_gain)
        else:
            smooth = np.zeros((2, height, width), frame0.dtype)
        steps.append(infimal_bregman(params, frame0, smooth))
        return steps[0]

    result = coarse_to_fine(
        frame0,
        frame1,
        params,
        next_scale,
        any_v_step,
        prepare_data=residual_factory,
        make_flow_filter=filter_factory(params, color, frame0.shape, options.get("mask")),
        method="tvl1_sb_alpha_ic",
        **options,
    )
    q = np.asarray(steps[0].smooth, np.float32)
    if q.shape != result.flow.shape:  # with `finest_scale` the last scale is a coarser one
        height, width = frame0.shape
        q = pyramid.upsample_flow(q, (height, width))
    result.parts = np.stack([result.flow - q, q])
    result.flow = result.parts.sum(axis=0)  # the same but for rounding
    return result


def infimal_bregman(params: FlowParams, frame0: Array, smooth: Array) -> InfimalBregman:
    """Return the u-step that `params` ask for, for a scale of which this is frame 0 and `smooth` the part q.

    The part p is the rest of the flow. It therefore takes all of the change that the filters of the flow make at
    the end of a warp: they remove outliers and sharpen the edges of motion, which belong to p, and would hardly
    change q, which has no jumps.
    """
    weights = np.ones((2, *frame0.shape), frame0.dtype)
    weights[1] *= params.smooth_weight
    if params.edge_decay:
        weights *= edge_weights(frame0, params.edge_decay, params.edge_power)
    multiplier = params.coupling == "multiplier"
    return InfimalBregman(
        InfimalGradient((params.alpha, params.alpha_smooth), weights, frame0.dtype, params.smooth_penalty),
        params.coupling_step if multiplier else params.theta,
        params.lambda_sb,
        smooth,
        relaxation=params.relaxation if multiplier else 1.0,
    )
