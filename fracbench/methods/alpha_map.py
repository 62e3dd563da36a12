"""TV-L1-SB-alpha with an order that varies from pixel to pixel: by the structure of frame 0, or as given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

import numpy as np

from fracbench.errors import InputError
from fracbench.methods.paper import split_bregman, v_step
from fracbench.model import pyramid
from fracbench.model.coarse_to_fine import FlowResult, RunOptions, coarse_to_fine
from fracbench.model.data_terms.choose import residual_factory
from fracbench.model.flow_filters import filter_factory
from fracbench.model.kernels.arrays import Array
from fracbench.model.operators.alpha_map import MappedGradient
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import Regularizer, edge_weights
from fracbench.model.structure import CLASSES, structure_classes
from fracbench.model.v_steps import VStep, channel_step


def tvl1_sb_alpha_map(
    frame0: Array, frame1: Array, params: FlowParams, *, color: Array | None = None, **options: Unpack[RunOptions]
) -> FlowResult:
    """Compute flow with one order for each class of structure, and the extensions that `params` ask for.

    The classes are `structure_classes` of frame 0 at each scale.
    """
    if options.get("trace") and params.lambda_gradient:
        raise InputError("`trace` needs lambda_gradient=0: the energy that it records is the paper's")
    return coarse_to_fine(
        frame0,
        frame1,
        params,
        _by_class,
        any_v_step,
        prepare_data=residual_factory,
        make_flow_filter=filter_factory(params, color, frame0.shape, options.get("mask")),
        method="tvl1_sb_alpha_map",
        **options,
    )


def any_v_step(like: Array, params: FlowParams) -> VStep:
    """Return the v-step that `params` ask for, with or without gradient constancy."""
    return channel_step(like, params) or v_step(like, params)


def flow_with_orders(
    frame0: Array, frame1: Array, params: FlowParams, alphas: Sequence[float], weights: Array
) -> FlowResult:
    """Compute flow with a given map of orders.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        Gray frames.
    params : FlowParams
        Parameters but for the order.
    alphas : sequence of K floats
        The orders.
    weights : ndarray, shape (K, H, W)
        Weight of each order at a pixel; see `MappedGradient`. They follow the frames down the pyramid.
    """
    shapes = pyramid.scale_shapes(frame0.shape, params.eta, params.n_scales)
    levels = [pyramid.build(plane, shapes, params.eta) for plane in weights]
    by_shape = {shape: np.stack(planes).clip(0.0) for shape, *planes in zip(shapes, *levels, strict=True)}

    def as_given(params: FlowParams, frame0: Array) -> Regularizer:
        return split_bregman(MappedGradient(alphas, by_shape[frame0.shape], frame0.dtype), params)

    return coarse_to_fine(frame0, frame1, params, as_given, v_step, method="tvl1_sb_alpha_map")


def _by_class(params: FlowParams, frame0: Array) -> Regularizer:
    orders = [getattr(params, f"alpha_{name}") for name in CLASSES]
    alphas = sorted(set(orders))  # classes of one order share their split variable
    of_class = np.array([alphas.index(order) for order in orders])
    classes = structure_classes(frame0) if len(alphas) > 1 else np.zeros(frame0.shape, np.uint8)
    weights = np.equal.outer(np.arange(len(alphas)), of_class[classes]).astype(frame0.dtype)
    if params.edge_decay:
        weights *= edge_weights(frame0, params.edge_decay, params.edge_power)
    return split_bregman(MappedGradient(alphas, weights, frame0.dtype), params)
