"""Comparison of two runs cell by cell: the rows of two stores, or the stored tables of two commits."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError
from fracbench.harness.check import regression
from fracbench.harness.check.regression import COUNTED, Difference, Verdict
from fracbench.harness.check.tolerances import MEASURED, Tolerances
from fracbench.harness.config.paths import checkout
from fracbench.harness.run import provenance
from fracbench.harness.run.store import Row, Store

if TYPE_CHECKING:
    import pandas as pd

_FOLDER = "results/reference"
_STORES = ("store.sqlite", "runs/store.sqlite", "results/runs/store.sqlite")


@dataclass(frozen=True)
class Side:
    """One side of a comparison: the rows of a store, or the stored tables of a commit."""

    title: str
    rows: Mapping[str, Row] | None  #: by identity, which does not depend on the solver's version or the machine
    tables: Mapping[str, pd.DataFrame]  #: by name, every cell as text


def open_side(text: str) -> Side:
    """Read one side: a store or folder of results, ``STORE@COMMIT`` for its rows of one commit, or a commit.

    Of a store, the newest row of each point counts; of a commit, the tables under ``results/reference``.
    """
    place, at, commit = text.rpartition("@")
    path = _store_file(text)
    if path is not None:
        return _side_of_store(path, "")
    if at and (path := _store_file(place)) is not None:
        return _side_of_store(path, commit)
    return _side_of_commit(text)


def _store_file(text: str) -> Path | None:
    path = Path(text)
    return next((file for file in (path, *(path / name for name in _STORES)) if file.is_file()), None)


def _side_of_store(path: Path, commit: str) -> Side:
    with Store(path, readonly=True) as store:
        rows = sorted(store.rows(), key=lambda row: row.created)
    wanted = [row for row in rows if str(row.provenance.get("commit") or "").startswith(commit)]
    if not wanted:
        known = ", ".join(sorted({str(row.provenance.get("commit"))[:12] for row in rows})) or "none"
        which = f"holds no row of commit {commit!r} (there are: {known})" if commit else "holds no rows"
        raise InputError(f"store {path}: {which}")
    versions = ", ".join(sorted({str(row.solver_version) for row in wanted}))
    newest = {row.identity: row for row in wanted}
    of = f" of commit {commit}" if commit else ""
    return Side(f"store {path}{of}: {len(newest)} points, solver version {versions}", newest, {})


def _side_of_commit(text: str) -> Side:
    import pandas as pd

    root = checkout()
    if root is None:
        raise InputError(f"{text!r} is no store, and there is no checkout whose commit it could be")
    try:
        words = ("rev-parse", "--verify", "--quiet", "--end-of-options", f"{text}^{{commit}}")
        commit = provenance.git(root, *words)
        files = provenance.git(root, "ls-tree", "--name-only", commit, f"{_FOLDER}/").splitlines()
        tables = {
            Path(file).stem: pd.read_csv(
                io.StringIO(provenance.git(root, "show", f"{commit}:{file}")), dtype=str, keep_default_na=False
            )
            for file in files
            if file.endswith(".csv")
        }
    except (OSError, subprocess.SubprocessError) as exc:
        raise InputError(f"{text!r} is neither a store nor a commit of {root}") from exc
    except ValueError as exc:
        raise InputError(f"commit {text}: a stored table cannot be read: {' '.join(str(exc).split())}") from exc
    if not tables:
        raise InputError(f"commit {text}: there are no tables under {_FOLDER}")
    return Side(f"commit {commit[:12]}: {len(tables)} stored tables", None, tables)


def compare_sides(first: Side, second: Side, tolerances: Tolerances) -> list[Verdict]:
    """Compare two stores or two commits table by table, a store being one table.

    A table, row or column that only one side has is a difference.
    """
    if (first.rows is None) != (second.rows is None):
        raise InputError("compare: one is a store and the other a commit; compare two of a kind")
    one, other = first.tables, second.tables
    if first.rows is not None and second.rows is not None:
        labels = label_points({**first.rows, **second.rows}.values())
        one, other = ({"points": _table(rows, labels)} for rows in (first.rows, second.rows))
    return [_compare(name, one.get(name), other.get(name), tolerances) for name in dict.fromkeys([*one, *other])]


def _compare(name: str, one: pd.DataFrame | None, other: pd.DataFrame | None, tolerances: Tolerances) -> Verdict:
    if one is None or other is None:
        side = ("missing", "present") if one is None else ("present", "missing")
        return Verdict(name, differences=[Difference("all rows", "table", *side, "the same tables")])
    return regression.compare(name, one, other, tolerances)


def _table(rows: Mapping[str, Row], labels: Mapping[str, str]) -> pd.DataFrame:
    """Return the rows of a store in the form of a stored table."""
    import pandas as pd

    def cells(row: Row) -> dict[str, str]:
        measured = {column: _text(row.result.get(column), ".9g") for column in MEASURED}
        counted = {column: _text(row.result.get(column)) for column in COUNTED}
        return {"point": labels[row.identity], **measured, **counted, "status": row.status}

    return pd.DataFrame([cells(row) for row in rows.values()], columns=["point", *MEASURED, *COUNTED])


def _text(value: Any, form: str = "") -> str:
    return "" if value is None else format(value, form)


def label_points(rows: Iterable[Row]) -> dict[str, str]:
    """Return labels of points by identity: sequence, method, the parameters that differ, the identity's head."""
    specs = {row.identity: row.spec for row in rows}
    values: dict[str, set[str]] = {}
    for spec in specs.values():
        for name, value in spec.get("params", {}).items():
            values.setdefault(name, set()).add(str(value))
    return {identity: f"{_describe(spec, values)} #{identity[:8]}" for identity, spec in specs.items()}


def _describe(spec: Mapping[str, Any], values: Mapping[str, set[str]]) -> str:
    box = "" if spec.get("box") is None else "[{}:{}, {}:{}]".format(*spec["box"])
    swept = [f"{name}={value}" for name, value in spec.get("params", {}).items() if len(values[name]) > 1]
    return " ".join([f"{spec.get('sequence')}{box}", str(spec.get("method")), *swept])
