"""The regression check: recompute the tables under ``results/reference`` and compare them cell by cell."""

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
from fracbench.harness.check.tolerances import MEASURED, Tolerance, Tolerances, load_tolerances, write_texts
from fracbench.harness.config.experiment import load_experiment
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
    """The result of comparing one stored table; it holds if there are no differences."""

    name: str
    cells: int = 0  #: compared
    differences: list[Difference] = field(default_factory=list)
    skipped: str = ""  #: why the table was not compared; empty if it was


def stored_tables() -> list[str]:
    """Return the names of the stored tables, also of one whose record alone is left."""
    folder = asset("results/reference")
    return sorted({path.stem for pattern in ("*.csv", "*.json") for path in folder.glob(pattern)})


def wanted_tables(names: Sequence[str]) -> list[str]:
    """Return the stored tables of these names, all if there are none; refuse an unknown name."""
    tables = stored_tables()
    for name in names:
        if name not in tables:
            raise unknown_name("stored table", name, tables)
    if not tables:
        raise InputError("check: there is no stored table under results/reference")
    return list(names) or tables


def check(name: str, *, jobs: int, on_row: Callable[[Row], None] | None = None) -> Verdict:
    """Recompute a stored table on `jobs` worker processes and compare it; `on_row` is called with each row.

    The table is skipped, with the reason, where Middlebury cannot be had.
    """
    wanted_tables([name])
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
    """Return the plan behind a stored table, or None where its data cannot be had.

    The name is an experiment's, followed by ``_synthetic`` for the rendered scenes.
    """
    base = name.removesuffix("_synthetic")
    dataset = "synthetic" if base != name else "auto"
    plan = plan_experiment(load_experiment(base).grids, [f"dataset={dataset}"])
    return None if plan.stand_in and dataset == "auto" else plan


def recompute(plan: Plan, jobs: int, on_row: Callable[[Row], None] | None = None) -> dict[str, Row]:
    """Compute all points of a plan in an empty store: stored results must not vouch for themselves."""
    with (
        tempfile.TemporaryDirectory(prefix="fracbench-check-") as folder,
        Store(Path(folder) / "store.sqlite") as store,
    ):
        return dict(sweep.run(plan, store, jobs=jobs, on_row=on_row).rows)


def reference_table(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return the stored columns of a tidy table as text: labels, swept keys, errors, counts.

    A cell without a value, such as alpha for a method without it, is empty; rows that are equal then are merged.
    """
    import pandas as pd

    table = tidy(plan, rows)
    keys = _key_columns(plan, table)
    kept = table[[*keys, *MEASURED, *COUNTED]].copy()
    for column in MEASURED:
        kept[column] = [f"{value:.9g}" for value in kept[column]]
    kept = kept.astype(object)  # pandas 2 maps whole numbers as floats where one is missing
    return kept.map(lambda value: "" if pd.isna(value) else str(value)).drop_duplicates(ignore_index=True)


def _key_columns(plan: Plan, table: pd.DataFrame) -> list[str]:
    labels = [name for name in ("part", "protocol", "sequence", "region", "method") if name in table.columns]
    swept = [key.removeprefix("params.") for key in plan.varying]
    return labels + [key for key in swept if key in table.columns and key not in labels]


def compare(name: str, stored: pd.DataFrame, found: pd.DataFrame, tolerances: Tolerances) -> Verdict:
    """Compare two reference tables, whose cells are text.

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
        # Without a true flow no pixel is scored, and there are no errors to compare.
        unscored = all(cells.get("n_pixels") == "0" and cells.get("aae") == "" for cells in (old[row], new[row]))
        for column in COUNTED if unscored else (*MEASURED, *COUNTED):
            verdict.cells += 1
            allowed = tolerances.of(name, row, column) if column in MEASURED else None
            verdict.differences += _cell(row, column, old[row].get(column), new[row].get(column), allowed)
    return verdict


def key_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns of a reference table that name its rows: labels and swept keys."""
    return [column for column in table.columns if column not in (*MEASURED, *COUNTED)]


def by_label(table: pd.DataFrame, keys: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the rows of a reference table by their labels: the values of `keys` that are not empty."""
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


def update(name: str, reason: str, *, jobs: int) -> list[Path]:
    """Rewrite the stored table of an experiment, which may be new, and record the reason; return the files."""
    if not reason.strip():
        raise InputError('check --update needs --reason "why the stored numbers change"')
    require_checkout()
    plan = plan_of(name)
    if plan is None:
        raise InputError(f"{name}: the Middlebury data cannot be had here")
    folder = asset("results/reference")
    entries = history(name)
    rows = recompute(plan, jobs)
    failed = [row for row in rows.values() if row.status != "done"]
    if failed:
        raise InputError(
            f"{name}: {len(failed)} points are not done (first: {failed[0].error}); nothing was written"
        )
    workers = next(iter(rows.values())).provenance
    computed = {key: workers.get(key) for key in ("cpu", "python", "versions", "threads")}
    entries.append({"reason": reason, **origin(), **computed})
    contents = {
        folder / f"{name}.csv": reference_table(plan, rows).to_csv(index=False, lineterminator="\n"),
        folder / f"{name}.json": json.dumps(entries, indent=2, sort_keys=True) + "\n",
    }
    return write_texts(contents)


def require_checkout() -> None:
    """Refuse to rewrite stored tables outside a checkout."""
    if checkout() is None:
        raise InputError("check --update: there is no checkout to write to; stored tables are part of one")


def history(name: str) -> list[Any]:
    """Return the records of a stored table's updates; the last belongs to its numbers."""
    path = asset("results/reference") / f"{name}.json"
    try:
        entries: list[Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    except (OSError, ValueError) as exc:
        raise InputError(f"{path}: cannot be read as JSON: {exc}") from exc
    return entries


def origin() -> dict[str, Any]:
    """Return the origin of numbers computed now: date, solver version, machine, versions, commit."""
    machine = {key: provenance.machine()[key] for key in ("cpu", "python", "versions")}
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    return {"date": date, "solver_version": SOLVER_VERSION, **machine, **provenance.commit()}
