"""The benchmark from beginning to end: measure, print the table, write CSV and picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fracbench.commands import console
from fracbench.errors import InputError
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import RUNS

if TYPE_CHECKING:
    import pandas as pd


#: The scripts of a checkout that measure what `bench --study` once did.
STUDIES = {"size": "growth", "jobs": "jobs", "roofline": "roofline"}


def bench(study: str | None, tokens: Sequence[str], *, repeats: int, threads: int, only: Sequence[str]) -> None:
    """Run the race of all contenders.

    Parameters
    ----------
    study : str or None
        A study of the program itself, which is a script now; None for the race.
    tokens, repeats, threads, only
        See `race`.

    Raises
    ------
    InputError
        A study, numbers below 1, and what `race` refuses.
    """
    if study is not None:
        raise InputError(
            f"bench: the study {study!r} has moved: python benchmarks/{STUDIES[study]}.py, in a checkout"
        )
    if repeats < 1 or threads < 1:
        raise InputError(f"bench: --repeats and --threads must be at least 1, got {repeats} and {threads}")
    race(tokens or ["sequence=all"], repeats=repeats, threads=threads, only=only)


def race(tokens: Sequence[str], *, repeats: int, threads: int, only: Sequence[str]) -> None:
    """Time the contenders, print the table, write CSV and picture below ``results/runs/bench``.

    Parameters
    ----------
    tokens : sequence of str
        Overrides that choose sequences, data set and paths.
    repeats : int
        Timed rounds.
    threads : int
        Threads of the solver and of OpenCV; BLAS has one.
    only : sequence of str
        Contenders, by beginning of name; all if empty.

    Raises
    ------
    InputError
        Unknown contenders, and overrides that stand for no plan.
    """
    import pandas as pd

    from fracbench.figures.style import save_figure
    from fracbench.studies.race import figures, measure

    racers = measure.contenders(only)
    some = "_some" if only else ""  # not in place of the race of all
    plan, stem = make_plan(tokens), results_stem(tokens, f"bench_{threads}_threads{some}")
    with console.progress(len(plan.points) * len(racers) * repeats, "bench") as advance:
        records = measure.run(racers, tokens, repeats=repeats, threads=threads, on_lap=advance)
    summary = figures.summarise(records, measure.YARDSTICK)
    title = f"mean over {len(plan.points)} sequences, {threads} thread(s), {plan.dataset}"
    note = f"seconds: median of {repeats} rounds; peak_mib: beyond memory kept from earlier contenders"
    shown = summary.dropna(axis="columns", how="all")  # without the yardstick there is no ratio
    if "ratio" in shown:
        note += f"; ratio: to {measure.YARDSTICK}"
    write_results(pd.DataFrame(records), stem, title, note, shown=shown)
    figure = figures.error_against_time(summary, f"Error against time, {threads} thread(s)")
    for path in save_figure(figure, stem):
        console.say(f"wrote {path}")


def results_stem(tokens: Sequence[str], name: str) -> Path:
    """Return where results go, without suffix, before anything is measured in vain."""
    from fracbench.data.files import ensure_folder

    return ensure_folder(make_plan(tokens).config.results / RUNS / "bench") / name


def write_results(
    table: pd.DataFrame,
    stem: Path,
    title: str,
    note: str = "medians of the rounds",
    *,
    shown: pd.DataFrame | None = None,
) -> None:
    """Show a table, or what sums it up, and write it."""
    from fracbench.harness.run.provenance import machine
    from fracbench.studies.tables import write_table

    console.show_table((table if shown is None else shown).round(4), title)
    console.say(f"{note}; on {machine()['cpu']}")
    console.say(f"wrote {write_table(table, stem)}")
