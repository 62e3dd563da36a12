"""The time that a plan will take, by the stored points of its kinds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from fracbench.data.datasets.registry import DATASETS
from fracbench.harness.run.point import MEASURES, Point
from fracbench.harness.run.store import Row

#: Used until the store holds a point of the method: seconds a pixel, one thread.
ROUGH_SECONDS_PER_PIXEL = 1e-5


def expected_seconds(points: Iterable[Point], rows: Iterable[Row], jobs: int) -> tuple[float, bool]:
    """Estimate the seconds to compute points by stored rows; tell whether these hold every method's speed."""
    speeds: dict[str, list[float]] = {}
    for row in rows:
        if row.status == "done" and row.seconds:
            speeds.setdefault(_kind(row.spec), []).append(row.seconds / pixels(row.spec))
    seconds, measured = [], True
    for point in points:
        known = speeds.get(_kind(point.spec))
        measured = measured and bool(known)
        seconds.append(pixels(point.spec) * (median(known) if known else ROUGH_SECONDS_PER_PIXEL))
    # No number of processes makes the longest point shorter.
    return max(sum(seconds) / jobs, max(seconds, default=0.0)), measured


def _kind(spec: Mapping[str, Any]) -> str:
    score = spec.get("score")
    return score if score in MEASURES else spec["method"]


def pixels(spec: Any) -> int:
    """Return the number of pixels that a point computes on, from its canonical form."""
    if spec["box"] is not None:
        row0, row1, col0, col1 = spec["box"]
        return int((row1 - row0 + 2 * spec["context"]) * (col1 - col0 + 2 * spec["context"]))
    height, width = DATASETS[spec["dataset"]].shapes[spec["sequence"]]
    return height * width
