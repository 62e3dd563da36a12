"""The sources of the report: the stored rows of every experiment, planned and read once, never computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from fracbench.harness.config.experiment import Experiment, list_experiments, load_experiment
from fracbench.harness.config.paths import checkout
from fracbench.harness.run.plan import Plan, plan_experiment
from fracbench.harness.run.store import RUNS, Row, Store

if TYPE_CHECKING:
    import pandas as pd

    from fracbench.report.claims.claims import Judged

#: Endings of file names, by data set and size; see `fracbench.studies.base.file_stem`.
SUFFIXES = ("", "_synthetic", "_small", "_synthetic_small")
#: Copies of the tables and figures of the whole paper on Middlebury, renewed by `make publish`.
COMMITTED = "results/committed"


def homes(results: Path) -> tuple[Path, ...]:
    """Return the folders that hold tables and figures: the user's own, then the committed ones."""
    root = checkout()
    return (results,) if root is None else (results, root / COMMITTED)


@dataclass(frozen=True)
class Source:
    """An experiment with the rows that the store holds of it.

    Attributes
    ----------
    experiment : Experiment
        The experiment, as its file defines it.
    plan : Plan
        Its points.
    rows : mapping of str to Row
        Stored rows by key.
    command : str
        The command that computes the missing ones.
    """

    experiment: Experiment
    plan: Plan
    rows: Mapping[str, Row]
    command: str

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a planned point; see `fracbench.harness.run.tidy.tidy`."""
        from fracbench.harness.run.tidy import tidy

        return tidy(self.plan, self.rows)

    @property
    def suffix(self) -> str:
        """The ending of its artefact's file names."""
        return SUFFIXES[self.plan.stand_in + 2 * self.plan.small]

    @property
    def n_points(self) -> int:
        """Number of distinct points."""
        return len(self.plan.unique())

    @property
    def n_missing(self) -> int:
        """Number of points that were never run."""
        return self.n_points - len(self.rows)

    @property
    def unfinished(self) -> list[Row]:
        """Rows of points that failed or diverged."""
        return [row for row in self.rows.values() if row.status != "done"]


class Sources:
    """The experiments of the project and of the working folder.

    Parameters
    ----------
    results : Path
        The results folder.
    settings : sequence of str, optional
        Overrides for all grids: data set, paths.
    small : bool, optional
        Whether grids are thinned.
    plans : mapping of str to Plan, optional
        Experiments that have been planned already, by name.

    Attributes
    ----------
    stand_in : bool
        Whether scenes take the place of Middlebury sequences.
    suffix : str
        The ending of the page's name.

    Raises
    ------
    InputError
        A store or data that cannot be read.
    """

    def __init__(
        self,
        results: Path,
        settings: Sequence[str] = (),
        small: bool = False,
        plans: Mapping[str, Plan] | None = None,
    ) -> None:
        self.results = results
        self.settings = tuple(settings)
        self.small = small
        self._data = plan_experiment({}, self.settings, allow_download=False, small=small)
        self.stand_in = self._data.stand_in
        self.suffix = SUFFIXES[self._data.stand_in + 2 * self._data.small]
        self._plans = dict(plans or {})
        self._found: dict[str, Source | None] = {}

    def get(self, name: str) -> Source | None:
        """Return an experiment with its rows, or None if there is no experiment of that name."""
        if name not in self._found:
            self._found[name] = self._read(name) if name in list_experiments() else None
        return self._found[name]

    def outline(self, name: str) -> Source | None:
        """Return an experiment without points, to show its files; None if there is none."""
        if name not in list_experiments():
            return None
        return Source(load_experiment(name), self._data, {}, self.command(name))

    def load(self, name: str) -> pd.DataFrame | None:
        """Return an experiment's tidy table, or None if nothing of it is stored."""
        source = self.get(name)
        return source.table if source is not None and source.rows else None

    @cached_property
    def judged(self) -> list[Judged]:
        """The paper's claims with their verdicts."""
        from fracbench.report.claims.claims import evaluate

        return evaluate(self.load)

    def find(self, relative: str) -> Path | None:
        """Return a file such as ``tables/answer.md``: the user's own, else the committed copy, else None."""
        return next((home / relative for home in homes(self.results) if (home / relative).is_file()), None)

    def command(self, name: str) -> str:
        """Return the command that computes an experiment."""
        kind, number = next(
            ((word, name.removeprefix(start)) for start, word in _NUMBERED if name.startswith(start)), ("", "")
        )
        words = [kind, number] if number.isdigit() else ["experiment", name]
        return " ".join(["fracbench", *words, *self.settings, *(["--small"] if self.small else [])])

    def _read(self, name: str) -> Source:
        experiment = load_experiment(name)
        plan = self._plans.get(name)
        if plan is None:
            plan = plan_experiment(experiment.grids, self.settings, allow_download=False, small=self.small)
        with Store(self.results / RUNS / "store.sqlite", readonly=True) as store:
            rows = store.get_many(plan.unique())
        return Source(experiment, plan, rows, self.command(name))


_NUMBERED = (("table", "table"), ("fig", "figure"))
