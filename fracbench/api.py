"""The Python interface: `estimate_flow`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from fracbench.data.gray import to_gray
from fracbench.errors import InputError
from fracbench.methods.registry import DEFAULT_METHOD, Method, get_method
from fracbench.model.coarse_to_fine import FlowResult, check_frames
from fracbench.model.kernels.threads import use_threads
from fracbench.model.params import FlowParams


def estimate_flow(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    method: str = DEFAULT_METHOD,
    initial_flow: npt.ArrayLike | None = None,
    trace: bool = False,
    threads: int = 1,
    **params: Any,
) -> FlowResult:
    """Estimate the optical flow from `frame0` to `frame1`.

    Without further arguments this is fractional TV-L1 with the preset `recommended`: alpha = 1.1, flow
    mirrored about the image's edges, exact u-step with a warm start.

    Parameters
    ----------
    frame0, frame1 : array_like, shape (H, W) or (H, W, 1 | 3 | 4)
        Frames, gray or colour, of any integer or floating type; never changed. Colour becomes gray by
        ``0.299 R + 0.587 G + 0.114 B`` (rounded down for integers); alpha channels are ignored.
    method : str, optional
        Name in the registry; ``fracbench methods`` lists them.
    initial_flow : array_like, shape (2, H, W), optional
        A flow to start from, pixels, for example that of the frames before. It is downsampled to the coarsest
        scale, where the computation begins: the fewer scales (`n_scales`), the more of it counts.
    trace : bool, optional
        Record the energy E(u, v) after each iteration (slow).
    threads : int, optional
        Threads of the solver; the flow does not depend on their number, but for the rounding of products of
        matrices under ``boundary="zero"``. The peers have threads of their own.
    **params
        Parameters of `FlowParams`, e.g. ``alpha=1.2``, ``lambda_=0.5``.

    Returns
    -------
    FlowResult
        The flow, shape (2, H, W), float32, pixels, with iterations, stop reasons and seconds.

    Raises
    ------
    InputError
        Frames that differ in size, are too small or not finite; an unknown parameter or method; a value
        outside its range; fewer than one thread.

    Examples
    --------
    >>> import numpy as np
    >>> from fracbench import estimate_flow
    >>> frame = np.random.default_rng(0).uniform(0, 255, (48, 64))
    >>> result = estimate_flow(frame, frame, alpha=1.2)
    >>> result.flow.shape, float(abs(result.flow).max())
    ((2, 48, 64), 0.0)
    """
    chosen = get_method(method).require()
    settings = FlowParams().replace(chosen.defaults).replace(params)
    gray0, gray1 = to_gray(frame0, name="frame0"), to_gray(frame1, name="frame1")
    check_frames(gray0, gray1)
    options = _options(chosen, initial_flow)
    with use_threads(threads), threadpool_limits(1):
        return chosen.estimate(gray0, gray1, settings, trace=trace, **options)


def _options(method: Method, initial_flow: npt.ArrayLike | None) -> dict[str, Any]:
    """Return the options that were given as arrays; refuse those that the method does not take."""
    options: dict[str, Any] = {}
    if initial_flow is not None:
        options["initial_flow"] = _numbers(initial_flow, "initial_flow")
    for name in options:
        if name not in method.options:
            raise InputError(f"method {method.name!r} takes no `{name}`")
    return options


def _numbers(values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError:  # nested lists of unequal lengths
        array = np.empty(0, object)
    if array.dtype.kind not in "fiu":
        raise InputError(f"`{name}` must be an array of real numbers")
    return array
