"""Did our numbers change? Recompute the tables under ``results/reference`` and compare cell by cell."""

from __future__ import annotations

import datetime
import json
import math
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError, unknown_name
from fracbench.harness import execute, provenance
from fracbench.harness.assets import asset, checkout
from fracbench.harness.experiment import Experiment, load_experiment
from fracbench.harness.plan import Plan, plan_experiment
from fracbench.harness.store import Row, Store
from fracbench.model import SOLVER_VERSION

if TYPE_CHECKING:
    import pandas as pd

#: Columns compared within a tolerance, and those that must be equal.
MEASURED = ("aae", "aepe", "sdae")
COUNTED = ("n_pixels", "n_unknown", "n_nonfinite", "status")

Tabulate = Callable[[Plan, Mapping[str, Row]], "pd.DataFrame"]


@dataclass(frozen=True)
class Tolerance:
    """How far a cell may move, on what basis, and why that is no change."""

    absolute: float
    relative: float
    basis: str
    reason: str

    def __post_init__(self) -> None:
        for bound in (self.absolute, self.relative):
            if not (math.isfinite(bound) and bound >= 0):
                raise ValueError(f"a tolerance must be finite and at least 0, got {bound}")
        if not (self.basis.strip() and self.reason.strip()):
            raise ValueError("a tolerance needs its basis and its reason")

    def allows(self, stored: float, found: float) -> bool:
        """Tell whether `found` may stand for `stored`; what is not finite never may."""
        return math.isfinite(stored) and abs(found - stored) <= self.absolute + self.relative * abs(stored)


@dataclass(frozen=True)
class Difference:
    """A cell that moved, is missing, is extra, or cannot be compared."""

    row: str
    column: str
    stored: Any
    found: Any
    allowed: str

    def __str__(self) -> str:
        return f"{self.row}: {self.column}: stored {self.stored}, found {self.found} (allowed: {self.allowed})"


@dataclass
class Verdict:
    """What the comparison of one stored table came to.

    Attributes
    ----------
    name : str
        The stored table.
    cells : int
        Cells compared.
    differences : list of Difference
        Empty if the table holds.
    skipped : str
        Why it was not compared at all; empty if it was.
    """

    name: str
    cells: int = 0
    differences: list[Difference] = field(default_factory=list)
    skipped: str = ""


def stored_tables() -> list[str]:
    """Return the names of the stored tables."""
    return sorted(path.stem for path in asset("results/reference").glob("*.csv"))


def check(name: str, *, jobs: int, tabulate: Tabulate, on_row: Callable[[Row], None] | None = None) -> Verdict:
    """Recompute a stored table, all of it, and compare.

    Parameters
    ----------
    name : str
        A stored table: an experiment, with ``_synthetic`` behind it for the rendered scenes.
    jobs : int
        Worker processes.
    tabulate : callable
        Turns a plan and its rows into a tidy table.
    on_row : callable, optional
        Called with each computed row.

    Returns
    -------
    Verdict
        Skipped, with the reason, where Middlebury cannot be had.

    Raises
    ------
    InputError
        No such table, or a file that cannot be read.
    """
    if name not in stored_tables():
        raise unknown_name("stored table", name, stored_tables())
    plan = plan_of(name)
    if plan is None:
        return Verdict(name, skipped="the Middlebury data cannot be had here")
    stored, tolerances = _read(asset(f"results/reference/{name}.csv")), load_tolerances()
    found = reference_table(plan, recompute(plan, jobs, on_row), tabulate)
    return compare(name, stored, found, tolerances)


def _read(path: Path) -> pd.DataFrame:
    import pandas as pd

    try:
        return pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as exc:  # pandas' parser errors are ValueErrors
        raise InputError(f"{path}: cannot be read as a table: {' '.join(str(exc).split())}") from exc


def plan_of(name: str) -> Plan | None:
    """Return the plan behind a stored table, or None where its data cannot be had."""
    base = name.removesuffix("_synthetic")
    experiment: Experiment = load_experiment(base)
    dataset = "synthetic" if base != name else "auto"
    plan = plan_experiment(experiment.grids, [f"dataset={dataset}"])
    return None if plan.stand_in and dataset == "auto" else plan


def recompute(plan: Plan, jobs: int, on_row: Callable[[Row], None] | None = None) -> dict[str, Row]:
    """Compute all points of a plan in a store of their own: stored results must not vouch for themselves."""
    with (
        tempfile.TemporaryDirectory(prefix="fracbench-check-") as folder,
        Store(Path(folder) / "store.sqlite") as store,
    ):
        return execute.run(plan, store, jobs=jobs, on_row=on_row).rows


def reference_table(plan: Plan, rows: Mapping[str, Row], tabulate: Tabulate) -> pd.DataFrame:
    """Return the columns of a tidy table that are stored: labels, swept keys, errors, counts; all as text.

    A cell that has no value is empty, such as alpha for a method without; rows then equal are one.
    """
    import pandas as pd

    table = tabulate(plan, rows)
    keys = _key_columns(plan, table)
    kept = table[[*keys, *MEASURED, *COUNTED]].copy()
    for column in MEASURED:
        kept[column] = [f"{value:.9g}" for value in kept[column]]
    return kept.map(lambda value: "" if pd.isna(value) else str(value)).drop_duplicates(ignore_index=True)


