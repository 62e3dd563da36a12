"""The store: one SQLite file with one row per point that was run, whether it ended well or not.

A row is committed in a transaction of its own as soon as its point is finished, so whatever stops a sweep
loses only the points that were under way. The journal is WAL: readers go on while a row is written, and
several sweeps may share a store (a writer waits up to `BUSY_SECONDS` for another). On a file system
without shared memory, such as most network mounts, SQLite keeps its rollback journal instead, as safe
though slower.

``synchronous`` is FULL. NORMAL would survive ``kill -9``, but a power cut could take back the last
commits; a point costs seconds to compute and a sync milliseconds.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fracbench.errors import FracbenchError, InputError, unknown_name

STATUSES = ("done", "failed", "crashed", "timeout", "diverged")
SCHEMA_VERSION = 1
APPLICATION_ID = int.from_bytes(b"FRCB", "big")
"""In the header of every store, so that another program's database is never taken for one."""
BUSY_SECONDS = 30.0

_CREATE = (
    f"""CREATE TABLE points (
        key TEXT PRIMARY KEY,
        identity TEXT NOT NULL,
        spec TEXT NOT NULL,
        solver_version INTEGER NOT NULL,
        status TEXT NOT NULL CHECK (status IN {STATUSES}),
        error TEXT,
        result TEXT NOT NULL,
        seconds REAL,
        peak_mib REAL,
        provenance TEXT NOT NULL,
        attempts INTEGER NOT NULL,
        created TEXT NOT NULL
    )""",
    "CREATE INDEX points_identity ON points (identity)",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
_JSON_COLUMNS = ("spec", "result", "provenance")
_KEYS_PER_QUERY = 500  # below the number of parameters that any SQLite accepts

_REMEDIES = {
    sqlite3.SQLITE_NOTADB: "is not a fracbench store; name another file or move this one away",
    sqlite3.SQLITE_CORRUPT: "is damaged; move it away (`sqlite3 FILE .recover` saves what can be read)",
    sqlite3.SQLITE_FULL: "the disk is full; free some space and run the same command again",
    sqlite3.SQLITE_READONLY: "cannot be written; make the file and its folder writable",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened; check that it is a file, in a folder you may write to",
    sqlite3.SQLITE_IOERR: "the disk cannot be read or written; check its space, quota and health",
    sqlite3.SQLITE_BUSY: f"another process has held it for {BUSY_SECONDS:g} s; run the same command again",
}


class StoreError(FracbenchError):
    """The store could not be read or written: the disk is full, the file is damaged or locked."""


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, kw_only=True)
class Row:
    """What is known of one point.

    Attributes
    ----------
    key : str
        SHA-256 of everything the result depends on.
    identity : str
        Hash of `spec` alone, without solver version and data: rows of one identity are the same point,
        run under different circumstances.
    spec : mapping
        The point in canonical form.
    solver_version : int
        Version of the numerics that ran.
    status : {'done', 'failed', 'crashed', 'timeout', 'diverged'}
        How it ended.
    error : str, optional
        The error text, for every status but ``done``.
    result : mapping
        Metrics, iterations, stop reason, energy. Numbers that are not finite come back as None, arrays
        and tuples as lists.
    seconds, peak_mib : float, optional
        Time and peak memory (MiB); None where they could not be measured.
    provenance : mapping
        Host, processor, versions, threads, commit, whether the working tree was clean.
    attempts : int
        How often it was started.
    created : str
        When it ended, UTC, ISO 8601; now by default.

    Raises
    ------
    InputError
        If the status is unknown.
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


_COLUMNS = tuple(f.name for f in fields(Row))
_SELECT = f"SELECT {', '.join(_COLUMNS)} FROM points"
_UPSERT = (
    f"INSERT INTO points ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' for _ in _COLUMNS)}) "
    f"ON CONFLICT (key) DO UPDATE SET {', '.join(f'{c} = excluded.{c}' for c in _COLUMNS[1:])} "
    "WHERE points.status != 'done' OR excluded.status = 'done'"
)


class Store:
    """An open store; use it in a ``with`` statement, in one thread.

    Parameters
    ----------
    path : path-like
        The file; it and its folder are created if they are not there.
    readonly : bool, default: False
        Open for reading only: nothing is created, and a store that is not there reads as an empty one.

    Raises
    ------
    InputError
        If the file is no store, of another schema version, or cannot be opened. Every method raises
        `StoreError` where SQLite fails later on.
    """

    def __init__(self, path: str | Path, *, readonly: bool = False) -> None:
        self.path = Path(path)
        self.readonly = readonly
        if self.path.is_dir():
            raise InputError(f"store {self.path}: is a folder; name a file in it")
        try:
            self._db = _open_to_read(self.path) if readonly else _open_to_write(self.path)
        except (OSError, sqlite3.Error) as exc:
            raise InputError(f"store {self.path}: {_explain(exc)}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        found: dict[str, Row] = {}
        for first in range(0, len(wanted), _KEYS_PER_QUERY):
            chunk = wanted[first : first + _KEYS_PER_QUERY]
            marks = ", ".join("?" for _ in chunk)
            found.update((row.key, row) for row in self._select(f"WHERE key IN ({marks})", chunk))
        return {key: found[key] for key in wanted if key in found}

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
        """Write a row in a transaction of its own, in place of one with the same key.

        Returns
        -------
        bool
            False if the row was left out because it failed and there is a ``done`` one already.
        """
        values = _encode(row)
        with self._transaction():
            return self._db.execute(_UPSERT, values).rowcount == 1

    def delete(self, keys: Iterable[str]) -> int:
        """Delete the rows of these keys, all or none, and return how many there were."""
        with self._transaction():
            return self._db.executemany("DELETE FROM points WHERE key = ?", [(k,) for k in keys]).rowcount

    def _select(self, condition: str, parameters: Sequence[str]) -> list[Row]:
        with self._translated():
            found = self._db.execute(f"{_SELECT} {condition}", parameters).fetchall()
        try:
            return [_decode(values) for values in found]
        except ValueError as exc:
            raise StoreError(f"store {self.path}: {_REMEDIES[sqlite3.SQLITE_CORRUPT]} ({exc})") from exc

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        if self.readonly:
            raise StoreError(f"store {self.path}: opened for reading only")
        with self._translated(), _transaction(self._db):
            yield

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as exc:
            raise StoreError(f"store {self.path}: {_explain(exc)}") from exc


def canonical_json(value: object) -> str:
    """Return the one JSON text of a value, fit to be hashed: sorted keys, no spaces, ASCII only.

    Raises
    ------
    ValueError, TypeError
        If a number is not finite, or something has no JSON form.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _known_status(status: str) -> str:
    if status not in STATUSES:
        raise unknown_name("status", status, STATUSES)
    return status


