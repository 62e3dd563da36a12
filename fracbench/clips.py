"""The Python interface for clips: `estimate_flows`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy.typing as npt

from fracbench.api import EstimatedFlow, estimate_flow
from fracbench.errors import InputError


def estimate_flows(frames: Iterable[npt.ArrayLike], **settings: Any) -> Iterator[EstimatedFlow]:
    """Estimate the flow from each frame of a clip to the next one.

    Two frames are in memory at a time, and a flow is computed when it is asked for. Each is the flow that
    `estimate_flow` gives for its two frames: a start from the flow before is no gain (docs/clips.md).

    Parameters
    ----------
    frames : iterable of array_like
        Two or more frames of one size, as `estimate_flow` takes them: a list, a generator, the reader of a video.
    **settings
        Those of `estimate_flow`, for all flows.

    Yields
    ------
    EstimatedFlow
        The flow from frame i to frame i + 1, one fewer than there are frames.

    Raises
    ------
    InputError
        Fewer than two frames; a setting or a frame that `estimate_flow` refuses, with the frames' numbers, from 0.

    Examples
    --------
    >>> import numpy as np
    >>> from fracbench import estimate_flows
    >>> clip = np.random.default_rng(0).uniform(0, 255, (3, 48, 64))
    >>> [result.flow.shape for result in estimate_flows(clip, alpha=1.2)]
    [(2, 48, 64), (2, 48, 64)]
    """
    before, number = None, -1
    for number, frame in enumerate(frames):
        if before is not None:
            try:
                result = estimate_flow(before, frame, **settings)
            except InputError as exc:
                raise InputError(f"{exc} (frames {number - 1} and {number} of the clip)") from exc
            yield result
        before = frame
    if number < 1:
        raise InputError(f"a clip has two or more frames, got {number + 1}")
