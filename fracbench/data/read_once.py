"""Files that are read once a process, as long as they do not change."""

from __future__ import annotations

import hashlib
import os
import stat
from functools import lru_cache
from pathlib import Path

#: A larger file is refused: no frame or flow is so large, and it would fill the memory.
MAX_BYTES = 2**30
_MAX_KEPT = 2**23  # a larger file is read anew rather than kept


def read_once(path: Path) -> tuple[bytes, str]:
    """Return the content of a file and its SHA-256; the last few are kept, by path, size and time of change.

    Raises
    ------
    OSError
        Also for what is no regular file, or is too large.
    """
    found = _stat(path)
    read = _read if found.st_size <= _MAX_KEPT else _read.__wrapped__
    return read(path, found.st_size, found.st_mtime_ns)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal; see `read_once`."""
    found = _stat(path)
    return _sha256(path, found.st_size, found.st_mtime_ns)


def _stat(path: Path) -> os.stat_result:
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):  # a pipe or a device could go on for ever
        raise OSError(0, "a directory" if stat.S_ISDIR(found.st_mode) else "not a regular file")
    if found.st_size > MAX_BYTES:
        raise OSError(0, f"{found.st_size} bytes, more than the {MAX_BYTES} that a frame or a flow may have")
    return found


@lru_cache(maxsize=8)
def _read(path: Path, *_: int) -> tuple[bytes, str]:
    data = path.read_bytes()
    return data, hashlib.sha256(data).hexdigest()


@lru_cache(maxsize=2**16)
def _sha256(path: Path, *_: int) -> str:
    return read_once(path)[1]
