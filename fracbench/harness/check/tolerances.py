"""How far a recomputed cell may be from the stored one: ``results/reference/tolerances.toml``.

Its numbers follow, by the rule of `derive`, from the spreads under ``results/reference/spread``, which
``tools/spread.py`` measures; nothing in it is typed by hand but the reasons.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError
from fracbench.harness.config.paths import asset

if TYPE_CHECKING:
    import pandas as pd

#: Columns compared within a tolerance.
MEASURED = ("aae", "aepe", "sdae")
#: Radians and pixels: a difference that no printed table shows.
ABSOLUTE = 1e-6
#: How many times the spread is let pass: no measurement has met every machine.
MARGIN = 3.0
#: The share of rows whose spread the column's tolerance covers; each row beyond has one of its own.
COVERED = 0.9
_SMALLEST = 1e-5

_HEAD = """\
# How far a recomputed cell may be from the stored one. A difference passes if it is at most
# absolute + relative * |stored|. Counts must be equal.
# `basis` says what the number rests on; `reason` says why a difference of that size is no change.
# [[cell]]: cells of the stored tables that need a wider tolerance than their column.
# Written by `python tools/spread.py --update`, which measures the spreads under spread/; only the reasons
# are typed, and stay.
"""
_FORM = "each of {} needs absolute, relative, basis, reason, and each [[cell]] table, row, column, relative"


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

    def __str__(self) -> str:
        return f"{self.absolute:g} + {self.relative:g} of the stored"


@dataclass(frozen=True)
class Tolerances:
    """The tolerance of each column, and the relative ones of the cells that need a wider one.

    Attributes
    ----------
    columns : mapping of str to Tolerance
        By measured column.
    cells : mapping of (str, str, str) to float
        By table, row and column.
    """

    columns: Mapping[str, Tolerance]
    cells: Mapping[tuple[str, str, str], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for table, row, column in self.cells:
            self.of(table, row, column)

    def of(self, table: str, row: str, column: str) -> Tolerance:
        """Return the tolerance of one cell."""
        general = self.columns[column]
        return replace(general, relative=self.cells.get((table, row, column), general.relative))


def load_tolerances() -> Tolerances:
    """Read the tolerances.

    Returns
    -------
    Tolerances
        One for each measured column, and those of single cells.

    Raises
    ------
    InputError
        Not TOML, a column without tolerance, or a tolerance without basis and reason.
    """
    path = asset("results/reference/tolerances.toml")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        columns = {column: Tolerance(**raw[column]) for column in MEASURED}
        cells = {
            (str(cell["table"]), str(cell["row"]), str(cell["column"])): cell["relative"]
            for cell in raw.get("cell", [])
        }
        return Tolerances(columns, cells)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise InputError(f"{path}: {_FORM.format(', '.join(MEASURED))}: {exc}") from exc


def load_spreads() -> dict[str, pd.DataFrame]:
    """Read the spreads under ``results/reference/spread``.

    Returns
    -------
    dict of str to pandas.DataFrame
        By stored table; columns ``row``, ``column``, and the relative spread under each circumstance.

    Raises
    ------
    InputError
        A file that is no such table.
    """
    import pandas as pd

    found = {}
    for path in sorted((asset("results/reference") / "spread").glob("*.csv")):
        try:
            table = pd.read_csv(path).set_index(["row", "column"]).astype(float).reset_index()
            if table.shape[1] < 3:
                raise ValueError("no circumstance")
        except (OSError, ValueError, KeyError) as exc:
            why = " ".join(str(exc).split())
            raise InputError(
                f"{path}: no table of spreads ({why}); `python tools/spread.py --update` writes it"
            ) from exc
        found[path.stem] = table
    return found


def derive(spreads: Mapping[str, pd.DataFrame], reasons: Mapping[str, str]) -> Tolerances:
    """Return the tolerances that follow from the spreads.

    The spread of a cell is its largest under any circumstance. A column's relative tolerance is `MARGIN` times
    the spread that a share of `COVERED` of all its cells does not exceed, rounded up (`rounded_up`); a
    cell whose own spread asks for more has its own, by the same rule.

    Parameters
    ----------
    spreads : mapping of str to pandas.DataFrame
        See `load_spreads`.
    reasons : mapping of str to str
        By column.

    Returns
    -------
    Tolerances
        For every measured column, with the basis of each.

    Raises
    ------
    ValueError
        A spread is not finite: there is a cell that nothing can be compared with.
    """
    import numpy as np

    columns, cells = {}, {}
    for column in MEASURED:
        largest = {
            (name, str(record["row"])): max(value for key, value in record.items() if key not in ("row", "column"))
            for name, table in spreads.items()
            for record in table[table["column"] == column].to_dict("records")
        }
        usual = float(np.quantile([*largest.values()], COVERED, method="inverted_cdf"))
        general = rounded_up(MARGIN * usual)
        wide = {cell: rounded_up(MARGIN * spread) for cell, spread in largest.items()}
        own = {(*cell, column): relative for cell, relative in wide.items() if relative > general}
        basis = (
            f"{MARGIN:g} times {usual:.1e}, the relative spread that {COVERED:.0%} of {len(largest)} cells "
            f"({', '.join(spreads)}) do not exceed, rounded up to 1, 2 or 5 in its decade; "
            f"{len(own)} cells have their own"
        )
        columns[column] = Tolerance(ABSOLUTE, general, basis, reasons[column])
        cells.update(own)
    return Tolerances(columns, cells)


def rounded_up(value: float) -> float:
    """Return the next of 1, 2 and 5 times a power of ten, and 1e-5 at least.

    Raises
    ------
    ValueError
        The value is not finite, or negative.
    """
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"a spread must be finite and at least 0, got {value}")
    value = max(value, _SMALLEST)
    exponent = math.floor(math.log10(value))
    steps = (float(f"{digit}e{exponent + more}") for more in (-1, 0, 1) for digit in (1, 2, 5))
    return next(step for step in steps if step >= value)


def outdated(names: Iterable[str], solver_version: int) -> list[str]:
    """Return the stored tables whose spread was never measured, or with another version of the numerics."""
    folder = asset("results/reference") / "spread"

    def version(name: str) -> Any:
        try:
            return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))["solver_version"]
        except (OSError, ValueError, KeyError, TypeError):
            return None

    return [name for name in names if version(name) != solver_version]


def write(spreads: Mapping[str, pd.DataFrame], origin: Mapping[str, Any]) -> list[Path]:
    """Write spreads, and the tolerances that follow from them and from those of the other tables.

    Spreads of the same numerics that could not be measured this time, which another machine has, stay.

    Parameters
    ----------
    spreads : mapping of str to pandas.DataFrame
        By stored table; see `load_spreads`.
    origin : mapping
        With what they were measured; written beside each.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        A file there is cannot be read, or no tolerance follows; nothing is written then.
    """
    from fracbench.data.files import atomic_path

    path = asset("results/reference/tolerances.toml")
    reasons = {column: tolerance.reason for column, tolerance in load_tolerances().columns.items()}
    old = load_spreads()
    kept = old.keys() - outdated(old, origin["solver_version"])
    spreads = {name: _completed(new, old[name]) if name in kept else new for name, new in spreads.items()}
    try:
        tolerances = derive(dict(sorted({**old, **spreads}.items())), reasons)
    except ValueError as exc:
        raise InputError(f"{path}: no tolerance follows from what was measured: {exc}") from exc
    folder = path.parent / "spread"
    folder.mkdir(exist_ok=True)
    contents = {
        folder / f"{name}.csv": table.to_csv(index=False, lineterminator="\n", float_format="%.3g")
        for name, table in spreads.items()
    }
    record = json.dumps(dict(origin), indent=2, sort_keys=True) + "\n"
    contents |= {folder / f"{name}.json": record for name in spreads}
    contents[path] = to_toml(tolerances)
    for file, text in contents.items():
        with atomic_path(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(contents)


def _completed(new: pd.DataFrame, old: pd.DataFrame) -> pd.DataFrame:
    """Return the spreads in `new` and, of circumstances that it lacks, those in `old`; 0 for rows that are new."""
    labels = ["row", "column"]
    lacking = [column for column in old if column not in new]
    return new.merge(old[[*labels, *lacking]], on=labels, how="left").fillna(dict.fromkeys(lacking, 0.0))


def to_toml(tolerances: Tolerances) -> str:
    """Return the text of ``tolerances.toml``."""
    blocks = [_block(f"[{column}]", vars(tolerance)) for column, tolerance in tolerances.columns.items()]
    for (table, row, column), relative in tolerances.cells.items():
        cell = {"table": table, "row": row, "column": column, "relative": relative}
        blocks.append(_block("[[cell]]", cell))
    return "\n".join([_HEAD, *blocks])


def _block(title: str, values: Mapping[str, Any]) -> str:
    # TOML writes texts and finite numbers as JSON does.
    return "\n".join([title, *(f"{key} = {json.dumps(value)}" for key, value in values.items()), ""])
