"""The time that a plan will take, by the stored points of its kinds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from fracbench.data.datasets.registry import match_sequence, shape_of
from fracbench.harness.run.point import MEASURES, Point
from fracbench.harness.run.store import Row

#: Used until the store holds a point of the method: seconds a pixel, one thread.
ROUGH_SECONDS_PER_PIXEL = 1e-5


def expected_seconds(points: Iterable[Point], rows: Iterable[Row], jobs: int) -> tuple[float, bool]:
    """Estimate the seconds to compute points by stored rows; tell whether these hold every method's speed."""
    speeds: dict[str, list[float]] = {}
    for row in rows:
        if row.status == "done" and row.seconds:
            speeds.setdefault(_kind(row.spec), []).append(row.seconds / _pixels_of_row(row))
    seconds, measured = [], True
    for point in points:
        known = speeds.get(_kind(point.spec))
        measured = measured and bool(known)
        seconds.append(pixels(point) * (median(known) if known else ROUGH_SECONDS_PER_PIXEL))
    # No number of processes makes the longest point shorter.
    return max(sum(seconds) / jobs, max(seconds, default=0.0)), measured


def _kind(spec: Mapping[str, Any]) -> str:
    score = spec.get("score")
    return score if score in MEASURES else spec["method"]


def pixels(point: Point) -> int:
    """Return the number of pixels that a point computes on."""
    return _pixels(point.spec, point.shape)


def _pixels_of_row(row: Row) -> int:
    if row.spec["box"] is None and "n_pixels" in row.result:  # its dataset may be gone
        return int(row.result["n_pixels"] + row.result["n_unknown"])
    return _pixels(row.spec, None)


def _pixels(spec: Any, shape: tuple[int, int] | None) -> int:
    if spec["box"] is not None:
        row0, row1, col0, col1 = spec["box"]
        return int((row1 - row0 + 2 * spec["context"]) * (col1 - col0 + 2 * spec["context"]))
    height, width = shape or shape_of(match_sequence(spec["sequence"], spec["dataset"]), spec["dataset"])
    return height * width
