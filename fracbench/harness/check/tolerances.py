"""The tolerances between recomputed and stored cells: ``results/reference/tolerances.toml``.

Each column has one relative tolerance, and a short list of ill-conditioned rows has wider ones. `derive` computes
the numbers from the spreads under ``results/reference/spread``, which ``tools/spread.py`` measures; only the
reasons are typed.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
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
#: Tolerance over measured spread: no measurement has met every machine.
MARGIN = 3.0
#: The largest relative tolerance of a column: rows that need more are ill-conditioned, and listed as such.
#: A change of theta by 1 % is no longer seen in a rendered scene where those of aae and aepe are 0.01.
WIDEST = {"aae": 0.005, "aepe": 0.005, "sdae": 0.01}
#: Stands where a person has to write why some rows are ill-conditioned.
NO_REASON = "not known yet"
_SMALLEST = 1e-5

_HEAD = f"""\
# How far a recomputed cell may be from the stored one. A difference passes if it is at most
# absolute + relative * |stored|. Counts must be equal.
# `basis` says where the number comes from; `reason` says why a difference of that size is no change.
# [[rows]]: ill-conditioned rows of a stored table (`*` stands for any text) and their wider relative tolerances,
# {MARGIN:g} times their largest spread, rounded up to one digit.
# Written by `python tools/spread.py --update`, which measures the spreads under spread/; only the reasons
# are typed, and stay.
"""
_FORM = (
    "each of {} needs absolute, relative, basis, reason, and each [[rows]] table, rows, relative (a column's or "
    "several), reason"
)


@dataclass(frozen=True)
class Tolerance:
    """The bound on the difference of a cell, its basis, and why such a difference is no change."""

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
        """Tell whether `found` is close enough to `stored`; values that are not finite never are."""
        return math.isfinite(stored) and abs(found - stored) <= self.absolute + self.relative * abs(stored)

    def __str__(self) -> str:
        return f"{self.absolute:g} + {self.relative:g} of the stored"


@dataclass(frozen=True)
class IllConditioned:
    """Rows of a stored table whose errors move further than those of others, and their relative tolerances."""

    table: str
    rows: str  #: pattern of the rows' labels, with ``*`` for any text
    relative: Mapping[str, float]  #: by column, in place of the column's own
    reason: str

    def __post_init__(self) -> None:
        if not self.relative or not self.relative.keys() <= set(MEASURED):
            raise ValueError(f"{self.table}, {self.rows}: relative tolerances of {', '.join(self.relative)}")
        for relative in self.relative.values():
            Tolerance(0.0, relative, self.rows, self.reason)

    def holds(self, table: str, row: str) -> bool:
        """Tell whether a row is one of these."""
        return table == self.table and fnmatchcase(row, self.rows)


@dataclass(frozen=True)
class Tolerances:
    """The tolerance of each measured column, and the ill-conditioned rows."""

    columns: Mapping[str, Tolerance]
    rows: Sequence[IllConditioned] = ()

    def of(self, table: str, row: str, column: str) -> Tolerance:
        """Return the tolerance of one cell."""
        own = [some.relative[column] for some in self.rows if column in some.relative and some.holds(table, row)]
        return replace(self.columns[column], relative=max(own)) if own else self.columns[column]


def load_tolerances() -> Tolerances:
    """Read the tolerances; refuse a column without tolerance, and a tolerance without basis and reason."""
    path = asset("results/reference/tolerances.toml")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        columns = {column: Tolerance(**raw[column]) for column in MEASURED}
        return Tolerances(columns, tuple(IllConditioned(**rows) for rows in raw.get("rows", [])))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise InputError(f"{path}: {_FORM.format(', '.join(MEASURED))}: {exc}") from exc


def load_spreads() -> dict[str, pd.DataFrame]:
    """Read the spreads by stored table: columns ``row``, ``column``, and the relative spread per circumstance."""
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


def derive(spreads: Mapping[str, pd.DataFrame], typed: Tolerances) -> Tolerances:
    """Return the tolerances that follow from the spreads (see `load_spreads`), with the reasons of `typed`.

    The spread of a cell is its largest under any circumstance; the cell needs a tolerance of `MARGIN` times that,
    rounded up. Rows whose labels differ in the last value only (the points of a curve, the methods of a sequence)
    are judged together: if one needs more than `WIDEST`, all are ill-conditioned in that column and get the
    tolerance that covers them. A column's tolerance covers all other cells. A spread that is not finite is a
    `ValueError`.
    """
    groups: dict[tuple[str, str], dict[str, list[float]]] = {}
    for name, table in spreads.items():
        for record in table.to_dict("records"):
            row, column = str(record.pop("row")), str(record.pop("column"))
            head = row.rpartition(", ")[0]
            group = groups.setdefault((name, f"{head}, *" if head else row), {})
            group.setdefault(column, []).append(max(record.values()))
    reasons = {(some.table, some.rows): some.reason for some in typed.rows}
    columns, wide = {}, {key: dict[str, float]() for key in groups}
    for column in MEASURED:
        needed = {key: rounded_up(MARGIN * max(group[column])) for key, group in groups.items()}
        for key, relative in needed.items():
            if relative > WIDEST[column]:
                wide[key][column] = relative
        usual = [value for key, group in groups.items() if column not in wide[key] for value in group[column]]
        n_wide = sum(len(group[column]) for group in groups.values()) - len(usual)
        largest = max(usual, default=0.0)
        basis = (
            f"{MARGIN:g} times {largest:.1e}, the largest relative spread of {len(usual)} cells "
            f"({', '.join(spreads)}), rounded up to one digit; {n_wide} cells are in ill-conditioned rows"
        )
        columns[column] = Tolerance(ABSOLUTE, rounded_up(MARGIN * largest), basis, typed.columns[column].reason)
    rows = [IllConditioned(*key, own, reasons.get(key, NO_REASON)) for key, own in wide.items() if own]
    return Tolerances(columns, tuple(rows))


def rounded_up(value: float) -> float:
    """Return a spread rounded up to one digit, 1e-5 at least."""
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"a spread must be finite and at least 0, got {value}")
    value = float(f"{max(value, _SMALLEST):.6g}")  # 3 times 0.0002 is more than 0.0006
    exponent = math.floor(math.log10(value))
    steps = (float(f"{digit}e{exponent + more}") for more in (-1, 0, 1) for digit in range(1, 10))
    return next(step for step in steps if step >= value)


def outdated(names: Iterable[str], solver_version: int) -> list[str]:
    """Return the tables whose spread was not measured with this version of the solver."""
    folder = asset("results/reference") / "spread"

    def version(name: str) -> Any:
        try:
            return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))["solver_version"]
        except (OSError, ValueError, KeyError, TypeError):
            return None

    return [name for name in names if version(name) != solver_version]


def write(spreads: Mapping[str, pd.DataFrame], origin: Mapping[str, Any]) -> list[Path]:
    """Write spreads with their origin, and the tolerances that follow from all spreads; return the files.

    Stored spreads of the same solver version stay where this machine could not measure them. Nothing is written if
    a file cannot be read, or if no tolerance follows.
    """
    path = asset("results/reference/tolerances.toml")
    typed = load_tolerances()
    old = load_spreads()
    kept = old.keys() - outdated(old, origin["solver_version"])
    spreads = {name: _completed(new, old[name]) if name in kept else new for name, new in spreads.items()}
    try:
        tolerances = derive(dict(sorted({**old, **spreads}.items())), typed)
    except ValueError as exc:
        raise InputError(f"{path}: no tolerance follows from the measured spreads: {exc}") from exc
    folder = path.parent / "spread"
    folder.mkdir(exist_ok=True)
    contents = {
        folder / f"{name}.csv": table.to_csv(index=False, lineterminator="\n", float_format="%.3g")
        for name, table in spreads.items()
    }
    record = json.dumps(dict(origin), indent=2, sort_keys=True) + "\n"
    contents |= {folder / f"{name}.json": record for name in spreads}
    contents[path] = to_toml(tolerances)
    return write_texts(contents)


def write_texts(contents: Mapping[Path, str]) -> list[Path]:
    """Write each text to its file, which appears whole or not at all; return the files."""
    from fracbench.data.files import atomic_path

    for path, text in contents.items():
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(contents)


def _completed(new: pd.DataFrame, old: pd.DataFrame) -> pd.DataFrame:
    """Return `new` with the circumstances that only `old` has; their spread is 0 for new rows."""
    labels = ["row", "column"]
    lacking = [column for column in old if column not in new]
    return new.merge(old[[*labels, *lacking]], on=labels, how="left").fillna(dict.fromkeys(lacking, 0.0))


def to_toml(tolerances: Tolerances) -> str:
    """Return the text of ``tolerances.toml``."""
    blocks = [_block(f"[{column}]", vars(tolerance)) for column, tolerance in tolerances.columns.items()]
    blocks += [_block("[[rows]]", vars(some)) for some in tolerances.rows]
    return "\n".join([_HEAD, *blocks])


def _block(title: str, values: Mapping[str, Any]) -> str:
    return "\n".join([title, *(f"{key} = {_value(value)}" for key, value in values.items()), ""])


def _value(value: Any) -> str:
    """Return a value as TOML text, which is JSON for texts and finite numbers."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_value(own)}' for key, own in value.items())} }}"
    return json.dumps(value)
