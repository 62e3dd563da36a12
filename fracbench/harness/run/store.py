"""The store: one SQLite file with one row per point that was run, whether it ended well or not.

A row is committed as soon as its point is finished, so whatever stops a sweep loses only the points that were
under way. `fracbench.harness.run.sqlite` knows the file.
"""

from __future__ import annotations

import json
import math
import sqlite3
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from itertools import dropwhile, islice
from pathlib import Path
from typing import Any, Self

from fracbench.errors import FracbenchError, InputError, unknown_name
from fracbench.harness.run.sqlite import DAMAGED, STATUSES, explain, open_to_read, open_to_write, transaction

#: The folders of the store and of flows for pictures, below the results folder.
RUNS = "runs"
STORE = Path(RUNS) / "store.sqlite"

_JSON_COLUMNS = ("spec", "result", "provenance")
#: Types of the columns as they are read: SQLite itself keeps any type in any column.
_KINDS: Mapping[str, tuple[type, ...]] = {
    **dict.fromkeys(("key", "identity", "status", "created"), (str,)),
    **dict.fromkeys(("solver_version", "attempts"), (int,)),
    **dict.fromkeys(("seconds", "peak_mib"), (int, float, type(None))),
    **dict.fromkeys(_JSON_COLUMNS, (dict,)),
    "error": (str, type(None)),
}
_KEYS_PER_BLOCK = 2000
_KEYS_PER_QUERY = 500  # below the number of parameters that any SQLite accepts


class StoreError(FracbenchError):
    """The store could not be read or written: the disk is full, the file is damaged or locked."""


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, kw_only=True)
class Row:
    """The result of one point and its origin; numbers that are not finite come back as None, tuples as lists.

    The `key` hashes everything the result depends on, the `identity` the `spec` alone, without solver version and
    data: rows of one identity are the same point, run under different circumstances. `seconds` and `peak_mib` are
    None where they could not be measured.
    """

    key: str
    identity: str
    spec: Mapping[str, Any]
    solver_version: int
    status: str
    error: str | None = None
    result: Mapping[str, Any] = field(default_factory=dict)
    seconds: float | None = None
    peak_mib: float | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    attempts: int = 1
    created: str = field(default_factory=_now)

    def __post_init__(self) -> None:
        _known_status(self.status)

    def to_json(self) -> str:
        """Return the row as one line of JSON, with the values that the store would keep."""
        return canonical_json(_finite(vars(self)))

    @classmethod
    def from_json(cls, text: str) -> Row:
        """Return the row that `to_json` wrote; ValueError if it is none."""
        try:
            return cls(**json.loads(text))
        except (TypeError, InputError) as exc:
            raise ValueError(f"not a row: {exc}") from exc


#: A row as the store's columns hold it: the texts of JSON are not read.
Values = tuple[Any, ...]

_COLUMNS = tuple(f.name for f in fields(Row))
_SELECT = f"SELECT {', '.join(_COLUMNS)} FROM points"
_UPSERT = (
    f"INSERT INTO points ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' for _ in _COLUMNS)}) "
    f"ON CONFLICT (key) DO UPDATE SET {', '.join(f'{c} = excluded.{c}' for c in _COLUMNS[1:])} "
    "WHERE points.status != 'done' OR excluded.status = 'done'"
)


