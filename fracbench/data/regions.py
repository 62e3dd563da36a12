"""Boxes of a sequence: cut out with or without context, and shifted."""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fracbench.data.pair import FramePair
from fracbench.errors import InputError

Box = tuple[slice, slice]
Crop = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32] | None, tuple[slice, slice]]


@dataclass(frozen=True)
class Region:
    """A box of a sequence; rows and columns are half-open, ``(first, one past the last)``.

    Attributes
    ----------
    name, sequence : str
        E.g. ``"grove2_A"``, and the sequence it belongs to.
    rows, cols : (int, int)
        Of at least 2 pixels each.
    """

    name: str
    sequence: str
    rows: tuple[int, int]
    cols: tuple[int, int]

    def __post_init__(self) -> None:
        for field in ("rows", "cols"):
            bounds = getattr(self, field)
            try:
                first, stop = (operator.index(n) for n in bounds)
            except (TypeError, ValueError) as exc:
                raise InputError(f"region {self.name!r}: `{field}` must be two integers, got {bounds!r}") from exc
            if not 0 <= first <= stop - 2:
                raise InputError(
                    f"region {self.name!r}: `{field}` {first}:{stop} must start at 0 or later "
                    "and hold at least 2 pixels"
                )
            object.__setattr__(self, field, (first, stop))

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.rows[1] - self.rows[0], self.cols[1] - self.cols[0]

    @property
    def inside(self) -> tuple[slice, slice]:
        """The region as an index of a picture."""
        return slice(*self.rows), slice(*self.cols)


def crop(sequence: FramePair, region: Region, context: int = 0) -> Crop:
    """Cut a region out of its sequence, with `context` more pixels on each side, as far as the picture goes.

    Returns
    -------
    frame0, frame1 : ndarray of float64, (h, w)
        The grown box, C-contiguous.
    truth : ndarray of float32, (2, h, w), or None
        The true flow there.
    inner : (slice, slice)
        The rows and columns of the region itself within these arrays.
    """
    if region.sequence.casefold() != sequence.name.casefold():
        raise InputError(f"region {region.name!r} belongs to {region.sequence!r}, not to {sequence.name!r}")
    grown, inner = boxes(region, sequence.shape, context)
    frame0, frame1 = (np.ascontiguousarray(frame[grown]) for frame in (sequence.frame0, sequence.frame1))
    truth = None if sequence.truth is None else np.ascontiguousarray(sequence.truth[:, *grown])
    return frame0, frame1, truth, inner


def boxes(region: Region, shape: tuple[int, int], context: int = 0) -> tuple[Box, Box]:
    """Return a region grown by its context, as an index of a picture of `shape`, and the region within that."""
    if context < 0:
        raise InputError(f"`context` must not be negative, got {context}")
    require_inside(region, shape)
    rows, cols = (
        _grow(bounds, context, size) for bounds, size in zip((region.rows, region.cols), shape, strict=True)
    )
    return (rows[0], cols[0]), (rows[1], cols[1])


def shifted(region: Region, shape: tuple[int, int], step: int = 8, n: int = 5) -> list[Region]:
    """Return the region and its neighbours on a lattice, to see how much a result owes to the box.

    The ``n * n`` boxes, `step` pixels apart, come row by row, named after their nominal shift; `n` is odd, so that
    the region itself is one of them. A box that would leave the picture of (height, width) `shape` is moved back
    inside; near a border, boxes can therefore coincide.
    """
    if step < 1 or n < 1 or n % 2 == 0:
        raise InputError(f"`step` must be positive and `n` odd and positive, got {step} and {n}")
    require_inside(region, shape)
    offsets = [step * k for k in range(-(n // 2), n // 2 + 1)]
    return [
        replace(
            region,
            name=f"{region.name}{down:+d}{right:+d}" if down or right else region.name,
            rows=_move(region.rows, down, shape[0]),
            cols=_move(region.cols, right, shape[1]),
        )
        for down in offsets
        for right in offsets
    ]


def require_inside(region: Region, shape: tuple[int, int]) -> None:
    """Refuse a region that leaves a picture of (height, width) `shape`."""
    if region.rows[1] > shape[0] or region.cols[1] > shape[1]:
        raise InputError(
            f"region {region.name!r}: rows {region.rows[0]}:{region.rows[1]}, columns "
            f"{region.cols[0]}:{region.cols[1]} leave the picture of {shape[0]} x {shape[1]} (rows x columns)"
        )


def _grow(bounds: tuple[int, int], context: int, size: int) -> tuple[slice, slice]:
    """Return the grown interval, and where the original one is within it."""
    first, stop = max(bounds[0] - context, 0), min(bounds[1] + context, size)
    return slice(first, stop), slice(bounds[0] - first, bounds[1] - first)


def _move(bounds: tuple[int, int], by: int, size: int) -> tuple[int, int]:
    length = bounds[1] - bounds[0]
    first = min(max(bounds[0] + by, 0), size - length)
    return first, first + length
