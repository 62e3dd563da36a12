"""Commands that look at what is stored: does it still hold, how far does it move, what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fracbench import console
from fracbench.errors import InputError, unknown_name
from fracbench.session import require_workers

if TYPE_CHECKING:
    from fracbench.harness.regression import Verdict


def check_references(names: Sequence[str], *, jobs: int) -> bool:
    """Recompute stored tables and say, cell by cell, what moved.

    Parameters
    ----------
    names : sequence of str
        Stored tables; all if empty.
    jobs : int
        Worker processes.

    Returns
    -------
    bool
        Whether all that could be compared hold.

    Raises
    ------
    InputError
        An unknown name, or no table at all.
    """
    from fracbench.harness import regression
    from fracbench.report.tables import tidy

    require_workers(jobs)
    wanted = _stored(names)
    verdicts = []
    for name in wanted:
        plan = regression.plan_of(name)
        with console.progress(len(plan.unique()) if plan else 0, name) as advance:
            verdicts.append(regression.check(name, jobs=jobs, tabulate=tidy, on_row=advance))
        say_verdict(verdicts[-1])
    compared = [verdict for verdict in verdicts if not verdict.skipped]
    return bool(compared) and not any(verdict.differences for verdict in compared)


def say_verdict(verdict: Verdict, word: str = "holds") -> None:
    """Print what a comparison came to: one line, and one more for each cell that differs."""
    if verdict.skipped:
        console.say(f"{verdict.name}: SKIPPED: {verdict.skipped}")
        return
    came_to = f"{len(verdict.differences)} DIFFERENCES" if verdict.differences else word
    console.say(f"{verdict.name}: {came_to} ({verdict.cells} cells compared)")
    for difference in verdict.differences:
        console.say(f"  {difference}")


def _stored(names: Sequence[str]) -> list[str]:
    from fracbench.harness.regression import stored_tables

    tables = stored_tables()
    for name in names:
        if name not in tables:
            raise unknown_name("stored table", name, tables)
    if not tables:
        raise InputError("check: there is no stored table under results/reference")
    return list(names) or tables


def update_references(names: Sequence[str], reason: str, *, jobs: int) -> None:
    """Rewrite stored tables and record the reason.

    Parameters
    ----------
    names : sequence of str
        Stored tables; all if empty. An experiment that is not stored yet becomes so.
    reason : str
        Why the numbers change.
    jobs : int
        Worker processes.

    Raises
    ------
    InputError
        Anything that the user can put right; nothing is written then.
    """
    from fracbench.harness import regression
    from fracbench.report.tables import tidy

    require_workers(jobs)
    for name in list(names) or _stored(names):
        for path in regression.update(name, reason, jobs=jobs, tabulate=tidy):
            console.say(f"wrote {path}")


def measure_spread(names: Sequence[str], *, jobs: int, update: bool) -> None:
    """Measure how far stored tables move where nothing has changed, and print it.

    Parameters
    ----------
    names : sequence of str
        Stored tables; all if empty, Middlebury's only where the data can be had.
    jobs : int
        Processes at a time.
    update : bool
        Write the spreads, and the tolerances that follow from them.

    Raises
    ------
    InputError
        An unknown name, data that cannot be had, no checkout to write to.
    """
    import pandas as pd

    from fracbench.harness import regression, spread, tolerances
    from fracbench.report.tables import tidy

    require_workers(jobs)
    if update:
        regression.require_checkout()
    wanted = list(_stored(names)) if names else [name for name in _stored(()) if regression.plan_of(name)]
    with console.progress(len(wanted) * (len(spread.CIRCUMSTANCES) + 1), "spread") as advance:
        measured = spread.measure(wanted, jobs=jobs, tabulate=tidy, on_done=advance)
    records = [record for name, table in measured.items() for record in spread.summary(name, table)]
    console.show_table(pd.DataFrame(records), "largest relative differences")
    for path in tolerances.write(measured) if update else ():
        console.say(f"wrote {path}")
