"""Other programs behind our registry, each with its own defaults; they take nothing from `FlowParams`.

OpenCV is given 8-bit frames, its native input; scikit-image frames scaled to 0..1, as its defaults expect.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fracbench.model.coarse_to_fine import FlowResult
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams

#: lambda = .15 on 0..255, IPOL's default, as scikit-image counts it on 0..1.
IPOL_ATTACHMENT = 0.15 * 255.0
#: Threads that OpenCV may use. One, so that tables do not depend on the machine; the benchmark sets others.
opencv_threads = 1


def opencv_tvl1(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run OpenCV's DualTVL1 with its defaults (5 scales, step .8, median filter 5)."""
    return _opencv("opencv_tvl1", frame0, frame1, params, lambda cv2: cv2.optflow.DualTVL1OpticalFlow_create())


def opencv_tvl1_deep(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run OpenCV's DualTVL1 with 6 scales, step .5: deep enough for the large motions."""

    def create(cv2: Any) -> Any:
        return cv2.optflow.DualTVL1OpticalFlow_create(scaleStep=0.5, nscales=6)

    return _opencv("opencv_tvl1_deep", frame0, frame1, params, create)


def opencv_dis(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run OpenCV's DIS flow, preset medium."""

    def create(cv2: Any) -> Any:
        return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)

    return _opencv("opencv_dis", frame0, frame1, params, create)


def opencv_farneback(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run OpenCV's Farneback flow with the defaults of its class."""
    return _opencv("opencv_farneback", frame0, frame1, params, lambda cv2: cv2.FarnebackOpticalFlow_create())


def _opencv(
    name: str, frame0: Array, frame1: Array, params: FlowParams, create: Callable[[Any], Any]
) -> FlowResult:
    import cv2

    cv2.setNumThreads(opencv_threads)
    first, second = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in (frame0, frame1))
    estimator = create(cv2)
    started = time.perf_counter()
    flow = estimator.calc(first, second, None)
    seconds = time.perf_counter() - started
    return FlowResult(np.ascontiguousarray(flow.transpose(2, 0, 1)), name, params, seconds={"solving": seconds})


def skimage_tvl1(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run scikit-image's TV-L1 with its defaults (attachment 15, no prefilter)."""
    from skimage.registration import optical_flow_tvl1

    return _skimage("skimage_tvl1", frame0, frame1, params, optical_flow_tvl1)


def skimage_tvl1_ipol(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run scikit-image's TV-L1 with IPOL's data weight and its prefilter."""
    from skimage.registration import optical_flow_tvl1

    return _skimage(
        "skimage_tvl1_ipol", frame0, frame1, params, optical_flow_tvl1, attachment=IPOL_ATTACHMENT, prefilter=True
    )


def skimage_ilk(frame0: Array, frame1: Array, params: FlowParams, *, trace: bool = False) -> FlowResult:
    """Run scikit-image's iterative Lucas-Kanade with its defaults."""
    from skimage.registration import optical_flow_ilk

    return _skimage("skimage_ilk", frame0, frame1, params, optical_flow_ilk)


def _skimage(
    name: str, frame0: Array, frame1: Array, params: FlowParams, function: Callable[..., Any], **settings: Any
) -> FlowResult:
    first, second = ((frame / 255.0).astype(np.float32) for frame in (frame0, frame1))
    started = time.perf_counter()
    rows, columns = function(first, second, **settings)
    seconds = time.perf_counter() - started
    return FlowResult(np.stack([columns, rows]).astype(np.float32), name, params, seconds={"solving": seconds})
