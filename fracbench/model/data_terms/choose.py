"""Choice of the data term by the parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracbench.model import pyramid
from fracbench.model.data_terms.brightness import Brightness, Residual, TwoSided
from fracbench.model.data_terms.gradients import ImageAndGradient
from fracbench.model.data_terms.grown import grown
from fracbench.model.data_terms.occlusion import OcclusionWeighted, Visibility
from fracbench.model.data_terms.texture import textures
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams


def residual_factory(
    frame0: Array, frame1: Array, params: FlowParams
) -> Callable[[Array, Array, FlowParams], Residual]:
    """Return the function that makes the residual of each scale from both frames there.

    Textures are taken at full resolution and follow the frames down the pyramid (Wedel et al. 2009): textures of a
    coarse scale would lack the structure by which large motions are found. With `lambda_growth` the weight of the
    data grows towards the coarse scales.
    """
    make = _by_textures(frame0, frame1, params) if params.texture else make_residual
    return grown(make, frame0.shape, params.lambda_growth) if params.lambda_growth else make


def _by_textures(
    frame0: Array, frame1: Array, params: FlowParams
) -> Callable[[Array, Array, FlowParams], Residual]:
    pair = textures(*pyramid.stretch(frame0, frame1, np.dtype(params.dtype)), params.texture)
    shapes = pyramid.scale_shapes(frame0.shape, params.eta, params.n_scales)
    scales = [pyramid.build(pyramid.smooth(t, params.presmoothing), shapes, params.eta) for t in pair]
    by_shape = dict(zip(shapes, zip(*scales, strict=True), strict=True))
    return lambda frame0, frame1, params: make_residual(frame0, frame1, params, by_shape[frame0.shape])


def make_residual(
    frame0: Array, frame1: Array, params: FlowParams, images: tuple[Array, Array] | None = None
) -> Residual:
    """Return the data term of a scale: of its frames, or of two `images` in their place.

    Visibility is that of the frames in any case.
    """
    plain = TwoSided if params.derivatives == "both" else Brightness
    kind = ImageAndGradient if params.lambda_gradient else plain
    found: Residual = kind(*(images or (frame0, frame1)), params)
    return OcclusionWeighted(found, Visibility(frame0, frame1, params)) if params.occlusion == "both" else found