class Store:
    """An open store; use it in a ``with`` statement, in one thread.

    The file and its folder are created if they are not there; read-only nothing is created, and a store that is
    not there reads as an empty one. InputError: the file is no store, of another schema version, or cannot be
    opened; StoreError: SQLite fails later on.
    """

    def __init__(self, path: str | Path, *, readonly: bool = False) -> None:
        self.path = Path(path)
        self.readonly = readonly
        if self.path.is_dir():
            raise InputError(f"store {self.path}: is a folder; name a file in it")
        try:
            self._db = open_to_read(self.path) if readonly else open_to_write(self.path)
        except (OSError, sqlite3.Error, UnicodeDecodeError, MemoryError) as exc:
            raise InputError(f"store {self.path}: {explain(exc)}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        self._db.close()

    def get(self, key: str) -> Row | None:
        """Return the row of a key, or None."""
        return self.get_many([key]).get(key)

    def get_many(self, keys: Iterable[str]) -> dict[str, Row]:
        """Return the rows there are for these keys, by key."""
        wanted = list(dict.fromkeys(keys))
        found = self.get_encoded(wanted)
        return {key: self._decoded(found[key]) for key in wanted if key in found}

    def get_encoded(self, keys: Iterable[str]) -> dict[str, Values]:
        """Return the rows there are for these keys, by key, as the columns hold them."""
        found: dict[str, Values] = {}
        for chunk in _chunks(keys):
            marks = ", ".join("?" for _ in chunk)
            with self._translated():
                rows = self._db.execute(f"{_SELECT} WHERE key IN ({marks})", chunk).fetchall()
            found.update((row[0], row) for row in rows)
        return found

    def statuses(self, keys: Iterable[str]) -> Iterator[tuple[str, str]]:
        """Yield each key that has a row, and its status: one object for all rows of a status."""
        if self.is_empty():
            return
        known = {status: status for status in STATUSES}
        with self._translated():
            for chunk in _chunks(keys):
                marks = ", ".join("?" for _ in chunk)
                found = self._db.execute(f"SELECT key, status FROM points WHERE key IN ({marks})", chunk)
                yield from ((key, known.get(status, status)) for key, status in found)

    def is_empty(self) -> bool:
        """Tell whether there is no row."""
        with self._translated():
            return self._db.execute("SELECT 1 FROM points LIMIT 1").fetchone() is None

    def size(self) -> int:
        """Return the number of rows."""
        with self._translated():
            return int(self._db.execute("SELECT count(*) FROM points").fetchone()[0])

    def keys(self, status: str | None = None) -> Iterator[str]:
        """Yield the keys of all rows, or of those of one status, in no order."""
        condition = "" if status is None else "WHERE status = ?"
        given = [] if status is None else [_known_status(status)]
        with self._translated():
            yield from (key for (key,) in self._db.execute(f"SELECT key FROM points {condition}", given))

    def sample(self, status: str, count: int) -> list[Row]:
        """Return about as many rows of a status, evenly from the first to the last; all, if there are fewer."""
        step = -(-self.size() // count)
        return self._select(
            f"WHERE status = ? AND rowid % {step or 1} = 0 ORDER BY rowid", [_known_status(status)]
        )

    def identities(self) -> set[str]:
        """Return the identities of all rows."""
        with self._translated():
            return {identity for (identity,) in self._db.execute("SELECT DISTINCT identity FROM points")}

    def by_identity(self, identity: str) -> list[Row]:
        """Return every row of a point, oldest first: under other keys, why it has to be run again."""
        return self._select("WHERE identity = ? ORDER BY created, rowid", [identity])

    def rows(self, status: str | None = None) -> list[Row]:
        """Return all rows, or those of one status, in the order in which they were first written."""
        if status is None:
            return self._select("ORDER BY rowid", [])
        return self._select("WHERE status = ? ORDER BY rowid", [_known_status(status)])

    def counts(self) -> dict[str, int]:
        """Return the number of rows of every status, 0 included."""
        with self._translated():
            found = dict(self._db.execute("SELECT status, count(*) FROM points GROUP BY status"))
        return {status: found.get(status, 0) for status in STATUSES}

    def put(self, row: Row) -> bool:
        """Write a row in place of one with its key; False if it failed and there is a ``done`` one already."""
        values = encode(row)
        with self._transaction():
            return self._db.execute(_UPSERT, values).rowcount == 1

    def put_many(self, rows: Sequence[Values]) -> None:
        """Write encoded rows in one transaction, each as `put` does; StoreError: a value is of a wrong type."""
        try:
            for values in rows:
                _check_kinds(values, _ENCODED_KINDS)
        except ValueError as exc:
            raise StoreError(f"store {self.path}: not a row: {exc}") from exc
        with self._transaction():
            self._db.executemany(_UPSERT, rows)

    def _select(self, condition: str, parameters: Sequence[str]) -> list[Row]:
        with self._translated():
            found = self._db.execute(f"{_SELECT} {condition}", parameters).fetchall()
        return [self._decoded(values) for values in found]

    def _decoded(self, values: Values) -> Row:
        try:
            return decode(values)
        except ValueError as exc:
            raise StoreError(f"store {self.path}: {DAMAGED} ({exc})") from exc

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        if self.readonly:
            raise StoreError(f"store {self.path}: opened for reading only")
        with self._translated(), transaction(self._db):
            yield

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError, MemoryError) as exc:
            raise StoreError(f"store {self.path}: {explain(exc)}") from exc


class StoredRows(Mapping[str, Row]):
    """Rows of a store by key, read in blocks when they are asked for, in any thread and after the store is closed.

    `statuses` are those of all points, in order; None: there is no row.
    """

    def __init__(self, path: Path, statuses: Mapping[str, str | None]) -> None:
        self._path, self._statuses = path, statuses
        self._block: dict[str, Row] = {}
        self._after = iter(statuses)

    def __len__(self) -> int:
        return sum(status is not None for status in self._statuses.values())

    def __iter__(self) -> Iterator[str]:
        return (key for key, status in self._statuses.items() if status is not None)

    def __getitem__(self, key: str) -> Row:
        if self._statuses.get(key) is None:
            raise KeyError(key)
        if key not in self._block:
            # Rows are asked for in the order of the points: the next ones come with this one.
            following = [key, *islice(self._after, _KEYS_PER_BLOCK)]
            if key not in following[1:]:
                self._after = iter(self._statuses)
                following = [key, *islice(dropwhile(lambda other: other != key, self._after), _KEYS_PER_BLOCK)]
            with Store(self._path, readonly=True) as store:
                self._block = store.get_many(name for name in following if self._statuses[name] is not None)
        return self._block[key]


def canonical_json(value: object) -> str:
    """Return the one JSON text of a value, fit to be hashed: sorted keys, no spaces, ASCII, finite numbers."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _chunks(keys: Iterable[str]) -> Iterator[list[str]]:
    left = iter(keys)
    while chunk := list(islice(left, _KEYS_PER_QUERY)):
        yield chunk


def _known_status(status: str) -> str:
    if status not in STATUSES:
        raise unknown_name("status", status, STATUSES)
    return status


def encode(row: Row) -> Values:
    """Return a row as the store's columns hold it."""
    # Lone surrogates (a file name that is not UTF-8) have no place in a TEXT column.
    error = None if row.error is None else row.error.encode("utf-8", "backslashreplace").decode()
    values = {name: _finite(getattr(row, name)) for name in _COLUMNS} | {"error": error}
    values |= {"spec": canonical_json(dict(row.spec))}
    values |= {name: canonical_json(values[name]) for name in ("result", "provenance")}
    return tuple(values[name] for name in _COLUMNS)


def decode(values: Sequence[Any]) -> Row:
    """Return the row that `encode` wrote; ValueError if it is none."""
    row = dict(zip(_COLUMNS, values, strict=True))
    try:
        row |= {name: json.loads(row[name]) for name in _JSON_COLUMNS}
    except (TypeError, RecursionError) as exc:  # no text; lists in lists without end
        raise ValueError(f"not JSON: {exc}") from exc
    _check_kinds(tuple(row.values()), _DECODED_KINDS)
    return Row(**row)


def status_of(values: Values) -> str:
    """Return the status of an encoded row: one object for all, however many rows there are."""
    return sys.intern(values[_STATUS])


_DECODED_KINDS = tuple(_KINDS[name] for name in _COLUMNS)
_ENCODED_KINDS = tuple((str,) if name in _JSON_COLUMNS else _KINDS[name] for name in _COLUMNS)
_STATUS = _COLUMNS.index("status")


def _check_kinds(values: Sequence[Any], kinds: Sequence[tuple[type, ...]]) -> None:
    for name, value, kind in zip(_COLUMNS, values, kinds, strict=True):
        if not isinstance(value, kind):
            raise ValueError(f"{name} is of type {type(value).__name__}")


def _finite(value: Any) -> Any:
    """Replace NumPy values by Python's and numbers that JSON cannot hold by None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
