"""The study of the flow in two parts: its tables, sentences and pictures of the parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.compute_point import point_arrays, point_options
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.methods.registry import get_method
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, TABLES, Artefact, file_stem
from fracbench.studies.infimal.tables import ESTIMATES, MIXED, PARTS, SCENES, frame_table, scene_table, sentences

if TYPE_CHECKING:
    import pandas as pd

_LEGEND = (
    "Scenes: the geometric mean over seeds of the error relative to alpha = 1, with Student's 95 % interval. "
    + "; ".join(f"`{key}`: {words}" for key, words in ESTIMATES.items())
    + f". Of the row {MIXED}, `own` and `oracle` are the best order for all scenes that mix. Orders and settings "
    "are chosen on the other half of the seeds. Sequences: AEPE in pixels and AAE in degrees over whole frames, "
    "the setting chosen on the other sequences; a setting in two parts is written (order of p, order of q) weight "
    "of q."
)


def order_from_flow(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the errors of the flow in two parts beside single orders; see `fracbench.studies.base.Renderer`."""
    runs = tidy(plan, rows)
    scenes, frames = scene_table(runs), frame_table(runs)
    lines = sentences(scenes, frames)
    stem = file_stem(experiment.name, plan, results / TABLES)
    shown = _readable(scenes) if len(scenes) else scenes
    text = [f"# {experiment.title}", _LEGEND, tables.to_markdown(shown)]
    if len(frames):
        text.append(tables.to_markdown(frames))
    text += ["\n".join(f"- {line}" for line in lines), *plan.notices]
    text += tables.footnote(rows, sorted(set(runs["protocol"])))
    files = [tables.write_table(scenes, stem), tables.write_markdown(stem, *text)]
    views = [(experiment.title, shown)]
    if len(frames):
        files.append(tables.write_table(frames, stem.with_name(f"{stem.name}_frames")))
        views.append(("Whole sequences", tables.rounded(frames)))
    files += _pictures(experiment, plan, results)
    return Artefact(files, views, lines)


def _pictures(experiment: Experiment, plan: Plan, results: Path) -> list[Path]:
    """Draw the parts of the last two scenes and of the first two sequences of the last protocol."""
    from fracbench.figures import style
    from fracbench.figures.cache import keep
    from fracbench.studies.infimal.figures import parts_panel

    of_part: dict[str, dict[str, Point]] = {}
    for planned in plan.points:
        if (part := planned.labels["part"]).endswith(PARTS):
            of_part.setdefault(part, {}).setdefault(planned.labels["sequence"], planned.point)
    scenes = [*of_part.pop(f"{SCENES}{PARTS}", {}).items()][-2:]
    sequences = [*[*of_part.values()][-1].items()][:2] if of_part else []
    chosen = dict([*sequences, *scenes])
    if not chosen:
        return []
    stem = file_stem(f"{experiment.name}_parts", plan, results / FIGURES)

    def write() -> None:
        items = [(name.removeprefix("synthetic_"), _parts(point, plan.folder)) for name, point in chosen.items()]
        style.save_figure(parts_panel(items, "Both parts of the flow"), stem)

    return keep(style.figure_files(stem), [point.key for point in chosen.values()], write)


def _parts(point: Point, data: Path | None) -> NDArray[np.float32]:
    """Compute both parts of the flow of a point, (2, 2, H, W)."""
    frame0, frame1, *_ = point_arrays(point, data)
    with threadpool_limits(1):
        result = get_method(point.method).compute(frame0, frame1, point.params, **point_options(point, data))
    return np.asarray(result.parts)


def _readable(scenes: pd.DataFrame) -> pd.DataFrame:
    """Return the scenes for reading: an estimate and its interval in one cell."""
    shown = scenes[["scene", "noise", "metric", "n"]].copy()
    shown["error at 1"] = tables.rounded(scenes[["at_1"]])
    for key in ESTIMATES:
        columns = zip(scenes[key], scenes[f"{key}_low"], scenes[f"{key}_high"], strict=True)
        shown[key] = [
            f"{mean:.2f} ({low:.2f} to {high:.2f})" if mean == mean else "" for mean, low, high in columns
        ]
    return shown
