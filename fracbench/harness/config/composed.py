"""Compositions that Hydra has made before, kept in the user's cache: making one costs tens of milliseconds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fracbench.data.files import atomic_path
from fracbench.errors import InputError


def remembered(folder: Path, choices: tuple[tuple[str, str], ...], compose: Callable[[], Any]) -> Any:
    """Return what `compose` gives for these choices, from the cache if it was asked before.

    An entry's name tells the content of every file below `folder` and Hydra's version, so that it is never out
    of date. A cache that cannot be read or written is done without.

    Parameters
    ----------
    folder : Path
        The configuration.
    choices : tuple of (str, str)
        Group and name, sorted.
    compose : callable
        Makes the composition: mappings, lists, numbers, texts.

    Returns
    -------
    object
        The composition.
    """
    path = cache_folder() / f"{_name(folder, choices)}.json"
    with suppress(OSError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    composed = compose()
    if json.loads(json.dumps(composed)) != composed:
        return composed  # a key that is no text, for one: whoever checks the composition must see it every time
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(composed), encoding="utf-8")
    return composed


def cache_folder() -> Path:
    """Return where compositions are kept."""
    from platformdirs import user_cache_path

    return user_cache_path("fracbench") / "configurations"


def _name(folder: Path, choices: tuple[tuple[str, str], ...]) -> str:
    digest = hashlib.sha256(f"{version('hydra-core')} {choices}".encode())
    for path in sorted(folder.rglob("*.yaml")):
        content = path.read_bytes()
        digest.update(f"\0{path.relative_to(folder)}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()