def _encode(row: Row) -> tuple[object, ...]:
    # Lone surrogates (a file name that is not UTF-8) have no place in a TEXT column.
    error = None if row.error is None else row.error.encode("utf-8", "backslashreplace").decode()
    values = {name: _finite(getattr(row, name)) for name in _COLUMNS} | {"error": error}
    values |= {"spec": canonical_json(dict(row.spec))}
    values |= {name: canonical_json(values[name]) for name in ("result", "provenance")}
    return tuple(values[name] for name in _COLUMNS)


def _decode(values: Sequence[Any]) -> Row:
    row = dict(zip(_COLUMNS, values, strict=True))
    return Row(**row | {name: json.loads(row[name]) for name in _JSON_COLUMNS})


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


def _open_to_write(path: Path) -> sqlite3.Connection:
    path.parent.mkdir(parents=True, exist_ok=True)
    db = _connect(path, "mode=rwc")
    with _closed_on_error(db):
        # The lock comes before the look, so that two processes never both create the table.
        with _transaction(db):
            if _is_blank(db, path):
                _create(db)
        _prefer_wal(db)
        db.execute("PRAGMA synchronous = FULL")
    return db


def _open_to_read(path: Path) -> sqlite3.Connection:
    if not path.exists():
        return _empty()
    db = _connect(path, _reading_mode(path))
    with _closed_on_error(db):
        db.execute("PRAGMA query_only = ON")
        with _transaction(db, "BEGIN"):
            blank = _is_blank(db, path)
    if blank:
        db.close()
        return _empty()
    return db


def _reading_mode(path: Path) -> str:
    if os.access(path, os.W_OK) and os.access(path.parent, os.W_OK):
        return "mode=rw"  # nothing is written, but who may write takes the WAL's files away in the end
    # WAL needs files beside the store; where there are none and none can be made, nobody is writing.
    at_rest = not path.with_name(f"{path.name}-wal").exists() and not os.access(path.parent, os.W_OK)
    return "mode=ro&immutable=1" if at_rest else "mode=ro"


@contextmanager
def _closed_on_error(db: sqlite3.Connection) -> Iterator[None]:
    try:
        yield
    except BaseException:
        db.close()
        raise


def _empty() -> sqlite3.Connection:
    db = sqlite3.connect(":memory:", isolation_level=None)
    _create(db)
    return db


def _connect(path: Path, query: str) -> sqlite3.Connection:
    uri = f"{path.resolve().as_uri()}?{query}"
    return sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS, isolation_level=None)


@contextmanager
def _transaction(db: sqlite3.Connection, begin: str = "BEGIN IMMEDIATE") -> Iterator[None]:
    db.execute(begin)
    try:
        yield
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:  # SQLite itself rolls back on some errors
            db.execute("ROLLBACK")
        raise


def _is_blank(db: sqlite3.Connection, path: Path) -> bool:
    """Tell an empty file from a store of this version; refuse everything else."""
    application, version, tables = (
        db.execute(query).fetchone()[0]
        for query in ("PRAGMA application_id", "PRAGMA user_version", "SELECT count(*) FROM sqlite_master")
    )
    if application == version == tables == 0:
        return True
    if application != APPLICATION_ID:
        raise InputError(f"store {path}: is another program's SQLite database; name another file")
    if version != SCHEMA_VERSION:
        age, remedy = ("newer", "upgrade it") if version > SCHEMA_VERSION else ("older", "move the file away")
        schemas = f"schema {version}, this one has {SCHEMA_VERSION}"
        raise InputError(f"store {path}: written by a fracbench {age} than this ({schemas}); {remedy}")
    if not {*_COLUMNS} <= {name for _, name, *_ in db.execute("PRAGMA table_info(points)")}:
        raise InputError(f"store {path}: {_REMEDIES[sqlite3.SQLITE_CORRUPT]} (columns are missing)")
    return False


def _create(db: sqlite3.Connection) -> None:
    for statement in _CREATE:
        db.execute(statement)


def _prefer_wal(db: sqlite3.Connection) -> None:
    deadline = time.monotonic() + BUSY_SECONDS
    while True:
        try:
            db.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as exc:
            # Unlike every other statement, this one does not wait for another process by itself.
            if _code(exc) != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def _code(exc: BaseException) -> int:
    """Return SQLite's primary result code, or 0."""
    return getattr(exc, "sqlite_errorcode", 0) & 0xFF


def _explain(exc: Exception) -> str:
    if isinstance(exc, OSError):
        return f"{_REMEDIES[sqlite3.SQLITE_CANTOPEN]} ({exc.strerror})"
    remedy = _REMEDIES.get(_code(exc))
    return f"{remedy} ({exc})" if remedy else str(exc)
