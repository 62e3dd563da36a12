"""The artefact of alpha by class of structure: tables, sentences, a figure, and pictures of the orders chosen."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import ensure_folder, write_text
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import RUNS, Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.alpha_map.oracle import compute_oracle, load_maps, load_oracle, oracle_file
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
    """Compute the bounds and write everything; see `fracbench.studies.base.Renderer`."""
    for part in (SINGLE, BY_CLASS, ORACLE):
        if part not in experiment.grids:
            raise InputError(f"experiment {experiment.name}: the grid `{part}` is missing")
    _compute_missing(experiment, plan, rows, results)
    oracles = stored_oracles(experiment, plan, results)
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
    files += _order_pictures(experiment, plan, results, oracles)
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


def stored_oracles(experiment: Experiment, plan: Plan, results: Path) -> Oracles:
    """Return the bounds by sequence that have been computed; None for the others.

    Parameters
    ----------
    experiment, plan, results
        See `fracbench.studies.base.Renderer`.

    Returns
    -------
    mapping
        See `fracbench.studies.alpha_map.oracle.compute_oracle`.
    """
    folder, window = results / RUNS / "oracles", options(experiment).window
    return {name: load_oracle(points, window, folder) for name, points in _oracle_points(plan).items()}


def _oracle_points(plan: Plan) -> dict[str, list[Point]]:
    found: dict[str, list[Point]] = {}
    for planned in plan.points:
        if planned.labels["part"] == ORACLE:
            found.setdefault(planned.labels["sequence"], []).append(planned.point)
    return found


def _compute_missing(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> None:
    """Compute the bounds of the sequences whose points are all done; a kept one is not computed again."""
    from fracbench.harness.run.pool import parallel_map

    flows, folder = (ensure_folder(results / RUNS / name).resolve() for name in ("flows", "oracles"))
    window = options(experiment).window
    todo = [
        (points, plan.folder, flows, window, folder)
        for points in _oracle_points(plan).values()
        if all(point.key in rows and rows[point.key].status == "done" for point in points)
        and not oracle_file(points, window, folder).is_file()
    ]
    jobs = plan.config.parallel.jobs
    for _ in parallel_map(compute_oracle, todo, jobs, "the bounds that are finished are kept"):
        pass


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


def _order_pictures(experiment: Experiment, plan: Plan, results: Path, oracles: Oracles) -> list[Path]:
    """Paint the first sequences' classes and orders; they hold frames of Middlebury, so they are private."""
    from fracbench.figures.cache import draw
    from fracbench.figures.pictures import frame_panel
    from fracbench.studies.alpha_map.figures import order_pictures, order_title

    names = [name for name, found in oracles.items() if found is not None][: options(experiment).shown]
    items = [item for name in names for item in _maps(name, experiment, plan, results)]
    if not items:
        return []
    stem = file_stem(f"{experiment.name}_orders", plan, ensure_folder(results / PRIVATE))
    return draw(stem, frame_panel, order_pictures(items), columns=3, title=order_title(items[0][-1]))


def _maps(name: str, experiment: Experiment, plan: Plan, results: Path) -> list[tuple[Any, ...]]:
    """Return for a sequence its first frame under the classes, and under the orders by window and by pixel."""
    from fracbench.harness.run.compute_point import point_arrays

    points = _oracle_points(plan)[name]
    frame0, *_ = point_arrays(points[0], plan.folder)
    maps = load_maps(points, options(experiment).window, results / RUNS / "oracles")
    alphas = [point.params.alpha for point in points]
    return [(name, frame0, scope, maps[scope], alphas) for scope in ("classes", "window", "pixel")]
