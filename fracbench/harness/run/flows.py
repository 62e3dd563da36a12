"""Flows of points as files. The store keeps numbers; pictures need the flows themselves."""

from __future__ import annotations

from pathlib import Path

from threadpoolctl import threadpool_limits

from fracbench.data.files import write_flow
from fracbench.harness.run.compute_point import point_arrays, point_options
from fracbench.harness.run.point import Point
from fracbench.methods.registry import get_method


def flow_file(point: Point, folder: Path) -> Path:
    """Return where a point's flow is kept: the name changes with everything that the flow depends on."""
    return folder / f"{point.key}.flo"


def keep_flow(point: Point, data: Path | None, path: Path) -> None:
    """Compute the flow of a point and write it, unless the file is there: it is there whole or not at all."""
    if path.is_file():
        return
    frame0, frame1, _, inner = point_arrays(point, data)
    with threadpool_limits(1):  # as for every stored number
        result = get_method(point.method).compute(frame0, frame1, point.params, **point_options(point, data))
    write_flow(path, result.flow[(slice(None), *inner)])
