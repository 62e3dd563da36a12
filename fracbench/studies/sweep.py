"""The sweep of a user: the tidy table, the best values, and a plot over one or two swept numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import RUNS, Row
from fracbench.harness.run.tidy import METRICS, tidy
from fracbench.studies import tables
from fracbench.studies.base import Artefact, best_values, file_stem

if TYPE_CHECKING:
    import pandas as pd

#: Pictures of flows in a sweep over pairs without true flow, at most.
MOST_FLOWS = 24


def sweep(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the tidy table of any grid, and a plot where it has one; see `fracbench.studies.base.Renderer`."""
    table = tidy(plan, rows)
    stem = file_stem(experiment.name, plan, results / "sweeps")
    artefact = Artefact()
    names, numbers = split_varying(table, plan)
    done = table.loc[table["status"] == "done", [*names, *numbers, *METRICS, "n_pixels"]]
    unknown = bool((done["n_pixels"] == 0).all())  # the true flow; also where nothing is done
    if numbers and not unknown:
        best = best_values(done, names, numbers)
        artefact.views.append((f"Best {', '.join(numbers)} (smaller errors are better)", best))
    else:
        more = [column for column in ("aepe_matched", "aepe_unmatched", "fl_all") if column in table.columns]
        shown = table[[*names, *numbers, *METRICS, *more, "status"]]
        artefact.views.append((experiment.title, tables.rounded(shown)))
    artefact.files += _flows(plan, table, [*names, *numbers], results, stem)
    figure = _sweep_figure(experiment.title, table, names, numbers)
    if unknown and len(done):
        artefact.lines.append("no errors: the true flow is not known")
    elif figure is None:
        artefact.lines.append("no plot: it takes one or two swept numbers, e.g. alpha=0:2:0.1")
    else:
        from fracbench.figures.style import save_figure

        artefact.files += save_figure(figure, stem)
        if table[numbers].isna().any(axis=None):
            artefact.lines.append(f"not drawn: points that do not depend on {' and '.join(numbers)}")
    artefact.files.insert(0, tables.write_table(table, stem))
    return artefact


def _flows(plan: Plan, table: pd.DataFrame, varying: list[str], results: Path, stem: Path) -> list[Path]:
    """Draw the flows of pairs whose true flow is not known; they are computed once more, and kept."""
    from fracbench.data.files import ensure_folder, read_flow
    from fracbench.figures.cache import draw
    from fracbench.figures.flowcolor import fastest, flow_to_color
    from fracbench.figures.pictures import frame_panel
    from fracbench.harness.run.compute_point import flow_file, keep_flow
    from fracbench.harness.run.pool import parallel_map

    unknown = table[(table["status"] == "done") & (table["n_pixels"] == 0)].drop_duplicates("key").head(MOST_FLOWS)
    if unknown.empty:
        return []
    folder, points = ensure_folder(results / RUNS / "flows").resolve(), plan.unique()
    wanted = {key: flow_file(points[key], folder) for key in unknown["key"]}
    todo = [(points[key], plan.folder, path) for key, path in wanted.items() if not path.is_file()]
    for _ in parallel_map(keep_flow, todo, plan.config.parallel.jobs, "the flows that are finished are kept"):
        pass
    titles = unknown[varying or ["sequence"]].astype(str).agg("\n".join, axis=1)
    flows = [read_flow(path) for path in wanted.values()]
    speed = max(map(fastest, flows)) or 1.0  # one scale for all
    items = [(title, flow_to_color(flow, speed)) for title, flow in zip(titles, flows, strict=True)]
    title = f"Flows in Middlebury's colours; the fullest stand for {speed:.3g} px"
    return draw(stem.with_name(f"{stem.name}__flows"), frame_panel, items, title=title)


def split_varying(table: pd.DataFrame, plan: Plan) -> tuple[list[str], list[str]]:
    """Return the varying keys of a sweep that are names, and those that are numbers."""
    keys = [key.removeprefix("params.") for key in plan.varying]
    keys = ["sequence" if key == "region" and not table["region"].any() else key for key in keys]
    keys = [key for key in keys if key in table.columns]
    numeric = [key for key in keys if table[key].dtype.kind in "if"]
    return [key for key in keys if key not in numeric], numeric


def _sweep_figure(title: str, table: pd.DataFrame, names: list[str], numbers: list[str]) -> Any:
    from fracbench.figures.curves import alpha_curves, heat_map

    if len(numbers) not in (1, 2) or (len(numbers) == 2 and names):
        return None
    # A point has no place on an axis that its method does not depend on, and one place only on the others.
    table = table.dropna(subset=numbers).drop_duplicates([*names, *numbers, "key"])
    if not table["aepe"].notna().any():
        return None
    if len(numbers) == 1:
        hue = " / ".join(names) or None
        if hue:
            table = table.assign(**{hue: table[names].astype(str).agg(", ".join, axis=1)})
        note = "where the operator is the identity" if numbers == ["alpha"] else ""
        logx = _is_logarithmic(table[numbers[0]])
        return alpha_curves(table, x=numbers[0], hue=hue, title=title, logx=logx, zero_note=note)
    return heat_map(table, x=numbers[0], y=numbers[1], title=title)


def _is_logarithmic(values: pd.Series) -> bool:
    grid = np.unique(values.to_numpy(np.float64))
    return bool(grid.size > 2 and grid[0] > 0 and np.ptp(np.diff(np.log(grid))) < 0.1 * np.ptp(np.diff(grid)))