def _key_columns(plan: Plan, table: pd.DataFrame) -> list[str]:
    labels = [name for name in ("part", "protocol", "sequence", "region", "method") if name in table.columns]
    swept = [key.removeprefix("params.") for key in plan.varying]
    return labels + [key for key in swept if key in table.columns and key not in labels]


def compare(name: str, stored: pd.DataFrame, found: pd.DataFrame, tolerances: Mapping[str, Tolerance]) -> Verdict:
    """Compare two reference tables cell by cell.

    Parameters
    ----------
    name : str
        For the verdict.
    stored, found : pandas.DataFrame
        Text, as `reference_table` gives and ``read_csv(dtype=str)`` reads.
    tolerances : mapping of str to Tolerance
        By column.

    Returns
    -------
    Verdict
        A missing, extra or incomparable row, column or cell is a difference, never a pass.
    """
    verdict = Verdict(name)
    for column in stored.columns.symmetric_difference(found.columns):
        side = ("present", "missing") if column in stored.columns else ("missing", "present")
        verdict.differences.append(Difference("all rows", str(column), *side, "the same columns"))
    values = [*MEASURED, *COUNTED]
    keys = [column for column in stored.columns if column not in values and column in found.columns]
    old, new = (_by_key(table, keys) for table in (stored, found))
    if len(old) != len(stored) or len(new) != len(found):
        verdict.differences.append(Difference("all rows", "keys", len(stored), len(found), "distinct rows"))
    for row in dict.fromkeys([*old, *new]):
        label = ", ".join(part for part in row if part)
        if row not in old or row not in new:
            side = ("present", "missing") if row in old else ("missing", "present")
            verdict.differences.append(Difference(label, "row", *side, "the same rows"))
            continue
        for column in values:
            verdict.cells += 1
            verdict.differences += _cell(label, column, old[row].get(column), new[row].get(column), tolerances)
    return verdict


def _by_key(table: pd.DataFrame, keys: list[str]) -> dict[tuple[str, ...], dict[str, str]]:
    return {tuple(record[key] for key in keys): record for record in table.to_dict("records")}


def _cell(
    label: str, column: str, stored: str | None, found: str | None, tolerances: Mapping[str, Tolerance]
) -> list[Difference]:
    if column in COUNTED or stored is None or found is None:
        same = stored == found and stored is not None
        return [] if same else [Difference(label, column, stored, found, "equal")]
    tolerance = tolerances[column]
    allowed = f"{tolerance.absolute:g} + {tolerance.relative:g} of the stored"
    old, new = _number(stored), _number(found)
    return [] if tolerance.allows(old, new) else [Difference(label, column, stored, found, allowed)]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def load_tolerances() -> dict[str, Tolerance]:
    """Read ``results/reference/tolerances.toml``.

    Returns
    -------
    dict of str to Tolerance
        One for each measured column.

    Raises
    ------
    InputError
        Not TOML, a column without tolerance, or a tolerance without basis and reason.
    """
    path = asset("results/reference/tolerances.toml")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        tolerances = {column: Tolerance(**raw[column]) for column in MEASURED}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise InputError(
            f"{path}: each of {', '.join(MEASURED)} needs absolute, relative, basis, reason: {exc}"
        ) from exc
    return tolerances


def update(
    name: str, reason: str, *, jobs: int, tabulate: Tabulate, on_row: Callable[[Row], None] | None = None
) -> list[Path]:
    """Rewrite a stored table, and record why.

    Parameters
    ----------
    name : str
        The stored table; a new one if there is an experiment of that name.
    reason : str
        Why the numbers may differ from now on.
    jobs, tabulate, on_row
        See `check`.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        No reason, no data, failed points, or no checkout to write to.
    """
    from fracbench.data.files import atomic_path

    if not reason.strip():
        raise InputError('check --update needs --reason "why the stored numbers change"')
    if checkout() is None:
        raise InputError("check --update: there is no checkout to write to; stored tables are part of one")
    plan = plan_of(name)
    if plan is None:
        raise InputError(f"{name}: the Middlebury data cannot be had here")
    folder = asset("results/reference")
    history = folder / f"{name}.json"
    entries = _entries(history)
    rows = recompute(plan, jobs, on_row)
    failed = [row for row in rows.values() if row.status != "done"]
    if failed:
        raise InputError(
            f"{name}: {len(failed)} points are not done (first: {failed[0].error}); nothing was written"
        )
    entries.append(_entry(reason, next(iter(rows.values()))))
    contents = {
        folder / f"{name}.csv": reference_table(plan, rows, tabulate).to_csv(index=False, lineterminator="\n"),
        history: json.dumps(entries, indent=2, sort_keys=True) + "\n",
    }
    for path, text in contents.items():
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(contents)


def _entries(history: Path) -> list[Any]:
    try:
        entries: list[Any] = json.loads(history.read_text(encoding="utf-8")) if history.is_file() else []
    except (OSError, ValueError) as exc:
        raise InputError(f"{history}: cannot be read as JSON: {exc}") from exc
    return entries


def _entry(reason: str, row: Row) -> dict[str, Any]:
    origin = {key: row.provenance.get(key) for key in ("cpu", "python", "versions", "threads")}
    return {
        "reason": reason,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "solver_version": SOLVER_VERSION,
        **origin,
        **provenance.commit(),
    }
