"""The convergence study: which solver of one linearised problem is near the minimum first?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import ensure_folder, write_text
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.store import RUNS, Row
from fracbench.studies import tables
from fracbench.studies.base import Artefact, file_stem
from fracbench.studies.options import all_options

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from fracbench.studies.solvers.linearised_problem import Problem


def convergence(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Run the solvers and draw their courses; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures.style import save_figure

    options = all_options(experiment)
    courses, literal = measure(options, plan)
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


def problems(region: str, alphas: list[float], plan: Plan) -> dict[float, Problem]:
    """Return the region's problem for each order, linearised at the flow of the recommended method."""
    from fracbench.harness.run.compute_point import point_arrays
    from fracbench.methods.registry import get_method
    from fracbench.model.params import FlowParams
    from fracbench.model.pyramid import stretch
    from fracbench.studies.solvers.linearised_problem import linearised_problem

    same_data = [f"dataset={plan.dataset}"]
    if plan.folder is not None:
        same_data.append(f"paths.data='{plan.folder}'")
    point = make_plan((f"region={region}", "protocol=reference", *same_data)).points[0].point
    frame0, frame1, _, _ = point_arrays(point, plan.folder)
    own = get_method(point.method).estimate(frame0, frame1, FlowParams()).flow
    frame0, frame1 = stretch(frame0, frame1, np.dtype(np.float64))
    model = {name: point.canonical[name] for name in ("lambda", "theta", "lambda_sb", "boundary")}
    return {
        alpha: linearised_problem(frame0, frame1, own, FlowParams().replace({**model, "alpha": alpha}))
        for alpha in alphas
    }


def measure(options: Mapping[str, Any], plan: Plan) -> tuple[pd.DataFrame, dict[float, float]]:
    """Run every solver on every problem.

    Parameters
    ----------
    options : mapping
        Of the experiment.
    plan : Plan
        The plan whose data are used.

    Returns
    -------
    courses : pandas.DataFrame
        ``alpha, solver, iteration, u_steps, seconds, gap``.
    literal : dict
        By alpha, seconds that a sweep by the printed double sums takes longer than one with dense matrices.
    """
    import pandas as pd
    from threadpoolctl import threadpool_limits

    from fracbench.studies.solvers.linearised_problem import SOLVERS, course, minimum, sweep_seconds

    limits = {"gap": options["last_gap"], "seconds": options["seconds"], "iterations": options["iterations"]}
    records, literal = [], {}
    with threadpool_limits(1):
        for alpha, problem in problems(options["region"], options["alphas"], plan).items():
            least = minimum(problem, options["reference_iterations"])
            for name, solver in SOLVERS.items():
                records += [(alpha, name, *record) for record in course(problem, solver, least, **limits)]
            dense, slow = sweep_seconds(problem.start.shape[1:], problem.params)
            literal[alpha] = slow - dense
    columns = ["alpha", "solver", "iteration", "u_steps", "seconds", "gap"]
    return pd.DataFrame.from_records(records, columns=columns), literal


def summarise(courses: pd.DataFrame, gap: float, literal: Mapping[float, float]) -> pd.DataFrame:
    """Return when each solver was first within the gap.

    Parameters
    ----------
    courses : pandas.DataFrame
        From `measure`.
    gap : float
        Relative gap.
    literal : mapping
        From `measure`.

    Returns
    -------
    pandas.DataFrame
        ``alpha, solver, gap, iterations, u-steps, seconds, ratio``; where the gap was not reached, all is for
        the least gap that was.
    """
    import pandas as pd

    from fracbench.studies.solvers.linearised_problem import DEFAULT, LITERAL

    records = []
    for alpha, of_alpha in courses.groupby("alpha", sort=False):
        own = of_alpha[of_alpha["solver"] == DEFAULT]
        for solver, part in of_alpha.groupby("solver", sort=False):
            level = max(gap, 1.01 * part["gap"].min())
            near = part[part["gap"] <= level].iloc[0]
            base = own.loc[own["gap"] <= level, "seconds"].min()
            counts = int(near["iteration"]), int(near["u_steps"])
            records.append([alpha, solver, level, *counts, near["seconds"], near["seconds"] / base])
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
