"""The benchmark from beginning to end: measure, print the table, write CSV and picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.commands import console
from fracbench.errors import InputError
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import RUNS

if TYPE_CHECKING:
    import pandas as pd


def bench(tokens: Sequence[str], *, repeats: int, threads: int, only: Sequence[str]) -> bool:
    """Time the contenders, print the table, write CSV and picture; say whether no contender failed.

    `tokens` choose sequences, data set and paths; `threads` are those of the solver and of OpenCV.
    """
    from fracbench.figures.style import save_figure
    from fracbench.studies.race import figures, measure

    if repeats < 1 or threads < 1:
        raise InputError(f"bench: --repeats and --threads must be at least 1, got {repeats} and {threads}")
    tokens = tokens or ["sequence=all"]
    racers = measure.contenders(only)
    some = "_some" if only else ""  # not in place of the race of all
    plan = make_plan(tokens)
    data = "" if plan.dataset in ("middlebury", "synthetic") else f"_{plan.dataset}"
    stem = results_stem(tokens, f"bench_{threads}_threads{some}{data}")
    with console.progress(len(plan.points) * len(racers) * repeats, "bench") as advance:
        records = measure.run(racers, tokens, repeats=repeats, threads=threads, on_lap=advance)
    summary = figures.summarise(records, measure.YARDSTICK)
    title = f"mean over {len(plan.points)} sequences, {threads} thread(s), {plan.dataset}"
    note = f"seconds: median of {repeats} rounds"
    shown = summary.dropna(axis="columns", how="all")  # without the yardstick there is no ratio
    if "ratio" in shown:
        note += f"; ratio: to {measure.YARDSTICK}"
    write_results(records, stem, title, note, shown=shown)
    figure = figures.error_against_time(summary, f"Error against time, {threads} thread(s)")
    for path in save_figure(figure, stem):
        console.say(f"wrote {path}")
    return {racer.name for racer in racers} == set(summary["contender"])


def results_stem(tokens: Sequence[str], name: str) -> Path:
    """Return where results go, without suffix; refuse at once a folder that cannot be written."""
    from fracbench.data.files import ensure_folder

    return ensure_folder(make_plan(tokens).config.results / RUNS / "bench") / name


def write_results(
    records: Sequence[Mapping[str, Any]],
    stem: Path,
    title: str,
    note: str = "medians of the rounds",
    *,
    shown: pd.DataFrame | None = None,
) -> None:
    """Write records as CSV and print them, or the table `shown` in their place."""
    import pandas as pd

    from fracbench.harness.run.provenance import machine
    from fracbench.studies.tables import write_table

    table = pd.DataFrame(records)
    console.show_table((table if shown is None else shown).round(4), title)
    console.say(f"{note}; on {machine()['cpu']}")
    console.say(f"wrote {write_table(table, stem)}")
