"""The Python interface: `estimate_flow`, and its result."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from fracbench.data.gray import to_gray
from fracbench.errors import InputError, nearest, unknown_name
from fracbench.harness.config.compose import protocol_settings
from fracbench.methods.method import Method
from fracbench.methods.registry import DEFAULT_METHOD, get_method
from fracbench.model.coarse_to_fine import FlowResult, check_frames
from fracbench.model.confidence import check_backward
from fracbench.model.data_terms.masked import check_mask
from fracbench.model.kernels.threads import use_threads
from fracbench.model.params import FlowParams

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The preset of flows of one's own: the defaults of `FlowParams`.
DEFAULT_PROTOCOL = "recommended"


class EstimatedFlow(FlowResult):
    """The result of `estimate_flow`: a `FlowResult` that draws itself, in a notebook by itself."""

    def plot(self, ax: Axes | None = None, *, max_motion: float | None = None) -> Axes:
        """Show the flow in Middlebury's colours: hue is direction, saturation is speed.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; new axes of `matplotlib.pyplot` by default.
        max_motion : float, optional
            The speed in pixels that gets the full colour, by default the largest of this flow.

        Returns
        -------
        Axes
        """
        from fracbench.figures.show_flow import draw_flow

        return draw_flow(self.flow, ax, max_motion=max_motion)

    def _repr_html_(self) -> str:
        from fracbench.figures.show_flow import flow_html

        height, width = self.flow.shape[1:]
        iterations, seconds = sum(map(sum, self.iterations)), sum(self.seconds.values())
        count = f"{iterations} iterations, " if self.levels else ""
        lines = [f"{self.method}: {width} x {height} px, {count}{seconds:.2f} s; {self.ending}", *self.notices]
        return flow_html(self.flow, "; ".join(lines))


def estimate_flow(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    protocol: str = DEFAULT_PROTOCOL,
    method: str | None = None,
    mask: npt.ArrayLike | None = None,
    initial_flow: npt.ArrayLike | None = None,
    confidence: bool = False,
    trace: bool = False,
    threads: int = 1,
    **params: Any,
) -> EstimatedFlow:
    """Estimate the optical flow from `frame0` to `frame1`.

    Without further arguments this is fractional TV-L1 with the preset ``recommended``: alpha = 1.1, flow
    mirrored about the image's edges, exact u-step with a warm start.

    Parameters
    ----------
    frame0, frame1 : array_like, shape (H, W) or (H, W, 1 | 3 | 4)
        Frames, gray or colour, of any integer or floating type; never changed. Colour becomes gray by
        ``0.299 R + 0.587 G + 0.114 B`` (rounded down for integers), and counts as such only for
        ``weighted_guide="color"``; alpha channels are ignored. Pixels that are NaN do not count, as if they were
        in the mask; a notice says how many there are.
    protocol : str, optional
        The preset: ``fast`` (half-size frames), ``recommended``, ``accurate`` (smaller errors, slower), ``fluid``
        (smooth motion, particle images), or another file of ``conf/protocol``, of the package or of the working
        folder.
    method : str, optional
        Name in the registry (``fracbench methods`` lists them) or of the entry point of an installed package. By
        default it is the method of the preset. Methods with parameters of their own take none from a preset that
        names another method.
    mask : array_like of bool, shape (H, W) or (2, H, W), optional
        True at the pixels of both frames, or of `frame0` and `frame1`, whose values do not count. Their flow, and
        that of pixels that move to a masked one, is filled in by the regulariser.
    initial_flow : array_like, shape (2, H, W), optional
        A flow to start from, pixels, for example that of the frames before. It is downsampled to the coarsest
        scale, where the computation begins: the fewer scales (`n_scales`), the more of it counts.
    confidence : bool, optional
        Compute the flow from `frame1` to `frame0` as well, in as much time again, and compare: see `Confidence`.
    trace : bool, optional
        Record the energy E(u, v) after each iteration (slow).
    threads : int, optional
        Threads of the solver; the flow does not depend on their number, but for the rounding of products of
        matrices under ``boundary="zero"``. The peers have threads of their own.
    **params
        Parameters of the method, on top of those of the preset: those of `FlowParams`, e.g. ``alpha=1.2``,
        ``lambda_=0.5``, for the methods of this package.

    Returns
    -------
    EstimatedFlow
        The flow, shape (2, H, W), float32, pixels, with iterations, stop reasons and seconds; in words, `ending`.
        It shows itself in a notebook; `plot` draws it.

    Raises
    ------
    InputError
        Frames that differ in size, are too small or infinite; an unknown parameter, method or protocol; a value
        outside its range; fewer than one thread; a mask or an initial flow of another shape or type, or without
        data; either of them for a method that does not take it.

    Examples
    --------
    >>> import numpy as np
    >>> from fracbench import estimate_flow
    >>> frame = np.random.default_rng(0).uniform(0, 255, (48, 64))
    >>> result = estimate_flow(frame, frame, alpha=1.2)
    >>> result.flow.shape, float(abs(result.flow).max())
    ((2, 48, 64), 0.0)

    A block that does not count, and the check of the flow by the one back:

    >>> mask = np.zeros(frame.shape, bool)
    >>> mask[10:20, 30:40] = True
    >>> shifted = np.roll(frame, 1, axis=1)
    >>> shifted[mask] = np.nan
    >>> result = estimate_flow(frame, shifted, mask=mask, confidence=True)
    >>> result.notices
    ['frame1: 100 of 3072 pixels are NaN and do not count, the first at row 10, column 30']
    >>> bool(result.confidence.agrees[mask].all()), float(np.median(result.flow[0][mask]).round(1))
    (True, 1.0)
    """
    chosen, settings = settings_of(protocol, method, params)
    gray0, gray1 = to_gray(frame0, name="frame0", nan=True), to_gray(frame1, name="frame1", nan=True)
    check_frames(gray0, gray1)
    options, notices = dict[str, Any](), list[str]()
    if "color" in chosen.options:
        options.update(_color(frame0))
    if mask is not None:
        options["mask"] = _array(mask, "mask", "b", "bool, true where a pixel does not count")
    if initial_flow is not None:
        options["initial_flow"] = _array(initial_flow, "initial_flow", "fiu", "real numbers")
    gaps = np.isnan([gray0, gray1])
    if gaps.any():
        options["mask"] = gaps if mask is None else gaps | check_mask(options["mask"], gray0.shape)
        notices = [
            _nan_notice(name, gap) for name, gap in zip(("frame0", "frame1"), gaps, strict=True) if gap.any()
        ]
    if notices and "mask" not in chosen.options:
        raise InputError(f"method {chosen.name!r} takes no `mask`: {notices[0]}")
    with use_threads(threads), threadpool_limits(1):
        result = chosen.compute(gray0, gray1, settings, trace=trace, **options)
        if confidence:
            started = time.perf_counter()
            for name in ("initial_flow", "color"):
                options.pop(name, None)
            if "color" in chosen.options:
                options.update(_color(frame1))
            if options.get("mask", gray0).ndim == 3:
                options["mask"] = options["mask"][::-1]
            back = chosen.compute(gray1, gray0, settings, **options)
            result.confidence = check_backward(result.flow, back.flow)
            result.seconds["backward"] = time.perf_counter() - started
    result.notices += notices
    return EstimatedFlow(**vars(result))


def settings_of(protocol: str, method: str | None, params: Mapping[str, Any]) -> tuple[Method, Any]:
    """Return the method and all of its parameters for `estimate_flow`."""
    chosen = get_method(method or _named(protocol)[0]).require()
    for name in params:
        if nearest(name, ("protocol", *chosen.names)) == "protocol":
            raise unknown_name("argument", name, ("protocol", *chosen.names))
    settings = chosen.replace(chosen.start(), preset_of(protocol, chosen) or {})
    return chosen, chosen.replace(settings, params)


def preset_of(protocol: str, method: Method) -> dict[str, Any] | None:
    """Return the parameters that a preset sets for a method; None for a method that has other parameters."""
    named, preset = _named(protocol)
    return preset if method.name == named or method.params is FlowParams else None


def _named(protocol: str) -> tuple[str, dict[str, Any]]:
    """Return the method and the parameters of a preset; the default sets nothing, and Hydra need not be loaded."""
    return (DEFAULT_METHOD, {}) if protocol == DEFAULT_PROTOCOL else protocol_settings(protocol)


def _color(frame: npt.ArrayLike) -> dict[str, Any]:
    """Return a frame in colour as an option of a method, read-only; nothing if it is gray."""
    planes = np.asarray(frame)[..., :3]
    planes.flags.writeable = False
    return {"color": planes} if planes.ndim == 3 and planes.shape[2] == 3 else {}


def _nan_notice(name: str, gap: npt.NDArray[np.bool_]) -> str:
    row, column = np.argwhere(gap)[0]
    return (
        f"{name}: {int(gap.sum())} of {gap.size} pixels are NaN and do not count, "
        f"the first at row {row}, column {column}"
    )


def _array(values: npt.ArrayLike, name: str, kinds: str, what: str) -> npt.NDArray[Any]:
    """Return an argument as an array whose dtype is of one of `kinds`."""
    try:
        array = np.asarray(values)
    except ValueError:  # nested lists of unequal lengths
        array = np.empty(0, object)
    if array.dtype.kind not in kinds:
        raise InputError(f"`{name}` must be an array of {what}")
    return array
