"""Datasets of files: a layout names the files of each pair; checking, loading and hashing are the same for all.

A file of a pair has a role: ``frame0``, ``frame1``; ``flow``, the true flow; and masks of the size of the frames.
``mask`` is an image that is 0 where the true flow does not count, ``invalid`` one that is 0 where it does,
``occluded`` one that is 0 at pixels visible in both frames. ``matched_flow`` is the true flow at those alone.
``middle_flow``, in the place of ``flow``, is the displacement of what is at a pixel halfway between the frames.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fracbench.data import files
from fracbench.data.datasets.base import Dataset, usual_places
from fracbench.data.datasets.middle import at_frame0
from fracbench.data.gray import to_gray
from fracbench.data.pair import FramePair
from fracbench.data.read_once import read_once, sha256
from fracbench.errors import DataError

#: The files of a pair: paths below the folder, by role.
Roles = Mapping[str, str]

T = TypeVar("T")

MASKS = ("mask", "invalid", "occluded")
_FLOWS = ("flow", "matched_flow", "middle_flow")
_LEVELS_16 = 65535 / 255


def file_dataset(
    name: str,
    summary: str,
    names: Callable[[Path], Sequence[str]],
    roles: Callable[[str, Path], Roles],
    *,
    variable: str = "",
    shared: bool = False,
) -> Dataset:
    """Return a dataset of files.

    Parameters
    ----------
    name, summary : str
        See `Dataset`; the summary tells the layout, or where to get the files.
    names : callable
        ``names(folder)`` returns the names of the pairs; a DataError where the folder has another layout.
    roles : callable
        ``roles(name, folder)`` returns the files of a pair by role: the frames, and what else there is of it.
    variable : str, optional
        Environment variable with the folder, which is asked after ``paths.data``.
    shared : bool, optional
        Whether to look at ``../shared/NAME`` before ``data/NAME``, from the working folder and from the checkout.
    """
    usual = f"data/{name}"

    def required(folder: Path | None) -> Path:
        return find(None) if folder is None else folder

    def find(given: str | Path | None) -> Path:
        for source, told in (("paths.data", given), (variable, os.environ.get(variable))):
            if told:
                folder = is_folder(told, f"{source}={told}")
                if folder is None:
                    raise DataError(f"{source}={told}: is not a folder; {name}: {summary}")
                return folder
        for label, place in usual_places(f"../shared/{name}", usual) if shared else [(usual, Path(usual))]:
            folder = is_folder(place, label)
            if folder is not None:
                return folder
        ways = f"give paths.data=FOLDER, {f'set {variable}=FOLDER, ' if variable else ''}or put it at {usual}"
        raise DataError(f"{name}: {ways}; {summary}")

    def is_folder(place: str | Path, label: str) -> Path | None:
        folder = Path(place).expanduser()
        try:
            return folder.resolve() if folder.is_dir() else None
        except OSError as exc:
            raise DataError(f"{label}: cannot be read: {exc.strerror}") from exc

    def shape(pair: str, folder: Path | None) -> tuple[int, int]:
        return check_sizes(roles(pair, required(folder)), required(folder))

    def load(pair: str, folder: Path | None, *, noise: float = 0.0, seed: int = 0) -> FramePair:
        folder = required(folder)
        found = roles(pair, folder)
        check_sizes(found, folder)
        return _load(pair, name, found, folder, digest(pair, folder))

    def digest(pair: str, folder: Path | None, *, noise: float = 0.0, seed: int = 0) -> str:
        folder = required(folder)
        lines = [f"{role} {_opened(folder / path, sha256)}" for role, path in sorted(roles(pair, folder).items())]
        return hashlib.sha256("\n".join(["files of a pair, 1", *lines]).encode()).hexdigest()

    def contents(pair: str, folder: Path | None) -> dict[str, bytes]:
        folder = required(folder)
        return {path: _read(folder / path) for path in roles(pair, folder).values()}

    return Dataset(
        name=name,
        summary=summary,
        names=lambda folder: names(required(folder)),
        shape=shape,
        load=load,
        digest=digest,
        find=find,
        contents=contents,
    )


def check_sizes(roles: Roles, folder: Path) -> tuple[int, int]:
    """Return height and width of a pair after a look at the head of each file: its format and its size."""
    size: tuple[int, int] | None = None
    for role in ("frame0", *(role for role in roles if role != "frame0")):
        path = folder / roles[role]
        head = files.flow_shape if role in _FLOWS else files.mask_shape if role in MASKS else files.image_shape
        found = head(_read(path), str(path))
        size = size or found
        if found != size:
            raise DataError(
                f"{path}: {found[1]} x {found[0]} pixels, but {Path(roles['frame0']).name} of the pair has "
                f"{size[1]} x {size[0]} (width x height)"
            )
    assert size is not None
    return size


def list_folder(folder: Path) -> list[Path]:
    """Return what is in a folder, sorted by name, without hidden files and folders; DataError if it is none."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as exc:
        raise DataError(f"{folder}: cannot be read: {exc.strerror}") from exc


def _read(path: Path) -> bytes:
    return _opened(path, read_once)[0]


def _opened(path: Path, read: Callable[[Path], T]) -> T:
    try:
        return read(path)
    except (OSError, ValueError) as exc:  # ValueError: a NUL in the name
        why = exc.strerror if isinstance(exc, OSError) else str(exc)
        raise DataError(f"{path}: cannot be read: {why}") from exc


def _load(name: str, dataset: str, roles: Roles, folder: Path, digest: str) -> FramePair:
    def decoded(role: str) -> Any:
        if role not in roles:
            return None
        path = folder / roles[role]
        decode = files.decode_flow if role in _FLOWS else files.decode_image
        return decode(_read(path), str(path))

    first, second = decoded("frame0"), decoded("frame1")
    truth, matched = decoded("flow"), None
    if "middle_flow" in roles:
        truth = at_frame0(decoded("middle_flow"))
    if truth is not None:
        for role, counts in (("mask", True), ("invalid", False)):
            if role in roles:
                truth[:, (decoded(role) != 0) != counts] = np.nan
        if "occluded" in roles:
            matched = decoded("occluded") == 0
        if "matched_flow" in roles:
            matched = np.isfinite(decoded("matched_flow")).all(axis=0)
    return FramePair(
        name=name,
        dataset=dataset,
        frame0=_levels(first, roles["frame0"]),
        frame1=_levels(second, roles["frame1"]),
        truth=truth,
        digest=digest,
        frame0_color=first if first.ndim == 3 else None,
        matched=matched,
    )


def _levels(image: NDArray[Any], name: str) -> NDArray[np.float64]:
    """Return gray levels within 0..255; those of 16 bits are divided by 257 and not rounded."""
    gray = to_gray(image, name).astype(np.float64)
    return gray / _LEVELS_16 if image.dtype == np.uint16 else gray
