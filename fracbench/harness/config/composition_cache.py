"""A cache of Hydra's compositions on disk, in the user's cache folder.

One composition takes tens of milliseconds, and Table 2 needs 24: without the cache a dry run of it takes nine
times as long.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fracbench.data.files import atomic_path
from fracbench.errors import InputError


def cached_composition(
    files: Iterable[Path], choices: tuple[tuple[str, str], ...], compose: Callable[[], Any]
) -> Any:
    """Return ``compose()``, or its cached result for the same choices and files.

    An entry's name is a digest of the choices, of all files and of Hydra's version, so that it is never out of
    date. If the cache cannot be read or written, nothing is cached.
    """
    path = cache_folder() / f"{_name(files, choices)}.json"
    with suppress(OSError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    composed = compose()
    if json.loads(json.dumps(composed)) != composed:
        return composed  # JSON would change it, e.g. a key that is no text, which the check must see every time
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(composed), encoding="utf-8")
    return composed


def cache_folder() -> Path:
    """Return the folder of the cached compositions."""
    from platformdirs import user_cache_path

    return user_cache_path("fracbench") / "configurations"


def _name(files: Iterable[Path], choices: tuple[tuple[str, str], ...]) -> str:
    digest = hashlib.sha256(f"{version('hydra-core')} {choices}".encode())
    for path in files:
        content = path.read_bytes()
        digest.update(f"\0{path}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()
