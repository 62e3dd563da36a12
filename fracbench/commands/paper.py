"""The whole paper at once: every table, figure and study, then the verdicts, and the page that shows them all."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.commands import console
from fracbench.commands.run import run_plan, say_cost, say_failures
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment, list_experiments, load_experiment
from fracbench.harness.run.grid_points import PlannedPoints
from fracbench.harness.run.plan import Plan, plan_artefact, plan_experiment
from fracbench.harness.run.store import STORE, Store

if TYPE_CHECKING:
    from fracbench.report.sources import Sources

_FIGURES = tuple(f"fig{number}" for number in range(1, 8))
#: The paper's experiments in its order, one more that its claims need, and two studies of how it was computed.
PAPER = ("table1", "table2", *_FIGURES, "regions_lambda_sb", "protocol_study", "solver_study")


def report(
    settings: Sequence[str] = (),
    *,
    jobs: int | None = None,
    small: bool = False,
    dry_run: bool = False,
    beyond: bool = False,
    only: Sequence[str] = (),
) -> int:
    """Compute the paper's missing points, judge its claims, write the HTML page; return the number of failures.

    With `beyond`, the experiments beyond the paper take the place of the paper's, and no claim is judged;
    with `only`, those experiments do.
    `settings` are overrides of data set, paths and parallel; `jobs` is by default the number in the configuration.
    """
    from fracbench.harness.run.pool import parallel_map
    from fracbench.report.page.beyond import EXPERIMENTS
    from fracbench.report.page.gallery import compute_flow, missing_flows
    from fracbench.report.page.html import write_report
    from fracbench.report.sources import Sources
    from fracbench.studies.registry import require_renderer

    start = plan_experiment({}, settings, allow_download=not dry_run)
    for notice in start.notices:
        console.note(f"note: {notice}")
    if start.dataset == "synthetic":  # decided once: where there is no network, each look for data costs seconds
        settings = [*(token for token in settings if not token.startswith("dataset=")), "dataset=synthetic"]
    wanted = only or (EXPERIMENTS if beyond else PAPER)
    if start.foreign and not only:
        raise InputError(
            f"report: most of the paper is about regions, which dataset={start.dataset} does not have; name the "
            "experiments to run, e.g. --only table2"
        )
    known = list_experiments()
    experiments = {name: load_experiment(name) for name in wanted if only or name in known}
    plans = {
        name: plan_artefact(experiment, settings, allow_download=not dry_run, small=small)
        for name, experiment in experiments.items()
    }
    workers = start.config.parallel.jobs if jobs is None else jobs
    if dry_run:
        say_cost(_together(plans), workers)
        return 0
    for name, experiment in experiments.items():
        require_renderer(experiment, plans[name])
    done = run_plan(_together(plans), "report", workers)
    console.say(f"{len(done.rows)} points, {done.computed} computed")
    sources = Sources(start.config.results, settings, small, plans, only or None)
    drawing = [(_draw, experiment, plans[name], Path.cwd()) for name, experiment in experiments.items()]
    flows = [(compute_flow, *flow) for flow in missing_flows(sources)]
    finished = parallel_map(_call, [*drawing, *flows], workers, "all points are stored")
    verdicts = [] if beyond or only else write_verdicts(sources)  # while the workers draw
    for name, plan in plans.items():
        files = next(finished)
        folders = ", ".join(dict.fromkeys(str(path.parent) for path in files))
        console.say(f"{name}: {len(plan.unique())} points, wrote {len(files)} files in {folders}")
    with console.progress(len(flows), "flows") as advance:
        for _ in finished:
            advance()
    say_failures(done)
    for line in verdicts:
        console.say(line)
    console.say(f"wrote {write_report(sources)}")
    return len(done.failed)


def _call(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def _draw(experiment: Experiment, plan: Plan, folder: Path) -> list[Path]:
    """Write the artefact of an experiment whose points are stored; return its files, relative to `folder`."""
    from fracbench.studies.registry import render

    os.chdir(folder)  # a process of joblib's may have been started in another one
    with Store(plan.config.results / STORE, readonly=True) as store:
        rows = store.get_many(plan.unique())
    return render(experiment, plan, rows, plan.config.results).files


def _together(plans: Mapping[str, Plan]) -> Plan:
    """Return one plan with the points of all."""
    points = PlannedPoints(*(plan.points for plan in plans.values()))
    return replace(next(iter(plans.values())), points=points)


def judge(settings: Sequence[str] = (), *, small: bool = False, readme: Path | None = None) -> list[str]:
    """Judge the paper's claims by the stored results, print and write the verdicts; compute nothing.

    Return lines to print: how many claims hold under each protocol, and the files written. The block between the
    answer's markers in the Markdown file `readme` is renewed.
    """
    from fracbench.report.claims import answer, claims
    from fracbench.report.sources import Sources

    sources = Sources(plan_experiment({}, settings, allow_download=False).config.results, settings, small)
    verdicts = claims.overview_table(sources.judged).drop(columns=["quotation", "place"])
    console.show_table(verdicts, "The paper's claims")
    lines = [*claims.count_lines(sources.judged), *write_verdicts(sources)]
    if readme is not None:
        lines.append(f"wrote {answer.renew(readme, sources)}")
    return lines


def write_verdicts(sources: Sources) -> list[str]:
    """Write the verdicts and the picture that sums them up; return a line per file."""
    from fracbench.data.files import ensure_folder
    from fracbench.report.claims import answer, claims

    folder = ensure_folder(sources.results / "tables")
    files = claims.write_claims(sources.judged, folder / f"claims{sources.suffix}")
    return [f"wrote {path}" for path in (*files, *answer.write_answer(sources))]
