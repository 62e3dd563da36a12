"""From a plan's rows to files: one renderer for each kind of artefact that an experiment can name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import ensure_folder, write_text
from fracbench.errors import unknown_name
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.paths import asset
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import METRICS, tidy
from fracbench.studies import tables
from fracbench.studies.accurate import accurate_study
from fracbench.studies.alpha_map.artefact import adaptive_alpha
from fracbench.studies.base import Artefact, Renderer, best_values, file_stem
from fracbench.studies.options import require_options
from fracbench.studies.paper import figures as paper
from fracbench.studies.paper.alpha_regions import alpha_regions
from fracbench.studies.protocols import protocol_study
from fracbench.studies.solvers.convergence_study import convergence
from fracbench.studies.solvers.solver_study import solver_study
from fracbench.studies.structure.artefact import alpha_by_structure

if TYPE_CHECKING:
    import pandas as pd


def render(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw an experiment's rows as the artefact it names.

    Parameters
    ----------
    experiment : Experiment
        What is wanted.
    plan : Plan
        Its points.
    rows : mapping of str to Row
        Their rows, by key.
    results : Path
        The results folder.

    Returns
    -------
    Artefact
        Files, and what to show on the terminal.

    Raises
    ------
    InputError
        An unknown renderer, or a folder that cannot be written.
    """
    return require_renderer(experiment)(experiment, plan, rows, results)


def require_renderer(experiment: Experiment) -> Renderer:
    """Return the renderer that an experiment names.

    Raises
    ------
    InputError
        There is none of that name, or its options are not as it needs them.
    """
    if experiment.artefact not in RENDERERS:
        raise unknown_name("artefact", experiment.artefact, RENDERERS, f"experiment {experiment.name}")
    require_options(experiment)
    return RENDERERS[experiment.artefact]


def _table2(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    import pandas as pd

    published = pd.read_csv(asset("results/published/table2.csv"))
    comparison = tables.versus_published(tidy(plan, rows), published)
    stem = file_stem(experiment.name, plan, ensure_folder(results / "tables"))
    protocols = list(comparison["protocol"].unique())
    artefact = Artefact()
    parts, latex = [f"# {experiment.title}\n"], []
    for protocol in protocols:
        table, sentences = tables.wide(comparison, protocol), tables.summary(comparison, protocol)
        parts += [f"## Protocol `{protocol}`\n", tables.to_markdown(table) + "\n", "\n".join(sentences) + "\n"]
        latex.append(tables.to_latex(table, f"{experiment.title} (protocol {protocol})"))
        artefact.views.append((f"{experiment.title}, protocol {protocol}", tables.rounded(table)))
        artefact.lines += [f"{protocol}: {sentence}" for sentence in sentences]
    notes = [*plan.notices, *tables.footnote(rows, protocols)]
    parts.append("\n\n".join(notes) + "\n")
    latex += ["% " + line for line in notes]
    artefact.lines += notes
    # Written last, so that a table that cannot be laid out replaces none of them.
    artefact.files = [
        tables.write_table(comparison, stem),
        write_text("\n".join(parts), stem.with_name(stem.name + ".md")),
        write_text("\n".join(latex) + "\n", stem.with_name(stem.name + ".tex")),
    ]
    return artefact


def _sweep(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    table = tidy(plan, rows)
    stem = file_stem(experiment.name, plan, ensure_folder(results / "sweeps"))
    artefact = Artefact()
    names, numbers = split_varying(table, plan)
    done = table[table["status"] == "done"]
    if numbers and len(done):
        best = best_values(done, names, numbers)
        artefact.views.append((f"Best {', '.join(numbers)} (smaller errors are better)", best))
    else:
        shown = table[[*names, *numbers, *METRICS, "status"]]
        artefact.views.append((experiment.title, tables.rounded(shown)))
    figure = _sweep_figure(experiment.title, table, names, numbers)
    if figure is None:
        artefact.lines.append("no plot: it takes one or two swept numbers, e.g. alpha=0:2:0.1")
    else:
        from fracbench.figures.style import save_figure

        artefact.files += save_figure(figure, stem)
        if table[numbers].isna().any(axis=None):
            artefact.lines.append(f"not drawn: points that do not depend on {' and '.join(numbers)}")
    artefact.files.insert(0, tables.write_table(table, stem))
    return artefact


def split_varying(table: pd.DataFrame, plan: Plan) -> tuple[list[str], list[str]]:
    """Return the varying keys of a sweep that are names, and those that are numbers."""
    keys = [key.removeprefix("params.") for key in plan.varying]
    keys = ["sequence" if key == "region" and not table["region"].any() else key for key in keys]
    keys = [key for key in keys if key in table.columns]
    numeric = [key for key in keys if table[key].dtype.kind in "if"]
    return [key for key in keys if key not in numeric], numeric


def _sweep_figure(title: str, table: pd.DataFrame, names: list[str], numbers: list[str]) -> Any:
    from fracbench.figures.curves import alpha_curves, heat_map

    # A point has no place on an axis that its method does not depend on, and one place only on the others.
    table = table.dropna(subset=numbers).drop_duplicates([*names, *numbers, "key"])
    if not table["aepe"].notna().any():
        return None
    if len(numbers) == 1:
        hue = None
        if names:
            hue = " / ".join(names)
            table = table.assign(**{hue: table[names].astype(str).agg(", ".join, axis=1)})
        note = "where the operator is the identity" if numbers == ["alpha"] else ""
        return alpha_curves(
            table, x=numbers[0], hue=hue, title=title, logx=_is_logarithmic(table[numbers[0]]), zero_note=note
        )
    if len(numbers) == 2 and not names:
        return heat_map(table, x=numbers[0], y=numbers[1], title=title)
    return None


def _is_logarithmic(values: pd.Series) -> bool:
    grid = np.unique(values.to_numpy(np.float64))
    return bool(grid.size > 2 and grid[0] > 0 and np.ptp(np.diff(np.log(grid))) < 0.1 * np.ptp(np.diff(grid)))


RENDERERS: dict[str, Renderer] = {
    "accurate_study": accurate_study,
    "adaptive_alpha": adaptive_alpha,
    "alpha_by_structure": alpha_by_structure,
    "alpha_regions": alpha_regions,
    "convergence": convergence,
    "family": paper.family,
    "frames": paper.frames,
    "protocol_study": protocol_study,
    "region_boxes": paper.region_boxes,
    "solver_study": solver_study,
    "sweep": _sweep,
    "table1": paper.table1,
    "table2": _table2,
}
