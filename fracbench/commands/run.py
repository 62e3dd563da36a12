"""Experiments and single flows from beginning to end: plan, run, store, draw, print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fracbench.commands import console
from fracbench.commands.flow_output import picture_beside, say_errors, say_result, write_flow_and_picture
from fracbench.commands.warmup import compile_for
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run import sweep
from fracbench.harness.run.grid_points import PlannedPoint, PlannedPoints
from fracbench.harness.run.plan import Plan, make_plan, plan_artefact
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import RUNS, STORE, Row, Store

if TYPE_CHECKING:
    from fracbench.studies.base import Artefact

#: Stored rows that the time of a sweep is estimated by.
_SAMPLE = 10_000


def run_experiment(
    experiment: Experiment,
    settings: Sequence[str] = (),
    *,
    jobs: int | None = None,
    dry_run: bool = False,
    rerun_failed: bool = False,
    small: bool = False,
) -> int:
    """Compute the missing points of an experiment and write its artefact; return how many points are not done.

    `settings` are overrides of data set, paths and parallel; `jobs` is by default the number in the configuration.
    """
    if jobs is not None:
        require_workers(jobs)
    plan = plan_artefact(experiment, settings, allow_download=not dry_run, small=small)
    for notice in plan.notices:
        console.note(f"note: {notice}")
    workers = jobs or plan.config.parallel.jobs
    if dry_run:
        say_cost(plan, workers, rerun_failed=rerun_failed)
        if experiment.artefact == "protocol_search":
            _say_search(experiment, plan)
        return 0
    from fracbench.studies.registry import render, require_renderer

    require_renderer(experiment, plan)
    report = run_plan(plan, experiment.name, workers, rerun_failed=rerun_failed)
    if experiment.artefact == "protocol_search":
        _search(experiment, plan, workers)
    artefact = render(experiment, plan, report.rows, plan.config.results)
    if experiment.artefact == "protocol_claims":
        _judge(experiment, plan, report.rows, artefact)
    _say_computed(report)
    for title, view in artefact.views:
        console.show_table(view, title)
    for line in artefact.lines:
        console.say(line)
    _say_settings(plan)
    for path in artefact.files:
        console.say(f"wrote {path}")
    say_failures(report)
    return len(report.failed)


def show_config(experiment: Experiment, settings: Sequence[str]) -> None:
    """Print the composed configuration of each grid of an experiment, as YAML, and the options of its renderer.

    A key that varies has all its values. Parameters that a point does not depend on are left out, as in its key.
    """
    import yaml

    for part, tokens in experiment.grids.items():
        words = [*tokens, *settings]
        grid, plan = parse_overrides(words), make_plan(words, allow_download=False)
        for notice in plan.notices:
            console.note(f"note: {notice}")
        labels = {key: [planned.labels.get(key) for planned in plan.points] for key in _LABELS}
        others = {key: [point[key] for point in grid.points()] for key in grid.varying if key not in labels}
        parameters: dict[str, list[Any]] = {}
        for planned in plan.points:
            for key, value in planned.point.canonical.items():
                parameters.setdefault(key, []).append(value)
        shown: dict[str, Any] = {key: _distinct(values) for key, values in labels.items()}
        shown |= {key: _distinct(values) for key, values in others.items() if key not in parameters}
        shown["params"] = {key: _distinct(values) for key, values in sorted(parameters.items())}
        shown["parallel"] = vars(plan.config.parallel)
        folder = None if plan.folder is None else str(plan.folder)
        shown["paths"] = {"data": folder, "results": str(plan.config.results)}
        title = f"# {part}: " if len(experiment.grids) > 1 else "# "
        console.say(f"{title}{' '.join(words) or 'the default'}; {len(plan.unique())} points")
        console.say(yaml.safe_dump(shown, sort_keys=False).rstrip())
    if experiment.options:
        console.say(yaml.safe_dump({"options": dict(experiment.options)}, sort_keys=False).rstrip())


_LABELS = ("dataset", "sequence", "region", "method", "protocol")


def _distinct(values: Sequence[Any]) -> Any:
    """Return the only value, or the list of the distinct ones; texts that are numbers become numbers."""
    import yaml

    plain = [yaml.safe_load(value) if isinstance(value, str) else value for value in dict.fromkeys(values)]
    return plain[0] if len(plain) == 1 else plain


def _search(experiment: Experiment, plan: Plan, jobs: int) -> None:
    """Run the search of an experiment, or the rest of it; its points are computed here if `jobs` is 1."""
    from fracbench.data.files import ensure_folder
    from fracbench.report.sources import homes
    from fracbench.studies.base import TABLES
    from fracbench.studies.protocol_search.artefact import printed_numbers, trial_table
    from fracbench.studies.protocol_search.search import run_search, take_over
    from fracbench.studies.protocol_search.space import settings_of

    settings = settings_of(experiment, plan)
    table = trial_table(experiment, plan, settings)
    ensure_folder(table.path.parent)
    for home in homes(plan.config.results)[1:]:
        known = home / TABLES / f"{table.path.name}.gz"
        if known.exists() and not table.path.exists() and (count := take_over(table, known, settings)):
            console.note(f"{count} configurations taken from {known}")
    total = sum(stage.size for stage in settings.stages)
    data = None if plan.folder is None else plan.folder.resolve()
    with Store(plan.config.results / STORE) as store, console.progress(total, "configurations") as advance:

        def compute(points: Mapping[str, Point]) -> Mapping[str, Row]:
            if jobs == 1:
                return sweep.compute_here(points, store, data)
            planned = PlannedPoints([PlannedPoint(point, {}) for point in points.values()])
            return sweep.run(replace(plan, points=planned), store, jobs=jobs).rows

        run_search(settings, table, printed_numbers(plan), compute, advance)


def _judge(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], artefact: Artefact) -> None:
    """Judge the paper's claims by the points of an experiment, and add the verdicts to its artefact."""
    from fracbench.harness.run.tidy import tidy
    from fracbench.report.claims.claims import count_lines, write_claims
    from fracbench.report.claims.further import judge_further
    from fracbench.studies.base import TABLES, file_stem

    judged = judge_further(tidy(plan, rows))
    stem = file_stem(f"{experiment.name}_claims", plan, plan.config.results / TABLES)
    artefact.files += write_claims(judged, stem)
    artefact.lines += count_lines(judged)


