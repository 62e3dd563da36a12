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


_SWEEP = ("region=grove2_A", "alpha=0:2:0.05")


def bench(
    study: str | None, tokens: Sequence[str], *, repeats: int, threads: int | None, only: Sequence[str]
) -> None:
    """Run the benchmark or one of its studies.

    Parameters
    ----------
    study : {None, 'size', 'jobs', 'roofline'}
        None for the race of all contenders.
    tokens : sequence of str
        Overrides; those of the race and of `jobs` have defaults.
    repeats : int
        Timed rounds.
    threads : int or None
        Threads, or worker processes of `jobs`; None for 1 in the race, and for 2 where they are compared with 1.
    only : sequence of str
        Contenders of the race.

    Raises
    ------
    InputError
        Numbers below 1, and what the studies refuse.
    """
    if threads is None:
        threads = 2 if study in ("size", "jobs") else 1
    if repeats < 1 or threads < 1:
        raise InputError(f"bench: --repeats and --threads must be at least 1, got {repeats} and {threads}")
    if study == "size":
        grow(tokens, repeats=repeats, threads=threads)
    elif study == "jobs":
        share(tokens or _SWEEP, repeats=repeats, jobs=threads)
    elif study == "roofline":
        weigh(tokens, repeats=repeats)
    else:
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
    from fracbench.studies.race import figures as benchmark
    from fracbench.studies.race import measure as racing

    racers = racing.contenders(only)
    some = "_some" if only else ""  # not in place of the race of all
    plan, stem = make_plan(tokens), _stem(tokens, f"bench_{threads}_threads{some}")
    with console.progress(len(plan.points) * len(racers) * repeats, "bench") as advance:
        records = racing.run(racers, tokens, repeats=repeats, threads=threads, on_lap=advance)
    summary = benchmark.summarise(records, racing.YARDSTICK)
    title = f"mean over {len(plan.points)} sequences, {threads} thread(s), {plan.dataset}"
    note = f"seconds: median of {repeats} rounds; ratio: to {racing.YARDSTICK}"
    shown = summary.dropna(axis="columns", how="all")  # without the yardstick there is no ratio
    _write(pd.DataFrame(records), stem, title, note if "ratio" in shown else note.partition(";")[0], shown=shown)
    figure = benchmark.error_against_time(summary, f"Error against time, {threads} thread(s)")
    for path in save_figure(figure, stem):
        console.say(f"wrote {path}")


def grow(tokens: Sequence[str], *, repeats: int, threads: int) -> None:
    """Measure growth with the size of the image, and what threads gain.

    Parameters
    ----------
    tokens : sequence of str
        Overrides: ``paths.results`` only matters.
    repeats : int
        Timed rounds.
    threads : int
        Compared with one.
    """
    import pandas as pd

    from fracbench.harness import growth

    stem = _stem(tokens, f"size_{threads}_threads")
    laps = 2 * repeats * sum(growth.turns(shape) for _, shape in growth.cases())
    with console.progress(laps, "bench") as advance:
        records = growth.by_size(threads=threads, repeats=repeats, on_lap=advance)
    _write(pd.DataFrame(records), stem, f"alpha 1.2, fixed iterations, {threads} threads against one")


def share(tokens: Sequence[str], *, repeats: int, jobs: int) -> None:
    """Measure what worker processes gain, and what a point costs beyond its computation.

    Parameters
    ----------
    tokens : sequence of str
        The sweep.
    repeats : int
        Timed rounds.
    jobs : int
        Worker processes, compared with one.
    """
    import pandas as pd

    from fracbench.harness import growth

    stem = _stem(tokens, f"jobs_{jobs}")
    with console.progress(2 * repeats, "bench") as advance:
        record = growth.by_jobs(tokens, jobs, repeats=repeats, on_lap=advance)
    _write(pd.DataFrame([record]), stem, " ".join(tokens))


def weigh(tokens: Sequence[str], *, repeats: int) -> None:
    """Compare one iteration with what the machine's memory and arithmetic allow.

    Parameters
    ----------
    tokens : sequence of str
        Overrides: ``paths.results`` only matters.
    repeats : int
        Timed rounds.
    """
    import pandas as pd

    from fracbench.harness import growth

    stem = _stem(tokens, "roofline")
    records = [growth.roofline(shape, repeats=repeats) for shape in growth.SHAPES[:2]]
    _write(pd.DataFrame(records), stem, "one iteration, reflect, float32, one thread")


def _stem(tokens: Sequence[str], name: str) -> Path:
    """Return where results go, without suffix, before anything is measured in vain."""
    from fracbench.data.files import ensure_folder

    return ensure_folder(make_plan(tokens).config.results / RUNS / "bench") / name


def _write(
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
