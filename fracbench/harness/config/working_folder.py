"""The configuration of the working folder: protocols, regions and sequences in ``./conf/``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fracbench.errors import InputError
from fracbench.harness.config.records import read_plain, require_name

#: The folders of ``./conf/`` that are read, in the order in which Hydra composes them (``conf/config.yaml``).
GROUPS = ("sequence", "region", "protocol", "parallel")
_HEADER = re.compile(r"#\s*@package\s+_global_\s*\n")
#: Files, each with its time and size, so that a cache sees a change.
Files = tuple[tuple[Path, int, int], ...]


def own_files(project: Path) -> Files:
    """Return the files of ``./conf/``; none if it is the project's own folder."""
    if not Path("conf").is_dir() or (folder := Path("conf").resolve()) == project.resolve():
        return ()
    paths = [path for group in GROUPS for path in sorted((folder / group).rglob("*.yaml"))]
    try:
        return tuple((path, path.stat().st_mtime_ns, path.stat().st_size) for path in paths)
    except OSError as exc:
        raise InputError(f"{exc.filename}: cannot be read: {exc.strerror}") from exc


def own_names(files: Files, group: str) -> set[str]:
    """Return the names that the files give to a group."""
    return {path.stem for path, *_ in files if path.parent.name == group}


def check(files: Files, project: Path) -> None:
    """Refuse names of the project, and all that is more than plain data."""
    for path, *_ in files:
        group = path.parent.name
        if group not in GROUPS or path.parent.parent.name != "conf":
            raise InputError(f"{path}: a configuration has no folders within {', '.join(GROUPS)}")
        require_name(path.stem, "its name", str(path))
        theirs = project / group / path.name
        if theirs.exists() and theirs.read_bytes() != path.read_bytes():  # a copy, as in a checkout, hides nothing
            raise InputError(f"{path}: the name is that of one of fracbench's own {group}s; choose another")
        defaults = read_plain(path).get("defaults", [])
        if not _HEADER.match(path.read_text(encoding="utf-8")):  # Hydra would put all of it below `protocol`
            raise InputError(f"{path}: the first line must be `# @package _global_`")
        if not isinstance(defaults, list):
            raise InputError(f"{path}: `defaults` must be a list, got {defaults!r}")
        for entry in defaults:
            _check_default(entry, path, GROUPS[: GROUPS.index(group) + 1])  # Hydra has not come to the others


def _check_default(entry: Any, path: Path, groups: tuple[str, ...]) -> None:
    if entry == "_self_":
        return
    (word, name), *more = entry.items() if isinstance(entry, Mapping) and entry else [("", entry)]
    group = str(word).removeprefix("override ").strip().removeprefix("/")
    if more or group not in groups:
        allowed = ", ".join(f"override /{group}" for group in groups)
        raise InputError(f"{path}: `defaults` may hold {allowed} with a name, got {entry!r}")
    require_name(name, f"`{word}`", str(path))


def search_path(files: Files) -> list[str]:
    """Return the override that makes Hydra read the files' folder as well."""
    if not files:
        return []
    folder = str(files[0][0].parent.parent).replace("'", "\\'")
    return [f"hydra.searchpath=['file://{folder}']"]
