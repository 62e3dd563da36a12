"""Beside the store: rows that are finished but not stored yet, and claims on points under way.

A worker writes its row here, by an atomic rename, before it says that it is through; the parent stores the row
and removes the file. Whoever dies in between, the row is there for the next run to take: what was finished is
never computed again. The files are JSON, like the store's columns; nothing in them can run.
"""

from __future__ import annotations

import importlib.util
import os
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fracbench.harness.run.store import Row, Store

#: None on Windows, where two sweeps at once are as safe but do not share the work.
fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None

_STALE_SECONDS = 60.0


def folder_of(store: Path) -> Path:
    """Return the folder that belongs to a store: ``NAME-spool`` beside it."""
    return store.with_name(f"{store.name}-spool")


def write(folder: Path, row: Row) -> None:
    """Leave a finished row for the parent, or for the next run.

    Parameters
    ----------
    folder : Path
        From `folder_of`.
    row : Row
        The row.

    Raises
    ------
    OSError
        The disk is full, or cannot be written.
    """
    temporary = folder / f".{row.key}-{os.getpid()}"
    try:
        temporary.write_text(row.to_json())
        temporary.replace(folder / f"{row.key}.json")
    except OSError:
        with suppress(OSError):
            temporary.unlink()
        raise


def read(folder: Path, key: str) -> Row | None:
    """Return the row of a key, or None if there is none that can be read."""
    try:
        row = Row.from_json((folder / f"{key}.json").read_text())
    except (FileNotFoundError, ValueError):  # a power cut can leave an empty file
        return None
    return row if row.key == key else None


def remove(folder: Path, key: str) -> None:
    """Forget the row of a key, which is in the store now; it may be gone already."""
    (folder / f"{key}.json").unlink(missing_ok=True)


def harvest(store: Store) -> int:
    """Store the rows that runs before this one finished but did not live to store.

    Parameters
    ----------
    store : Store
        Open for writing.

    Returns
    -------
    int
        How many there were.
    """
    folder, found = folder_of(store.path), 0
    for path in sorted(folder.glob("*.json")):
        row = read(folder, path.stem)
        if row is not None:
            store.put(row)
            found += 1
        remove(folder, path.stem)
    for path in folder.glob(".*"):  # a write that was cut short; a fresh one may be another sweep's
        with suppress(FileNotFoundError):
            if time.time() - path.stat().st_mtime > _STALE_SECONDS:
                path.unlink()
    return found


class Claims:
    """The points that this process has under way, so that sweeps of one store share the work.

    A claim is a lock on one byte of a file, at a place given by the key. The system frees it when the process
    ends, however it ends. Use it in a ``with`` statement.

    Parameters
    ----------
    folder : Path
        From `folder_of`; it is created.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self._file = (folder / "claims").open("ab")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def take(self, key: str) -> bool:
        """Claim a point; False if another process has it. Where there are no locks, all claims hold."""
        if fcntl is None:
            return True
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(key))
        except (BlockingIOError, PermissionError):
            return False
        except OSError:  # a file system without locks
            return True
        return True

    def release(self, key: str) -> None:
        """Give a claim up."""
        if fcntl is not None:
            with suppress(OSError):
                fcntl.lockf(self._file, fcntl.LOCK_UN, 1, _place(key))


def _place(key: str) -> int:
    return int(key[:15], 16)  # 60 bits, as many as a file's offset can hold
