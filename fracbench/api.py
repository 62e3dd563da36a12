"""The Python interface: `estimate_flow`."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
from threadpoolctl import threadpool_limits

from fracbench.data.gray import to_gray
from fracbench.methods.registry import DEFAULT_METHOD, get_method
from fracbench.model.coarse_to_fine import FlowResult, check_frames
from fracbench.model.kernels.threads import use_threads
from fracbench.model.params import FlowParams


def estimate_flow(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    method: str = DEFAULT_METHOD,
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
    with use_threads(threads), threadpool_limits(1):
        return chosen.estimate(gray0, gray1, settings, trace=trace)
