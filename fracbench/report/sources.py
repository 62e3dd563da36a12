"""The sources of the report: the stored rows of every experiment, planned and read once, never computed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.config.paths import checkout
from fracbench.harness.run.plan import Plan, plan_artefact, plan_experiment
from fracbench.harness.run.store import STORE, Row, Store

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
    """An experiment with its plan, the rows that the store holds of it by key, and the command for the others."""

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
        return self.plan.mark

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
    """The experiments of the project and of the working folder, as stored in a results folder.

    `settings` override all grids (data set, paths), `small` thins them; `plans` holds the plans already made.
    Experiments that are not in `only` are shown without points.
    """

    def __init__(
        self,
        results: Path,
        settings: Sequence[str] = (),
        small: bool = False,
        plans: Mapping[str, Plan] | None = None,
        only: Sequence[str] | None = None,
    ) -> None:
        self.results = results
        self.settings = tuple(settings)
        self.small = small
        self._data = plan_experiment({}, self.settings, allow_download=False, small=small)
        self.stand_in = self._data.stand_in  # scenes take the place of Middlebury
        self.dataset = self._data.dataset
        self.suffix = self._data.mark
        self._plans = plans or {}
        self._only = only
        self._found: dict[str, Source] = {}

    def get(self, name: str) -> Source:
        """Return an experiment with its rows."""
        if self._only is not None and name not in self._only:
            return self.outline(name)
        if name not in self._found:
            experiment = load_experiment(name)
            plan = self._plans.get(name)
            if plan is None:
                plan = plan_artefact(experiment, self.settings, allow_download=False, small=self.small)
            with Store(self.results / STORE, readonly=True) as store:
                rows = store.get_many(plan.unique())
            self._found[name] = Source(experiment, plan, rows, self.command(name))
        return self._found[name]

    def outline(self, name: str) -> Source:
        """Return an experiment without points, to show its files."""
        return Source(load_experiment(name), self._data, {}, self.command(name))

    def load(self, name: str) -> pd.DataFrame | None:
        """Return an experiment's tidy table, or None if nothing of it is stored."""
        source = self.get(name)
        return source.table if source.rows else None

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
        found = re.fullmatch(r"(table|fig)(\d+)", name)
        if found is None:
            return self.typed("experiment", name)
        return self.typed("table" if found[1] == "table" else "figure", found[2])

    def typed(self, *words: str) -> str:
        """Return a command with the settings of these results."""
        return " ".join(["fracbench", *words, *self.settings, *(["--small"] if self.small else [])])
