"""Other programs as methods, each with its own defaults.

OpenCV is given 8-bit frames, its native input; scikit-image frames scaled to 0..1, as its defaults expect; OpenPIV
the frames as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from fracbench.errors import InputError
from fracbench.methods.method import Method, fields_of
from fracbench.model.params import public_name

if TYPE_CHECKING:
    from fracbench.model.kernels.arrays import Array

#: lambda = 0.15 on 0..255, IPOL's default, as scikit-image counts it on 0..1.
IPOL_ATTACHMENT = 0.15 * 255.0
#: Threads that OpenCV may use. One, so that tables do not depend on the machine; the benchmark sets others.
opencv_threads = 1
#: Sides of OpenPIV's interrogation windows in pixels, pass by pass; each overlaps half of its neighbour.
WINDOWS = (64, 32, 16)
#: The least side of a frame: OpenPIV passes a cubic spline through the first vectors, at least 4 on each line.
_LEAST_SIDE = 5 * WINDOWS[0] // 2


@dataclass(frozen=True)
class DualTVL1:
    """Parameters of OpenCV's TV-L1."""

    lambda_: float = 0.15
    n_scales: int = 5
    scale_step: float = 0.8
    median_filter: int = 5


@dataclass(frozen=True)
class Dis:
    """Parameters of OpenCV's dense inverse search."""

    preset: Literal["ultrafast", "fast", "medium"] = "medium"


@dataclass(frozen=True)
class Farneback:
    """Parameters of OpenCV's Farneback flow."""

    n_scales: int = 5
    window: int = 13


@dataclass(frozen=True)
class SkimageTVL1:
    """Parameters of scikit-image's TV-L1."""

    attachment: float = 15.0
    prefilter: bool = False


@dataclass(frozen=True)
class Ilk:
    """Parameters of scikit-image's iterative Lucas-Kanade."""

    radius: int = 7


@dataclass(frozen=True)
class OpenPIV:
    """Parameters of OpenPIV's multi-pass cross-correlation.

    The first `passes` of `WINDOWS` are made. With ``deformation="second_image"`` the displacement at x is that of
    the particle which is at x in frame 0, as in every other method here; with OpenPIV's default ``"symmetric"`` it
    is that of the particle which is at x halfway between the frames.
    """

    passes: int = 3
    deformation: Literal["second_image", "symmetric"] = "second_image"

    def __post_init__(self) -> None:
        if not 2 <= self.passes <= len(WINDOWS):
            raise ValueError(f"`passes` must be within 2..{len(WINDOWS)}, got {self.passes}")


def _opencv_tvl1(frame0: Array, frame1: Array, params: DualTVL1) -> Array:
    own = _cv2().optflow.DualTVL1OpticalFlow_create(
        lambda_=params.lambda_,
        nscales=params.n_scales,
        scaleStep=params.scale_step,
        medianFiltering=params.median_filter,
    )
    return _opencv(own, frame0, frame1)


def _opencv_dis(frame0: Array, frame1: Array, params: Dis) -> Array:
    cv2 = _cv2()
    preset = getattr(cv2, f"DISOPTICAL_FLOW_PRESET_{params.preset.upper()}")
    return _opencv(cv2.DISOpticalFlow_create(preset), frame0, frame1)


def _opencv_farneback(frame0: Array, frame1: Array, params: Farneback) -> Array:
    own = _cv2().FarnebackOpticalFlow_create(numLevels=params.n_scales, winSize=params.window)
    return _opencv(own, frame0, frame1)


def _cv2() -> Any:
    import cv2

    return cv2


def _opencv(own: Any, frame0: Array, frame1: Array) -> Array:
    import numpy as np

    _cv2().setNumThreads(opencv_threads)
    first, second = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in (frame0, frame1))
    flow: Array = own.calc(first, second, None)
    return flow.transpose(2, 0, 1)


def _skimage_tvl1(frame0: Array, frame1: Array, params: SkimageTVL1) -> Array:
    from skimage.registration import optical_flow_tvl1

    flow = optical_flow_tvl1(*_to_unit(frame0, frame1), attachment=params.attachment, prefilter=params.prefilter)
    return flow[::-1]


def _skimage_ilk(frame0: Array, frame1: Array, params: Ilk) -> Array:
    from skimage.registration import optical_flow_ilk

    return optical_flow_ilk(*_to_unit(frame0, frame1), radius=params.radius)[::-1]