def _say_search(experiment: Experiment, plan: Plan) -> None:
    from fracbench.studies.protocol_search.artefact import trial_table
    from fracbench.studies.protocol_search.space import settings_of

    settings = settings_of(experiment, plan)
    done = len(trial_table(experiment, plan, settings).read())
    total = sum(stage.size for stage in settings.stages)
    console.say(f"search: {total} configurations of {len(settings.switches)} switches, {done} done")


def run_plan(plan: Plan, name: str, jobs: int, *, rerun_failed: bool = False) -> sweep.Report:
    """Compute the missing points of a plan, with a progress bar called `name`."""
    from fracbench.data.files import ensure_folder

    require_workers(jobs)
    results = plan.config.results
    ensure_folder(results / STORE.parent)
    with Store(results / STORE) as store:
        compared = _, todo = sweep.missing(plan, store, rerun_failed=rerun_failed)
        if plan.config.parallel.backend != "dask":
            compile_for((point.method, point.params) for point in todo.values())
        with console.progress(len(todo), name) as advance:
            return sweep.run(plan, store, jobs=jobs, on_end=advance, compared=compared)


def require_workers(jobs: int) -> None:
    """Refuse a number of worker processes below 1."""
    if jobs < 1:
        raise InputError(f"--jobs must be at least 1, got {jobs}")


def say_cost(plan: Plan, jobs: int, *, rerun_failed: bool = False) -> None:
    """Print how many points a plan has, how many are stored, and the minutes that the others will take."""
    from fracbench.harness.run.cost import expected_seconds

    with Store(plan.config.results / STORE, readonly=True) as store:
        total, todo = sweep.count_missing(plan, store, rerun_failed=rerun_failed)
        seconds, measured = expected_seconds(todo, store.sample("done", _SAMPLE), jobs)
    n_missing = sum(count for _, count in todo)
    basis = "from stored points of the same methods" if measured else "rough: nothing like it is stored yet"
    console.say(
        f"{total} points, {total - n_missing} stored, {n_missing} to compute on {jobs} processes: "
        f"about {seconds / 60:.1f} minutes ({basis})"
    )
    _say_settings(plan)


def _say_computed(report: sweep.Report) -> None:
    if report.computed:
        why = ", ".join(f"{count} {reason}" for reason, count in sorted(report.reasons.items()))
        console.note(f"{report.computed} points computed ({why}), {report.reused} taken from the store")
    elif report.rows:
        console.note(f"nothing to compute: all {report.reused} points are in the store")


def _say_settings(plan: Plan) -> None:
    config = plan.config
    shared, boundaries = plan.labels("protocol"), plan.values("boundary")
    settings = [f"dataset {plan.dataset}"]
    if shared:
        settings.append(f"protocol {', '.join(sorted(shared))}")
    if boundaries:
        settings.append(f"boundary {', '.join(sorted(boundaries))}")
    if config.region is not None:
        settings.append(f"context {config.context} px")
    if plan.points:
        settings.append("other parameters in the CSV")
    console.say(f"settings: {'; '.join(settings)}")


def say_failures(report: sweep.Report) -> None:
    """Print how many points are not done, if any, and how to try them again."""
    failed = report.failed
    if failed:
        first = report.rows[failed[0]].error
        console.complain(
            f"{len(failed)} of {len(report.rows)} points are not done (first: {first}); "
            "the same command with --rerun failed tries them again"
        )


def run_point(tokens: Sequence[str]) -> None:
    """Compute the one flow that the overrides stand for and write it below ``results/runs/flows``."""
    if parse_overrides(tokens).size > 1:
        raise InputError(f"run takes one point, not a grid ({' '.join(tokens)}); use sweep")
    plan = make_plan(tokens)
    if len(plan.points) > 1:
        raise InputError(f"run takes one point, {' '.join(tokens)} stands for {len(plan.points)}; use sweep")
    for notice in plan.notices:
        console.note(f"note: {notice}")
    from fracbench.data.files import ensure_folder
    from fracbench.harness.run.compute_point import point_arrays, point_options
    from fracbench.methods.registry import get_method

    planned = plan.points[0]
    point = planned.point
    folder = ensure_folder(plan.config.results / RUNS / "flows")
    frame0, frame1, truth, inner = point_arrays(point, plan.folder)
    options = point_options(point, plan.folder)
    compile_for([(point.method, point.params)])
    result = get_method(point.method).compute(frame0, frame1, point.params, **options)
    flow = result.flow[(slice(None), *inner)]
    place = planned.labels["sequence" if point.region is None else "region"]
    name = f"{place}_{point.method}_{point.key[:8]}"
    say_result(result)
    if truth is not None:
        say_errors(flow, truth[(slice(None), *inner)])
    output = folder / f"{name}.flo"
    write_flow_and_picture(flow, output, picture_beside(output))
    _say_settings(plan)
