"""The convergence study: which solver of one linearised problem is near the minimum first?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import ensure_folder, write_text
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.store import RUNS, Row
from fracbench.model.params import FlowParams
from fracbench.studies import tables
from fracbench.studies.base import Artefact, file_stem
from fracbench.studies.options import all_options
from fracbench.studies.solvers.linearised_problem import DEFAULT, LITERAL, SOLVERS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def convergence(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw the courses of the solvers; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures.style import save_figure

    options = all_options(experiment)
    courses, literal = stored_courses(plan, rows)
    if courses.empty:
        return Artefact(lines=["No point is done: there is nothing to draw."])
    summary = summarise(courses, options["gap"], literal)
    title = f"{experiment.title}\n{options['region']}, {plan.dataset}"
    stem = file_stem(experiment.name, plan, ensure_folder(results / RUNS / "convergence"))
    text = f"# {experiment.title}\n\n{_LEGEND.format(**options)}\n\n{tables.to_markdown(summary)}\n"
    files = [
        tables.write_table(courses, stem),
        tables.write_table(summary, stem.with_name(f"{stem.name}_summary")),
        write_text(text, stem.with_name(f"{stem.name}.md")),
        *save_figure(_figure(courses, options["gap"], title), stem),
    ]
    return Artefact(files, [(experiment.title, summary)], [_LEGEND.format(**options)])


_LEGEND = (
    "`iterations`, `u-steps` (one component each) and `seconds` until the relative gap of E(u, v) to its minimum "
    "is `gap`: {gap:g}, or the least that the solver reached within {seconds:g} s and {iterations} iterations; "
    "`ratio`: to the default's seconds to the same gap. Every solver starts from u = 0 on {region}. The printed "
    "double sums give the iterates of Gauss-Seidel; their seconds are its own and, for each sweep, the difference."
)


def convergence_points(experiment: Experiment, plan: Plan) -> list[PlannedPoint]:
    """Return a point for each order: every solver on the region's problem."""
    options = all_options(experiment)
    same_data = [f"dataset={plan.dataset}"]
    if plan.folder is not None:
        same_data.append(f"paths.data='{plan.folder}'")
    tokens = (f"region={options['region']}", "protocol=reference", *same_data)
    planned = make_plan(tokens, allow_download=False).points[0]
    names = ("lambda", "theta", "lambda_sb", "boundary")
    model = {name: planned.point.canonical[name] for name in names}
    limits = tuple((name, options[name]) for name in ("last_gap", "seconds", "iterations", "reference_iterations"))
    return [
        replace(
            planned,
            point=replace(
                planned.point,
                params=FlowParams().replace({**model, "alpha": alpha}),
                score="convergence",
                options=limits,
            ),
        )
        for alpha in options["alphas"]
    ]


def stored_courses(plan: Plan, rows: Mapping[str, Row]) -> tuple[pd.DataFrame, dict[float, float]]:
    """Return the courses, and by alpha the seconds that a sweep by double sums takes longer than a dense one.

    Columns of the courses: ``alpha, solver, iteration, u_steps, seconds, gap``.
    """
    import pandas as pd

    records, literal = [], {}
    for planned in plan.points:
        row, alpha = rows.get(planned.point.key), planned.point.params.alpha
        if planned.point.score == "convergence" and row is not None and row.status == "done":
            for name in SOLVERS:
                records += [(alpha, name, *record) for record in row.result["courses"][name]]
            dense, slow = row.result["sweep_seconds"]
            literal[alpha] = slow - dense
    columns = ["alpha", "solver", "iteration", "u_steps", "seconds", "gap"]
    return pd.DataFrame.from_records(records, columns=columns).astype({"gap": "float"}), literal


def summarise(courses: pd.DataFrame, gap: float, literal: Mapping[float, float]) -> pd.DataFrame:
    """Return when each solver was first within a relative gap, or within the least gap that it reached.

    Columns: ``alpha, solver, gap, iterations, u-steps, seconds, ratio``.
    """
    import pandas as pd

    records = []
    for alpha, of_alpha in courses.groupby("alpha", sort=False):
        own = of_alpha[of_alpha["solver"] == DEFAULT]
        for solver, part in of_alpha.groupby("solver", sort=False):
            level = max(gap, 1.01 * part["gap"].min())
            near = part[part["gap"] <= level].iloc[0]
            base = own.loc[own["gap"] <= level, "seconds"].min()
            counts = int(near["iteration"]), int(near["u_steps"])
            ratio = near["seconds"] / base if base else math.nan  # no time passes before the first iteration
            records.append([alpha, solver, level, *counts, near["seconds"], ratio])
            if solver in LITERAL:
                seconds = near["seconds"] + near["u_steps"] * literal[float(alpha)]
                records.append([alpha, LITERAL[solver], level, *counts, seconds, seconds / base])
    columns = ["alpha", "solver", "gap", "iterations", "u-steps", "seconds", "ratio"]
    return pd.DataFrame.from_records(records, columns=columns)


def _figure(courses: pd.DataFrame, gap: float, title: str) -> Figure:
    from fracbench.figures.style import PALETTE, house_style, new_figure

    alphas = list(courses["alpha"].unique())
    with house_style():
        figure = new_figure(2.4 * len(alphas) + 1.2)
        figure.suptitle(title)
        grid = figure.subplots(len(alphas), 2, squeeze=False, sharey=True)
        for row, alpha in zip(grid, alphas, strict=True):
            part = courses[(courses["alpha"] == alpha) & (courses["iteration"] > 0)]
            for i, (solver, line) in enumerate(part.groupby("solver", sort=False)):
                look: dict[str, Any] = {"color": PALETTE[i % len(PALETTE)], "label": solver}
                row[0].plot(line["iteration"], line["gap"].clip(lower=1e-7), **look)
                row[1].plot(line["seconds"], line["gap"].clip(lower=1e-7), **look)
            for ax, name in zip(row, ("iterations", "seconds"), strict=True):
                ax.set(xscale="log", yscale="log", xlabel=name)
                ax.axhline(gap, color="black", linewidth=0.8, linestyle=":")
            row[0].set_ylabel(f"alpha {alpha:g}: relative gap")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
