"""The time that a plan will take, by the stored points of its kinds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from statistics import median
from typing import Any

from fracbench.data.datasets.registry import match_sequence, shape_of
from fracbench.errors import InputError
from fracbench.harness.run.point import MEASURES, Point
from fracbench.harness.run.store import Row

#: Used until the store holds a point of the method: seconds a pixel, one thread.
ROUGH_SECONDS_PER_PIXEL = 1e-5
#: The weight of what was known of a pace after one more point.
_MEMORY = 0.8


def expected_seconds(points: Iterable[tuple[Point, int]], rows: Iterable[Row], jobs: int) -> tuple[float, bool]:
    """Estimate the seconds to compute points by stored rows; tell whether these hold every method's speed.

    Each point comes with the number of those that cost the same.
    """
    speeds: dict[str, list[float]] = {}
    for row in rows:
        if row.status == "done" and row.seconds:
            # Its dataset may be gone, and a row of others may lack what the estimate needs.
            with suppress(InputError, KeyError, TypeError, ValueError, ArithmeticError):
                speed = row.seconds / _pixels_of_row(row)
                speeds.setdefault(_kind(row.spec), []).append(speed)
    medians = {kind: median(known) for kind, known in speeds.items()}
    total, longest, measured = 0.0, 0.0, True
    for point, count in points:
        known = medians.get(_kind_of(point))
        measured = measured and known is not None
        seconds = pixels(point) * (ROUGH_SECONDS_PER_PIXEL if known is None else known)
        total, longest = total + count * seconds, max(longest, seconds)
    # No number of processes makes the longest point shorter.
    return max(total / jobs, longest), measured


def _kind(spec: Mapping[str, Any]) -> str:
    score = spec.get("score")
    return score if score in MEASURES else spec["method"]


class Pace:
    """The seconds that points take, learnt from those that have ended."""

    def __init__(self) -> None:
        self._speeds: dict[str, float] = {}  # seconds a pixel

    def seconds(self, point: Point) -> float | None:
        """Return the seconds that a point will take; None where no point of its kind has ended."""
        speed = self._speeds.get(_kind_of(point))
        return None if speed is None else speed * pixels(point)

    def learn(self, points: Sequence[Point], seconds: float) -> None:
        """Take in that points of one kind, which ended one after another, took so many seconds together."""
        kind = _kind_of(points[0])
        speed = seconds / sum(map(pixels, points))
        self._speeds[kind] = speed + _MEMORY ** len(points) * (self._speeds.get(kind, speed) - speed)


def _kind_of(point: Point) -> str:
    return point.score if point.score in MEASURES else point.method


def pixels(point: Point) -> int:
    """Return the number of pixels that a point computes on."""
    if point.region is not None:
        height, width = (end - begin for begin, end in (point.region.rows, point.region.cols))
        return (height + 2 * point.context) * (width + 2 * point.context)
    height, width = point.shape or shape_of(match_sequence(point.sequence, point.dataset), point.dataset)
    return height * width


def _pixels_of_row(row: Row) -> int:
    if row.spec["box"] is None and "n_pixels" in row.result:  # its dataset may be gone
        return int(row.result["n_pixels"] + row.result["n_unknown"])
    spec = row.spec
    if spec["box"] is not None:
        row0, row1, col0, col1 = spec["box"]
        return int((row1 - row0 + 2 * spec["context"]) * (col1 - col0 + 2 * spec["context"]))
    height, width = shape_of(match_sequence(spec["sequence"], spec["dataset"]), spec["dataset"])
    return height * width
