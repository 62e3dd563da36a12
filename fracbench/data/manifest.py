"""A manifest: how the files of a folder were made, so that a later run keeps those that it would make alike."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fracbench.data.files import Pathish, read_bytes, write_text
from fracbench.errors import InputError

MANIFEST = "manifest.jsonl"

Entry = dict[str, Any]


def file_digest(path: Pathish) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def add_entry(path: Path, made_from: Mapping[str, Any], **more: Any) -> Entry:
    """Add a file that has just been written to the manifest beside it; return its entry.

    Worker processes do so themselves: when a process is killed, no finished file is forgotten.
    """
    entry = {"file": path.name, "made_from": made_from, "digest": file_digest(path), **more}
    manifest = path.with_name(MANIFEST)
    try:
        with manifest.open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(entry)}\n")
    except OSError as exc:
        raise InputError(f"{manifest}: cannot be written: {exc.strerror}") from exc
    return entry


class Manifest:
    """The entries of a folder by file name: a line of JSON each, of which the last one of a file counts."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / MANIFEST
        self.exists = os.path.lexists(self.path)
        self.entries: dict[str, Entry] = {}
        if self.exists:
            for line in read_bytes(self.path).decode("utf-8", "replace").splitlines():
                if (entry := _entry(line)) is not None:
                    self.entries[entry["file"]] = entry

    def begin(self) -> None:
        """Create the folder unless it is there, and write the lines that count."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise InputError(f"{self.folder}: the folder cannot be created: {exc.strerror}") from exc
        write_text("".join(f"{json.dumps(entry)}\n" for entry in self.entries.values()), self.path)

    def why(self, name: str, made_from: Mapping[str, Any], *numbers: str) -> str:
        """Return why a file has to be made; empty if it is as it was made from the same, and notes `numbers`."""
        path, entry = self.folder / name, self.entries.get(name)
        if entry is None or not all(_is_number(entry.get(number)) for number in numbers):
            return "new"
        changed = [key for key, value in made_from.items() if entry["made_from"].get(key) != value]
        if changed:
            return f"{' and '.join(changed)} changed"
        if not path.is_file():
            return "file missing"
        return "" if file_digest(path) == entry["digest"] else "file changed"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _entry(line: str) -> Entry | None:
    """Return the entry of a line, or None if the line was cut off or damaged: its file is then made again."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None
    types = {"file": str, "made_from": dict, "digest": str}
    whole = isinstance(entry, dict) and all(isinstance(entry.get(key), kind) for key, kind in types.items())
    return entry if whole else None