def _openpiv(frame0: Array, frame1: Array, params: OpenPIV) -> Array:
    """Return the vectors of the last pass, interpolated to all pixels by a cubic spline through them.

    The spline is the one by which OpenPIV deforms its windows; beyond the outermost vectors it is constant.
    """
    import numpy as np
    from scipy.interpolate import RectBivariateSpline

    if min(frame0.shape) < _LEAST_SIDE:
        shape = " x ".join(map(str, frame0.shape))
        raise InputError(f"method 'openpiv' needs frames of at least {_LEAST_SIDE} x {_LEAST_SIDE}, got {shape}")
    x, y, vectors = _openpiv_vectors(frame0, frame1, params)
    rows, cols = (np.clip(np.arange(n), at[0], at[-1]) for n, at in zip(frame0.shape, (y, x), strict=True))
    return np.stack([RectBivariateSpline(y, x, part)(rows, cols) for part in vectors])


def _openpiv_vectors(frame0: Array, frame1: Array, params: OpenPIV) -> tuple[Array, Array, Array]:
    """Return where OpenPIV's vectors are, x and y in pixels, and the vectors, (2, len(y), len(x)), y down."""
    import contextlib
    import io

    import numpy as np
    from openpiv import windef

    windows = WINDOWS[: params.passes]
    settings = windef.PIVSettings(
        windowsizes=windows,
        overlap=tuple(side // 2 for side in windows),
        num_iterations=len(windows),
        deformation_method=params.deformation.replace("_", " "),
        backend="scipy",  # by default that of another package, where it is installed
    )
    with contextlib.redirect_stdout(io.StringIO()):  # it prints how many vectors it replaced
        x, y, u, v, _ = windef.simple_multipass(np.asarray(frame0), np.asarray(frame1), settings)
    # OpenPIV's y axis points up: rows come from the top, their y from the bottom.
    return x[0], y[::-1, 0], np.stack((u, -v))


def _to_unit(*frames: Array) -> tuple[Array, ...]:
    import numpy as np

    return tuple((frame / 255.0).astype(np.float32) for frame in frames)


def _peer(
    name: str, label: str, summary: str, estimate: Any, params: type, module: str, **defaults: Any
) -> Method:
    # results of these values were stored before there were parameters
    start = {public_name(name): value for name, value in {**fields_of(params()), **defaults}.items()}
    return Method(
        name,
        label,
        summary,
        estimate,
        params,
        defaults=defaults,
        younger=start,
        requires=(module,),
        frame_dtype=None,
    )


PEERS = (
    _peer("opencv_tvl1", "OpenCV DualTVL1", "OpenCV's TV-L1, defaults", _opencv_tvl1, DualTVL1, "cv2"),
    _peer(
        "opencv_tvl1_deep",
        "OpenCV DualTVL1 (6 scales)",
        "OpenCV's TV-L1, 6 scales of step 0.5: deep enough for large motions",
        _opencv_tvl1,
        DualTVL1,
        "cv2",
        n_scales=6,
        scale_step=0.5,
    ),
    _peer("opencv_dis", "OpenCV DIS", "OpenCV's dense inverse search, preset medium", _opencv_dis, Dis, "cv2"),
    _peer(
        "opencv_farneback",
        "OpenCV Farneback",
        "OpenCV's Farneback flow, defaults",
        _opencv_farneback,
        Farneback,
        "cv2",
    ),
    _peer(
        "skimage_tvl1",
        "scikit-image TV-L1",
        "scikit-image's TV-L1, defaults",
        _skimage_tvl1,
        SkimageTVL1,
        "skimage",
    ),
    _peer(
        "skimage_tvl1_ipol",
        "scikit-image TV-L1 (IPOL)",
        "scikit-image's TV-L1, IPOL's weight and its prefilter",
        _skimage_tvl1,
        SkimageTVL1,
        "skimage",
        attachment=IPOL_ATTACHMENT,
        prefilter=True,
    ),
    _peer(
        "skimage_ilk",
        "scikit-image iLK",
        "scikit-image's iterative Lucas-Kanade, defaults",
        _skimage_ilk,
        Ilk,
        "skimage",
    ),
    _peer(
        "openpiv",
        "OpenPIV",
        "cross-correlation with window deformation, windows of 64, 32 and 16 pixels",
        _openpiv,
        OpenPIV,
        "openpiv",
    ),
)
