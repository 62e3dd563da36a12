"""Pairs of one's own: a folder with one sub-folder a pair."""

from __future__ import annotations

from pathlib import Path

from fracbench.data.datasets.pair_files import Roles, file_dataset, list_folder
from fracbench.errors import DataError

_LAYOUT = (
    "one sub-folder a pair with frame0.* and frame1.* (or frame10.*, frame11.*), flow.flo or flow.png, mask.png"
)
_STEMS = (("frame0", "frame1"), ("frame10", "frame11"))
_FLOWS = ("flow.flo", "flow.png", "flow10.flo", "flow10.png")


def names(folder: Path) -> list[str]:
    """Return the sub-folders that hold a frame."""
    found = [path.name for path in list_folder(folder) if path.is_dir() and _frames(path)]
    if not found:
        raise DataError(f"{folder}: no pairs in it; dataset=folder reads {_LAYOUT}")
    return found


def roles(name: str, folder: Path) -> Roles:
    """Return the files of a pair: frames, and true flow and mask where they are."""
    found = _frames(folder / name)
    for first, second in _STEMS:
        if not (first in found or second in found):
            continue
        paths = {}
        for role, stem in (("frame0", first), ("frame1", second)):
            files = found.get(stem, [])
            if len(files) != 1:
                there = f"has {' and '.join(files)}" if files else f"has no {stem}.*"
                raise DataError(f"{folder / name}: {there}; a pair is one {first}.* and one {second}.*")
            paths[role] = files[0]
        truths = [flow for flow in _FLOWS if (folder / name / flow).exists()]
        if len(truths) > 1:
            raise DataError(f"{folder / name}: has {' and '.join(truths)}; a pair has one true flow")
        if truths:
            paths["flow"] = truths[0]
        if (folder / name / "mask.png").exists():
            paths["mask"] = "mask.png"
        return {role: f"{name}/{path}" for role, path in paths.items()}
    raise DataError(f"{folder / name}: no frames in it; dataset=folder reads {_LAYOUT}")


def _frames(folder: Path) -> dict[str, list[str]]:
    """Return the names of the files called as frames, by name without suffix."""
    wanted = {stem for pair in _STEMS for stem in pair}
    found: dict[str, list[str]] = {}
    for path in list_folder(folder):
        if path.stem in wanted and path.suffix:
            found.setdefault(path.stem, []).append(path.name)
    return found


DATASET = file_dataset("folder", f"pairs of your own: {_LAYOUT}", names, roles)
