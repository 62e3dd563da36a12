"""The whole paper at once: every table, figure and study, then the page that judges them."""

from __future__ import annotations

from collections.abc import Sequence

from fracbench import console
from fracbench.harness.experiment import list_experiments, load_experiment
from fracbench.harness.plan import plan_experiment
from fracbench.session import perform, say_failures

_FIGURES = tuple(f"fig{number}" for number in range(1, 8))
#: The paper's experiments in its order, what its claims need besides, and two studies of how it was computed.
PAPER = ("table1", "table2", *_FIGURES, "regions_lambda_sb", "protocol_study", "solver_study")


def report(settings: Sequence[str] = (), *, jobs: int | None = None, small: bool = False) -> int:
    """Run what is missing of the paper and write the HTML page about it.

    Parameters
    ----------
    settings : sequence of str, optional
        Overrides for all grids: data set, paths, parallel.
    jobs : int, optional
        Worker processes; the configuration's number by default.
    small : bool, optional
        Thin the grids; the names of files say so.

    Returns
    -------
    int
        How many points are not done.

    Raises
    ------
    InputError
        Anything that the user can put right.
    """
    from fracbench.report.html import write_report

    start = plan_experiment({}, settings)
    for notice in start.notices:
        console.note(f"note: {notice}")
    if start.dataset == "synthetic":  # decided once: where there is no network, each look for data costs seconds
        settings = [*(token for token in settings if not token.startswith("dataset=")), "dataset=synthetic"]
    failed = run_paper(settings, jobs=jobs, small=small)
    console.say(f"wrote {write_report(start.config.results, settings, small)}")
    return failed


def run_paper(settings: Sequence[str] = (), *, jobs: int | None = None, small: bool = False) -> int:
    """Run what is missing of the experiments of the paper and write their artefacts, one line each.

    Parameters
    ----------
    settings, jobs, small
        See `report`.

    Returns
    -------
    int
        How many points are not done.

    Raises
    ------
    InputError
        Anything that the user can put right.
    """
    known, failed = list_experiments(), 0
    for name in (name for name in PAPER if name in known):
        experiment = load_experiment(name)
        plan = plan_experiment(experiment.grids, settings, small=small)
        done, artefact = perform(experiment, plan, plan.config.parallel.jobs if jobs is None else jobs)
        folders = ", ".join(dict.fromkeys(str(path.parent) for path in artefact.files))
        counts = f"{len(plan.unique())} points, {done.computed} computed, wrote {len(artefact.files)} files"
        console.say(f"{name}: {counts} in {folders}")
        say_failures(done)
        failed += len(done.failed)
    return failed


def judge(settings: Sequence[str] = (), *, small: bool = False) -> list[str]:
    """Judge the paper's claims by what is stored, print and write the verdicts; nothing is computed.

    Parameters
    ----------
    settings : sequence of str, optional
        Overrides for all grids: data set, paths.
    small : bool, optional
        Judge the thinned grids.

    Returns
    -------
    list of str
        How many claims hold under each protocol, and the files written.

    Raises
    ------
    InputError
        Anything that the user can put right.
    """
    from fracbench.report import claims
    from fracbench.report.sources import Sources
    from fracbench.report.tables import ensure_folder

    results = plan_experiment({}, settings, allow_download=False).config.results
    sources = Sources(results, settings, small)
    judged = claims.evaluate(sources.load)
    verdicts = claims.overview_table(judged).drop(columns=["quotation", "place"])
    console.show_table(verdicts, "The paper's claims")
    files = claims.write_claims(judged, ensure_folder(results / "tables") / f"claims{sources.suffix}")
    return [*claims.count_lines(judged), *(f"wrote {path}" for path in files)]
