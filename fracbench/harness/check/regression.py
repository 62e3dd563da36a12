"""Did our numbers change? Recompute the tables under ``results/reference`` and compare cell by cell."""

from __future__ import annotations

import datetime
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError, unknown_name
from fracbench.harness.check.tolerances import MEASURED, Tolerance, Tolerances, load_tolerances
from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.config.paths import asset, checkout
from fracbench.harness.run import provenance, sweep
from fracbench.harness.run.plan import Plan, plan_experiment
from fracbench.harness.run.store import Row, Store
from fracbench.harness.run.tidy import tidy
from fracbench.model import SOLVER_VERSION

if TYPE_CHECKING:
    import pandas as pd

#: Columns that must be equal; those of `MEASURED` may differ within a tolerance.
COUNTED = ("n_pixels", "n_unknown", "n_nonfinite", "status")


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
    """Return the names of the stored tables; one of which only the record is left is among them."""
    folder = asset("results/reference")
    return sorted({path.stem for pattern in ("*.csv", "*.json") for path in folder.glob(pattern)})


def wanted_tables(names: Sequence[str]) -> list[str]:
    """Return the stored tables of some names, all if there are no names.

    Raises
    ------
    InputError
        An unknown name, or no table at all.
    """
    tables = stored_tables()
    for name in names:
        if name not in tables:
            raise unknown_name("stored table", name, tables)
    if not tables:
        raise InputError("check: there is no stored table under results/reference")
    return list(names) or tables


def check(name: str, *, jobs: int, on_row: Callable[[Row], None] | None = None) -> Verdict:
    """Recompute a stored table, all of it, and compare.

    Parameters
    ----------
    name : str
        A stored table: an experiment, with ``_synthetic`` behind it for the rendered scenes.
    jobs : int
        Worker processes.
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
    path, tolerances = asset("results/reference") / f"{name}.csv", load_tolerances()
    if not path.is_file():
        gone = Difference("all rows", "table", "missing", "present", "the same tables")
        return Verdict(name, differences=[gone])
    plan = plan_of(name)
    if plan is None:
        return Verdict(name, skipped="the Middlebury data cannot be had here")
    stored = read_table(path)
    found = reference_table(plan, recompute(plan, jobs, on_row))
    return compare(name, stored, found, tolerances)


def read_table(path: Path) -> pd.DataFrame:
    """Read a stored table, every cell as text."""
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
        return sweep.run(plan, store, jobs=jobs, on_row=on_row).rows


def reference_table(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return the columns of a tidy table that are stored: labels, swept keys, errors, counts; all as text.

    A cell that has no value is empty, such as alpha for a method without; rows then equal are one.
    """
    import pandas as pd

    table = tidy(plan, rows)
    keys = _key_columns(plan, table)
    kept = table[[*keys, *MEASURED, *COUNTED]].copy()
    for column in MEASURED:
        kept[column] = [f"{value:.9g}" for value in kept[column]]
    return kept.map(lambda value: "" if pd.isna(value) else str(value)).drop_duplicates(ignore_index=True)


def _key_columns(plan: Plan, table: pd.DataFrame) -> list[str]:
    labels = [name for name in ("part", "protocol", "sequence", "region", "method") if name in table.columns]
    swept = [key.removeprefix("params.") for key in plan.varying]
    return labels + [key for key in swept if key in table.columns and key not in labels]


