"""The artefact of alpha by class of structure: tables, sentences, a figure, and pictures of the orders chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import ensure_folder, write_text
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.alpha_map.tables import (
    BY_CLASS,
    ESTIMATES,
    MEAN,
    ORACLE,
    SINGLE,
    Oracles,
    adaptive_sentences,
    adaptive_table,
    class_orders,
    confusion_table,
)
from fracbench.studies.base import FIGURES, PRIVATE, Artefact, file_stem
from fracbench.studies.options import AdaptiveAlpha

if TYPE_CHECKING:
    import pandas as pd

LEGEND = (
    "`left out`: the alpha, or the alphas of {classes}, with the least mean AEPE on the other sequences "
    "(leave-one-out). `all in`: on all sequences. `by the truth`: oracle bounds, "
    "not methods; the true flow of the sequence itself chooses among {orders}, for each class, for the "
    "neighbourhood of {window} x {window} pixels about each pixel, or for the pixel: the map of orders is run, or "
    "the flows of single orders are put together. `gain`: AEPE against one alpha left out, per cent."
)
CONFUSION = (
    "For how many of the pixels of each class, per cent over all sequences, each order is the best one about them "
    "(window) or at them (pixel)."
)
SPREAD = "The single order with the least error over the pixels of each class."


def adaptive_alpha(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the tables, the figure and the pictures; see `fracbench.studies.base.Renderer`."""
    for part in (SINGLE, BY_CLASS, ORACLE):
        if part not in experiment.grids:
            raise InputError(f"experiment {experiment.name}: the grid `{part}` is missing")
    oracles = stored_oracles(plan, rows)
    table = adaptive_table(tidy(plan, rows), oracles)
    lines, confusion, spread = adaptive_sentences(table, oracles), confusion_table(oracles), class_orders(oracles)
    stem = file_stem(experiment.name, plan, ensure_folder(results / "tables"))
    notes = [*plan.notices, *tables.footnote(rows, ["recommended"])]
    text = [f"# {experiment.title}\n", legend(experiment, oracles) + "\n", "\n\n".join(lines) + "\n"]
    for metric, name in (("aepe", "AEPE [px]"), ("aae", "AAE [rad]")):
        text += [f"## {name}\n", tables.to_markdown(wide(table, metric)) + "\n"]
    text += ["## Gain in AEPE, per cent\n", tables.to_markdown(_shares(wide(table, "gain"))) + "\n"]
    text += ["## What was chosen\n", tables.to_markdown(wide(table, "orders")) + "\n"]
    text += ["## Which order is best where\n", CONFUSION + "\n", tables.to_markdown(_shares(confusion)) + "\n"]
    text += [SPREAD + "\n", tables.to_markdown(_shares(spread)) + "\n", "\n\n".join(notes)]
    latex = tables.to_latex(wide(table, "aepe"), experiment.title)
    files = [
        tables.write_table(table, stem),
        tables.write_table(confusion, stem.with_name(f"{stem.name}_confusion")),
        write_text("\n".join(text) + "\n", stem.with_name(f"{stem.name}.md")),
        write_text(latex, stem.with_name(f"{stem.name}.tex")),
    ]
    files += _figure(experiment, plan, results, table, confusion)
    files += _order_pictures(experiment, plan, rows, results)
    return Artefact(files, [(experiment.title, tables.rounded(wide(table, "aepe")))], lines)


def legend(experiment: Experiment, oracles: Oracles) -> str:
    """Return the legend of the estimates' names."""
    from fracbench.model.structure import CLASSES

    found = next((found for found in oracles.values() if found is not None), None)
    orders = ", ".join(f"{alpha:g}" for alpha in found["alphas"]) if found else "single orders"
    return LEGEND.format(classes=", ".join(CLASSES), orders=orders, window=options(experiment).window)


def options(experiment: Experiment) -> AdaptiveAlpha:
    """Return the options, checked."""
    from fracbench.studies.options import require_options

    require_options(experiment)
    return AdaptiveAlpha(**experiment.options)


