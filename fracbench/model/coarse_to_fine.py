"""The coarse-to-fine driver (Algorithm 1) of all methods."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError
from fracbench.model import pyramid
from fracbench.model.confidence import Confidence
from fracbench.model.data_terms.brightness import Brightness, Residual
from fracbench.model.data_terms.masked import Masked, valid_shares, without_masked
from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.threads import parallel_map, worth_threads
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import Regularizer
from fracbench.model.single_level import LevelReport, Stopwatch, solve_single_level
from fracbench.model.v_steps import PenaltyStep, VStep

#: Components of this size and above mark a pixel of unknown flow in files.
UNKNOWN = 1e9

RegularizerFactory = Callable[[FlowParams, Array], Regularizer]
VStepFactory = Callable[[Array, FlowParams], VStep]
ResidualFactory = Callable[[Array, Array, FlowParams], Residual]
DataFactory = Callable[[Array, Array, FlowParams], ResidualFactory]
FlowFilterFactory = Callable[[Array, Array, FlowParams], Callable[[Array], Array] | None]


class RunOptions(TypedDict, total=False):
    """The keyword arguments that a method hands on to `coarse_to_fine`, for each pair of frames anew."""

    trace: bool
    mask: NDArray[np.bool_] | None
    initial_flow: Array | None


@dataclass
class FlowResult:
    """A computed flow, with its iterations and timings.

    Attributes
    ----------
    flow : ndarray, shape (2, H, W), float32
        ``flow[0]`` = u1, to the right, ``flow[1]`` = u2, down, pixels: frame0(x, y) matches
        frame1(x + u1, y + u2).
    method : str
    params : FlowParams
    levels : list of LevelReport
        One per scale, from coarsest to finest; empty for peers, which do not report them.
    seconds : dict
        Wall-clock seconds by phase.
    notices : list of str
        Notices for the user, e.g. that the image allows fewer scales than `n_scales`.
    confidence : Confidence or None
        The forward-backward check, where it was asked for.
    parts : ndarray, shape (2 parts, 2, H, W), float32, or None
        The two parts of the flow, whose sum it is, by `tvl1_sb_alpha_ic`; else None.
    """

    flow: Array
    method: str
    params: FlowParams
    levels: list[LevelReport] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)
    confidence: Confidence | None = None
    parts: Array | None = None

    @property
    def iterations(self) -> list[list[int]]:
        """Iterations by scale (coarsest first) and warp."""
        return [level.iterations for level in self.levels]

    @property
    def stop_reason(self) -> str:
        """``"diverged"`` if any warp did, else ``"max_iter"`` if any hit it, else ``"converged"``.

        ``"not told"`` for peers, which do not report their iterations.
        """
        reasons = {reason for level in self.levels for reason in level.stop}
        if not np.isfinite(self.flow).all() or "diverged" in reasons:
            return "diverged"
        if not self.levels:
            return "not told"
        return "max_iter" if "max_iter" in reasons else "converged"

    @property
    def ending(self) -> str:
        """The end of the computation in words: warps that reached the limit of iterations, and the last change."""
        if self.stop_reason == "diverged":
            return "diverged"
        if not self.levels:
            return "the method does not report how it ended"
        stops = [reason for level in self.levels for reason in level.stop]
        limited, last = stops.count("max_iter"), self.levels[-1]
        change = last.change[-1] * self.flow.shape[2] / last.shape[1]
        warps = f"all {len(stops)} warps" if limited in (0, len(stops)) else f"{limited} of {len(stops)} warps"
        ended = f"reached the limit of {self.params.max_iter} iterations" if limited else "converged"
        return f"{warps} {ended}; the last iteration changed the flow by {change:.2g} px"


def coarse_to_fine(
    frame0: Array,
    frame1: Array,
    params: FlowParams,
    make_regularizer: RegularizerFactory,
    make_v_step: VStepFactory = PenaltyStep,
    *,
    prepare_data: DataFactory = lambda *_: Brightness,
    make_flow_filter: FlowFilterFactory | None = None,
    method: str = "",
    trace: bool = False,
    mask: NDArray[np.bool_] | None = None,
    initial_flow: Array | None = None,
) -> FlowResult:
    """Run Algorithm 1: stretch, smooth, build the pyramids, solve from the coarsest scale to the finest.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        Gray frames of any scale of intensity; never changed.
    params : FlowParams
    make_regularizer, make_v_step : callable
        Return the u-step and the v-step of a scale; the paper's v-step by default.
    prepare_data : callable, optional
        Takes the frames, with masked pixels filled, and returns the function that makes the data term of a scale
        from the frames there; it is the paper's by default.
    make_flow_filter : callable, optional
        Returns the filter of the flow after each warp at a scale, e.g. a median filter.
    method : str, optional
        Name for the result.
    trace : bool, optional
        Record the energy after each iteration (slow).
    mask : ndarray of bool, shape (H, W) or (2, H, W), optional
        True at the pixels of both frames, or of frame 0 and frame 1, whose values do not count.
    initial_flow : ndarray, shape (2, H, W), optional
        Flow, pixels, to start from at the coarsest scale, in place of 0; see `pyramid.downsample_flow`.

    Raises
    ------
    InputError
        Frames of different or too small size; a mask or an initial flow of another shape or type, or without data.
    """
    check_frames(frame0, frame1)
    if initial_flow is not None:
        check_initial_flow(initial_flow, frame0.shape)
    watch = Stopwatch()
    given, params = params, params.weighted()
    dtype = np.dtype(params.dtype)
    shapes = pyramid.scale_shapes(frame0.shape, params.eta, params.n_scales)
    frame0, frame1 = without_masked(frame0, frame1, mask)
    if params.normalisation:
        frame0, frame1 = pyramid.normalise(frame0, frame1, params.normalisation, dtype)
    make_residual = prepare_data(frame0, frame1, params)
    shares = None if mask is None else valid_shares(mask, shapes, params.eta, dtype)
    pyramids = parallel_map(
        lambda frame: pyramid.scales(frame, shapes, params),
        pyramid.stretch(frame0, frame1, dtype, params.intensity),
    )
    watch.lap("pyramid")
    flow = aligned((2, *shapes[-1]), dtype)
    if initial_flow is not None:
        flow[...] = pyramid.downsample_flow(initial_flow.astype(dtype), shapes, params.eta)
    levels: list[LevelReport] = []
    finest = min(params.finest_scale, len(shapes) - 1)
    for s in reversed(range(finest, len(shapes))):
        with worth_threads(math.prod(shapes[s])):
            if s < len(shapes) - 1:
                flow = pyramid.upsample_flow(flow, shapes[s], params.upsample_gain, params.upsampling)
            frames = pyramids[0].pop(), pyramids[1].pop()
            residual, v_step = make_residual(*frames, params), make_v_step(flow, params)
            if shares is not None:
                residual = Masked(residual, shares[0].pop(), shares[1].pop())
            regularizer = make_regularizer(params, frames[0])
            filter_flow = make_flow_filter(*frames, params) if make_flow_filter else None
            del frames  # free the memory of frames that no part has kept
            watch.lap("setup")
            flow, report = solve_single_level(
                residual, flow, params, regularizer, v_step, watch, filter_flow=filter_flow, trace=trace
            )
            levels.append(report)
            del residual, v_step, regularizer, filter_flow  # before those of the next scale are made
    if finest:
        flow = pyramid.upsample_flow(flow, shapes[0])
        watch.lap("upsampling")
    return FlowResult(
        np.asarray(flow, np.float32), method, given, levels, dict(watch.seconds), _notices(params, shapes)
    )


def check_frames(frame0: Array, frame1: Array) -> None:
    """Refuse frames that are not two-dimensional, differ in size or are smaller than the bicubic stencil."""
    if frame0.shape != frame1.shape:
        sizes = f"{_size(frame0.shape)} and {_size(frame1.shape)}"
        raise InputError(f"frames differ in size: {sizes} (width x height)")
    if frame0.ndim != 2 or min(frame0.shape) < pyramid.MIN_SIDE:
        least = _size((pyramid.MIN_SIDE, pyramid.MIN_SIDE))
        raise InputError(f"frames of {_size(frame0.shape)} pixels are too small: at least {least} are needed")


def check_initial_flow(flow: Array, shape: tuple[int, ...]) -> None:
    """Refuse a flow that is not of the frames' `shape`, or has values that are NaN, infinite or marked unknown."""
    if flow.shape != (2, *shape):
        raise InputError(f"`initial_flow`: shape {flow.shape} given, {(2, *shape)} needed")
    bad = ~(np.abs(flow) < UNKNOWN).all(axis=0)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"`initial_flow`: {int(bad.sum())} of {bad.size} pixels are NaN, infinite or unknown, "
            f"the first at row {row}, column {column}"
        )


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in reversed(shape))


def _notices(params: FlowParams, shapes: list[tuple[int, int]]) -> list[str]:
    notices = []
    if params.n_scales is not None and len(shapes) < params.n_scales:
        notices.append(
            f"n_scales reduced from {params.n_scales} to {len(shapes)}: "
            f"the coarsest image would be smaller than the smallest useful one ({_size(shapes[0])} pixels given)"
        )
    if params.finest_scale >= len(shapes):
        notices.append(f"finest_scale reduced from {params.finest_scale} to {len(shapes) - 1}, the coarsest scale")
    return notices