def compare(name: str, stored: pd.DataFrame, found: pd.DataFrame, tolerances: Tolerances) -> Verdict:
    """Compare two reference tables cell by cell.

    Parameters
    ----------
    name : str
        For the verdict.
    stored, found : pandas.DataFrame
        Text, as `reference_table` gives and ``read_csv(dtype=str)`` reads.
    tolerances : Tolerances
        By column; single cells may have their own.

    Returns
    -------
    Verdict
        A missing, extra or incomparable row, column or cell is a difference, never a pass.
    """
    verdict = Verdict(name)
    for column in stored.columns.symmetric_difference(found.columns):
        side = ("present", "missing") if column in stored.columns else ("missing", "present")
        verdict.differences.append(Difference("all rows", str(column), *side, "the same columns"))
    keys = [column for column in key_columns(stored) if column in found.columns]
    old, new = by_label(stored, keys), by_label(found, keys)
    if len(old) != len(stored) or len(new) != len(found):
        verdict.differences.append(Difference("all rows", "keys", len(stored), len(found), "distinct rows"))
    for row in dict.fromkeys([*old, *new]):
        if row not in old or row not in new:
            side = ("present", "missing") if row in old else ("missing", "present")
            verdict.differences.append(Difference(row, "row", *side, "the same rows"))
            continue
        for column in (*MEASURED, *COUNTED):
            verdict.cells += 1
            allowed = tolerances.of(name, row, column) if column in MEASURED else None
            verdict.differences += _cell(row, column, old[row].get(column), new[row].get(column), allowed)
    return verdict


def key_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns of a reference table that name its rows: labels and swept keys."""
    return [column for column in table.columns if column not in (*MEASURED, *COUNTED)]


def by_label(table: pd.DataFrame, keys: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the rows of a reference table by what they are called, the values of `keys` that are not empty."""
    records = table.to_dict("records")
    return {", ".join(record[key] for key in keys if record[key]): record for record in records}


def _cell(
    label: str, column: str, stored: str | None, found: str | None, tolerance: Tolerance | None
) -> list[Difference]:
    if tolerance is None or stored is None or found is None:
        same = stored == found and stored is not None
        return [] if same else [Difference(label, column, stored, found, "equal")]
    holds = tolerance.allows(_number(stored), _number(found))
    return [] if holds else [Difference(label, column, stored, found, str(tolerance))]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def update(name: str, reason: str, *, jobs: int, on_row: Callable[[Row], None] | None = None) -> list[Path]:
    """Rewrite a stored table, and record why.

    Parameters
    ----------
    name : str
        The stored table; a new one if there is an experiment of that name.
    reason : str
        Why the numbers may differ from now on.
    jobs, on_row
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
    require_checkout()
    plan = plan_of(name)
    if plan is None:
        raise InputError(f"{name}: the Middlebury data cannot be had here")
    folder = asset("results/reference")
    entries = history(name)
    rows = recompute(plan, jobs, on_row)
    failed = [row for row in rows.values() if row.status != "done"]
    if failed:
        raise InputError(
            f"{name}: {len(failed)} points are not done (first: {failed[0].error}); nothing was written"
        )
    entries.append(_entry(reason, next(iter(rows.values()))))
    contents = {
        folder / f"{name}.csv": reference_table(plan, rows).to_csv(index=False, lineterminator="\n"),
        folder / f"{name}.json": json.dumps(entries, indent=2, sort_keys=True) + "\n",
    }
    for path, text in contents.items():
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(contents)


def require_checkout() -> None:
    """Refuse to rewrite what is stored where the package is installed."""
    if checkout() is None:
        raise InputError("check --update: there is no checkout to write to; stored tables are part of one")


def history(name: str) -> list[Any]:
    """Return the records of a stored table, the last of which is that of its numbers."""
    path = asset("results/reference") / f"{name}.json"
    try:
        entries: list[Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    except (OSError, ValueError) as exc:
        raise InputError(f"{path}: cannot be read as JSON: {exc}") from exc
    return entries


def _entry(reason: str, row: Row) -> dict[str, Any]:
    """Record why a table was stored, and with what the workers computed it."""
    computed = {key: row.provenance.get(key) for key in ("cpu", "python", "versions", "threads")}
    return {"reason": reason, **origin(), **computed}


def origin() -> dict[str, Any]:
    """Return what a stored file owes its numbers to: date, numerics, machine, versions, commit."""
    machine = {key: provenance.machine()[key] for key in ("cpu", "python", "versions")}
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    return {"date": date, "solver_version": SOLVER_VERSION, **machine, **provenance.commit()}
