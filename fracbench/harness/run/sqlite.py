"""The SQLite file of a store: its schema, how it is opened, and SQLite's errors in words for a user.

The journal is WAL: readers go on while a row is written, and several sweeps may share a store (a writer waits up
to `BUSY_SECONDS` for another). On a file system without shared memory, such as most network mounts, SQLite keeps
its rollback journal instead, as safe though slower.

``synchronous`` is FULL. NORMAL would survive ``kill -9``, but a power cut could take back the last commits; a
point costs seconds to compute and a sync milliseconds.
"""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fracbench.errors import InputError

STATUSES = ("done", "failed", "crashed", "timeout", "diverged")
SCHEMA_VERSION = 1
APPLICATION_ID = int.from_bytes(b"FRCB", "big")
"""In the header of every store, so that another program's database is never taken for one."""
BUSY_SECONDS = 30.0
# Keys come in no order, so that each row changes a page of each index. Pages are kept in memory, and written to
# the file itself, which takes two syncs, when many rows have changed them.
_JOURNAL_PAGES = 8000
_CACHE_KIB = 64_000

_COLUMNS = {
    "key": "TEXT PRIMARY KEY",
    "identity": "TEXT NOT NULL",
    "spec": "TEXT NOT NULL",
    "solver_version": "INTEGER NOT NULL",
    "status": f"TEXT NOT NULL CHECK (status IN {STATUSES})",
    "error": "TEXT",
    "result": "TEXT NOT NULL",
    "seconds": "REAL",
    "peak_mib": "REAL",
    "provenance": "TEXT NOT NULL",
    "attempts": "INTEGER NOT NULL",
    "created": "TEXT NOT NULL",
}
_CREATE = (
    f"CREATE TABLE points ({', '.join(f'{name} {kind}' for name, kind in _COLUMNS.items())})",
    "CREATE INDEX points_identity ON points (identity)",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)

DAMAGED = "is damaged; move it away (`sqlite3 FILE .recover` saves the rows that can be read)"
_REMEDIES = {
    sqlite3.SQLITE_NOTADB: "is not a fracbench store; name another file or move this one away",
    sqlite3.SQLITE_CORRUPT: DAMAGED,
    sqlite3.SQLITE_FULL: "the disk is full; free some space and run the same command again",
    sqlite3.SQLITE_READONLY: "cannot be written; make the file and its folder writable",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened; check that it is a file, in a folder you may write to",
    sqlite3.SQLITE_IOERR: "the disk cannot be read or written; check its space, quota and health",
    sqlite3.SQLITE_BUSY: f"another process has held it for {BUSY_SECONDS:g} s; run the same command again",
}


def open_to_write(path: Path) -> sqlite3.Connection:
    """Open a store in autocommit mode; it and its folder are created if they are not there.

    InputError: another program's database, or a store of another version; for other errors see `explain`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    db = _connect(path, "mode=rwc")
    with _closed_on_error(db):
        # The lock comes before the look, so that two processes never both create the table.
        with transaction(db):
            if _is_blank(db, path):
                _create(db)
        _prefer_wal(db)
        db.execute("PRAGMA synchronous = FULL")
        db.execute(f"PRAGMA wal_autocheckpoint = {_JOURNAL_PAGES}")
        db.execute(f"PRAGMA cache_size = -{_CACHE_KIB}")
    return db


def open_to_read(path: Path) -> sqlite3.Connection:
    """Open a store for reading only; one that is not there reads as an empty one. Otherwise as `open_to_write`."""
    if not path.exists():
        return _empty()
    db = _connect(path, _reading_mode(path))
    with _closed_on_error(db):
        db.execute("PRAGMA query_only = ON")
        with transaction(db, "BEGIN"):
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
    return sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False)


@contextmanager
def transaction(db: sqlite3.Connection, begin: str = "BEGIN IMMEDIATE") -> Iterator[None]:
    """Commit all that is done inside, or take it back."""
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
    if db.execute("SELECT count(*) FROM sqlite_master WHERE type IN ('trigger', 'view')").fetchone()[0]:
        raise InputError(f"store {path}: {DAMAGED} (it holds triggers or views, which no store of ours has)")
    if not _COLUMNS.keys() <= {name for _, name, *_ in db.execute("PRAGMA table_info(points)")}:
        raise InputError(f"store {path}: {DAMAGED} (columns are missing)")
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


def explain(exc: Exception) -> str:
    """Return the meaning of an error of SQLite or the system, and the remedy."""
    if isinstance(exc, OSError):
        return f"{_REMEDIES[sqlite3.SQLITE_CANTOPEN]} ({exc.strerror})"
    if isinstance(exc, UnicodeDecodeError):  # sqlite3 cannot decode SQLite's own message, which quotes the file
        return f"{DAMAGED} ({exc})"
    if isinstance(exc, MemoryError):  # a damaged file may make SQLite ask for more than there is
        return f"{DAMAGED} (or there is too little memory)"
    remedy, said = _REMEDIES.get(_code(exc)), " ".join(str(exc).split())  # it may quote a damaged file
    return f"{remedy} ({said})" if remedy else said
