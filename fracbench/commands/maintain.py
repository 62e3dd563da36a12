"""The commands `check`, `status` and `compare`, which look at stored results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fracbench.commands import console
from fracbench.commands.run import require_workers
from fracbench.errors import unknown_name
from fracbench.harness.run.store import STORE

if TYPE_CHECKING:
    from fracbench.harness.check.regression import Verdict


def check_references(names: Sequence[str], *, jobs: int) -> bool:
    """Recompute stored tables (all without `names`), print each cell that moved, and return whether all hold."""
    from fracbench.harness.check import regression, tolerances
    from fracbench.model import SOLVER_VERSION

    require_workers(jobs)
    wanted = regression.wanted_tables(names)
    verdicts = []
    for name in wanted:
        plan = regression.plan_of(name)
        with console.progress(len(plan.unique()) if plan else 0, name) as advance:
            verdicts.append(regression.check(name, jobs=jobs, on_row=advance))
        say_verdict(verdicts[-1])
    compared = [verdict for verdict in verdicts if not verdict.skipped]
    old = tolerances.outdated((verdict.name for verdict in compared), SOLVER_VERSION)
    if names := ", ".join(old):
        console.note(f"note: the spread of {names} is not that of this solver: python tools/spread.py --update")
    return bool(compared) and not any(verdict.differences for verdict in compared)


def say_verdict(verdict: Verdict, word: str = "holds") -> None:
    """Print the result of a comparison: one line, and one more for each cell that differs."""
    if verdict.skipped:
        console.say(f"{verdict.name}: SKIPPED: {verdict.skipped}")
        return
    came_to = f"{len(verdict.differences)} DIFFERENCES" if verdict.differences else word
    console.say(f"{verdict.name}: {came_to} ({verdict.cells} cells compared)")
    for difference in verdict.differences:
        console.say(f"  {difference}")


def update_references(names: Sequence[str], reason: str, *, jobs: int) -> None:
    """Rewrite stored tables, all without `names`, and record the reason; a named experiment may be new."""
    from fracbench.harness.check import regression

    require_workers(jobs)
    for name in list(names) or regression.wanted_tables(names):
        for path in regression.update(name, reason, jobs=jobs):
            console.say(f"wrote {path}")


def show_status(names: Sequence[str], settings: Sequence[str], *, as_json: bool) -> None:
    """Print the progress of experiments, all without `names`, and the commands that resume them."""
    import json

    from fracbench.harness.config.experiment import list_experiments
    from fracbench.harness.run.plan import plan_experiment
    from fracbench.harness.run.status import standing
    from fracbench.harness.run.store import Store

    known = list_experiments()
    for name in names:
        if name not in known:
            raise unknown_name("experiment", name, known)
    path = plan_experiment({}, settings, allow_download=False).config.results / STORE
    with Store(path, readonly=True) as store:
        standings = [standing(name, settings, store) for name in names or known]
        counts = store.counts()
    if as_json:
        found = {"store": str(path), "rows": counts, "experiments": [vars(one) for one in standings]}
        console.say(json.dumps(found, indent=2))
        return
    import pandas as pd

    rows = ", ".join(f"{count} {status}" for status, count in counts.items() if count) or "no rows"
    console.say(f"store {path}: {rows}")
    columns = ["experiment", "dataset", "points", "done", "failed", "stale", "missing"]
    console.show_table(pd.DataFrame([vars(one) for one in standings])[columns])
    for one in standings:
        if one.error:
            console.say(f"{one.experiment}: cannot be planned: {one.error}")
        elif one.command:
            why = ", ".join(f"{count} {reason}" for reason, count in one.why.items())
            console.say(f"{one.experiment}: {one.command}{f'  ({why})' if why else ''}")


def compare_runs(first: str, second: str) -> bool:
    """Compare two stores, or the stored tables of two commits; print differences, return whether they agree.

    The first (see `fracbench.harness.check.compare.open_side`) counts as stored, the second as found.
    """
    from fracbench.harness.check.compare import compare_sides, open_side
    from fracbench.harness.check.tolerances import load_tolerances

    stored, found, tolerances = open_side(first), open_side(second), load_tolerances()
    verdicts = compare_sides(stored, found, tolerances)
    console.say(f"stored: {stored.title}")
    console.say(f"found: {found.title}")
    for column, tolerance in tolerances.columns.items():
        console.say(f"allowed for {column}: {tolerance}")
    for verdict in verdicts:
        say_verdict(verdict, "agree")
    return not any(verdict.differences for verdict in verdicts)