def oracle_points(experiment: Experiment, plan: Plan) -> list[PlannedPoint]:
    """Return a point a sequence: its bounds, from the single orders of the part `ORACLE`."""
    by_sequence: dict[str, list[PlannedPoint]] = {}
    for planned in plan.points:
        if planned.labels["part"] == ORACLE:
            by_sequence.setdefault(planned.labels["sequence"], []).append(planned)
    window = options(experiment).window
    return [
        replace(
            singles[0],
            point=replace(
                singles[0].point,
                score="oracle",
                options=(("alphas", tuple(each.point.params.alpha for each in singles)), ("window", window)),
            ),
        )
        for singles in by_sequence.values()
    ]


def stored_oracles(plan: Plan, rows: Mapping[str, Row]) -> Oracles:
    """Return the bounds by sequence (see `oracle.bounds`); None unless they and their single orders are done."""
    unfinished = {
        planned.labels["sequence"]
        for planned in plan.points
        if planned.labels["part"] == ORACLE
        and ((row := rows.get(planned.point.key)) is None or row.status != "done")
    }
    bounds = {planned.labels["sequence"]: planned.point.key for planned in _bounds(plan)}
    return {name: None if name in unfinished else rows[key].result for name, key in bounds.items()}


def _bounds(plan: Plan) -> list[PlannedPoint]:
    return [planned for planned in plan.points if planned.point.score == "oracle"]


def wide(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return one column of `adaptive_table` with a row a sequence and a column an estimate.

    Orders are left out where there are none to tell.
    """
    names = list(dict.fromkeys(table["sequence"]))
    shown = table.pivot(index="sequence", columns="estimate", values=column)
    wanted = [name for name in ESTIMATES if column != "orders" or not name.startswith(("one", "run", "least"))]
    return shown.loc[names, wanted].rename(columns=ESTIMATES).reset_index().rename_axis(columns=None)


def _shares(table: pd.DataFrame) -> pd.DataFrame:
    """Return numbers as text with one digit."""
    shown = table.copy()
    for column in shown.columns:
        if shown[column].dtype.kind == "f":
            shown[column] = ["" if value != value else f"{value:.1f}" for value in shown[column]]
    return shown


def _figure(
    experiment: Experiment, plan: Plan, results: Path, table: pd.DataFrame, confusion: pd.DataFrame
) -> list[Path]:
    """Draw the gains, if there are any to draw."""
    from fracbench.figures.cache import draw
    from fracbench.studies.alpha_map.figures import gain_panels

    if table.loc[table["sequence"] == MEAN, "gain"].isna().all():
        return []
    stem = file_stem(experiment.name, plan, ensure_folder(results / FIGURES))
    return draw(stem, gain_panels, table, confusion, experiment.title)


def _order_pictures(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> list[Path]:
    """Paint the first sequences' classes and orders; they hold frames of Middlebury, so they are private."""
    from fracbench.figures.cache import draw
    from fracbench.figures.pictures import frame_panel
    from fracbench.studies.alpha_map.figures import order_pictures, order_title

    oracles = stored_oracles(plan, rows)
    bounds = [planned for planned in _bounds(plan) if oracles[planned.labels["sequence"]] is not None]
    items = [
        item
        for planned in bounds[: options(experiment).shown]
        for item in _maps(planned, rows[planned.point.key].result, plan.folder)
    ]
    if not items:
        return []
    stem = file_stem(f"{experiment.name}_orders", plan, ensure_folder(results / PRIVATE))
    return draw(stem, frame_panel, order_pictures(items), columns=3, title=order_title(items[0][-1]))


def _maps(planned: PlannedPoint, bounds: Mapping[str, Any], data: Path | None) -> list[tuple[Any, ...]]:
    """Return for a sequence its first frame under the classes, and under the orders by window and by pixel."""
    from fracbench.harness.run.compute_point import point_arrays
    from fracbench.model.structure import structure_classes
    from fracbench.studies.alpha_map.oracle import unpack

    frame0, *_ = point_arrays(planned.point, data)
    maps = {"classes": structure_classes(frame0)}
    maps |= {scope: unpack(bounds["maps"][scope], frame0.shape) for scope in ("window", "pixel")}
    name = planned.labels["sequence"]
    return [(name, frame0, scope, orders, bounds["alphas"]) for scope, orders in maps.items()]
