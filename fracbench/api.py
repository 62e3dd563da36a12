"""The Python interface: `estimate_flow`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt
from threadpoolctl import threadpool_limits

from fracbench.data.gray import to_gray
from fracbench.harness.config.compose import protocol_settings
from fracbench.methods.method import Method
from fracbench.methods.registry import DEFAULT_METHOD, get_method
from fracbench.model.coarse_to_fine import FlowResult, check_frames
from fracbench.model.kernels.threads import use_threads
from fracbench.model.params import FlowParams

#: The preset of flows of one's own: the defaults of `FlowParams`.
DEFAULT_PROTOCOL = "recommended"


def estimate_flow(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    protocol: str = DEFAULT_PROTOCOL,
    method: str | None = None,
    trace: bool = False,
    threads: int = 1,
    **params: Any,
) -> FlowResult:
    """Estimate the optical flow from `frame0` to `frame1`.

    Without further arguments this is fractional TV-L1 with the preset ``recommended``: alpha = 1.1, flow
    mirrored about the image's edges, exact u-step with a warm start.

    Parameters
    ----------
    frame0, frame1 : array_like, shape (H, W) or (H, W, 1 | 3 | 4)
        Frames, gray or colour, of any integer or floating type; never changed. Colour becomes gray by
        ``0.299 R + 0.587 G + 0.114 B`` (rounded down for integers); alpha channels are ignored.
    protocol : str, optional
        The preset: ``recommended``, ``accurate`` (smaller errors, slower), or another file of ``conf/protocol``,
        of the package or of the working folder.
    method : str, optional
        Name in the registry (``fracbench methods`` lists them) or of the entry point of an installed package. By
        default it is the method of the preset. Methods with parameters of their own take none from a preset that
        names another method.
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
    FlowResult
        The flow, shape (2, H, W), float32, pixels, with iterations, stop reasons and seconds.

    Raises
    ------
    InputError
        Frames that differ in size, are too small or not finite; an unknown parameter, method or protocol; a
        value outside its range; fewer than one thread.

    Examples
    --------
    >>> import numpy as np
    >>> from fracbench import estimate_flow
    >>> frame = np.random.default_rng(0).uniform(0, 255, (48, 64))
    >>> result = estimate_flow(frame, frame, alpha=1.2)
    >>> result.flow.shape, float(abs(result.flow).max())
    ((2, 48, 64), 0.0)
    """
    chosen, settings = settings_of(protocol, method, params)
    gray0, gray1 = to_gray(frame0, name="frame0"), to_gray(frame1, name="frame1")
    check_frames(gray0, gray1)
    with use_threads(threads), threadpool_limits(1):
        return chosen.compute(gray0, gray1, settings, trace=trace)


def settings_of(protocol: str, method: str | None, params: Mapping[str, Any]) -> tuple[Method, Any]:
    """Return the method and all of its parameters for `estimate_flow`."""
    named, preset = DEFAULT_METHOD, dict[str, Any]()
    if protocol != DEFAULT_PROTOCOL:  # it sets nothing, so that Hydra need not be loaded
        named, preset = protocol_settings(protocol)
    chosen = get_method(method or named).require()
    settings = chosen.start()
    if chosen.name == named or chosen.params is FlowParams:
        settings = chosen.replace(settings, preset)
    return chosen, chosen.replace(settings, params)
