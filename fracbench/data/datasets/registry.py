"""The datasets by name: the project's own, and those of installed packages.

A package registers a dataset by an entry point of the group ``fracbench.datasets``, whose name is the dataset's
and whose value is a `Dataset`. It is imported when it is asked for.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from fracbench.data.datasets.base import Dataset
from fracbench.data.pair import FramePair
from fracbench.errors import FracbenchError, InputError, match_name

GROUP = "fracbench.datasets"
#: Takes Middlebury where it can be had, else the rendered scenes.
AUTO = "auto"
_HERE = "fracbench.data.datasets"
_OWN = {
    "middlebury": f"{_HERE}.middlebury:DATASET",
    "synthetic": f"{_HERE}.synthetic.scenes:DATASET",
    "folder": f"{_HERE}.folder:DATASET",
    "sintel": f"{_HERE}.sintel:DATASET",
    "kitti2012": f"{_HERE}.kitti:KITTI2012",
    "kitti2015": f"{_HERE}.kitti:KITTI2015",
}
_loaded: dict[str, Dataset] = {}


def _entries() -> tuple[dict[str, EntryPoint], list[str]]:
    """Return the entry points of other packages by name, and a line for each whose name is taken."""
    return _entries_of(tuple(sys.path))


@lru_cache(maxsize=1)
def _entries_of(_: tuple[str, ...]) -> tuple[dict[str, EntryPoint], list[str]]:
    found: dict[str, EntryPoint] = {}
    taken = []
    for entry in sorted(set(entry_points(group=GROUP)), key=lambda entry: (entry.name, _package(entry))):
        other = "fracbench" if entry.name in (*_OWN, AUTO) else ""
        if entry.name in found:
            other = _package(found[entry.name])
        if other:
            taken.append(f"{_title(entry)}: left out, the name is taken by {other}")
        else:
            found[entry.name] = entry
    return found, taken


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else "an unknown package"


def _title(entry: EntryPoint) -> str:
    return f"dataset {entry.name!r} of the package {_package(entry)} ({entry.value})"


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets, the project's own first; none is imported."""
    return (*_OWN, *_entries()[0])


def get_dataset(name: str) -> Dataset:
    """Return a dataset by its name, without regard to case.

    Raises
    ------
    InputError
        Unknown name, with the nearest; a package that cannot be imported or registers something else.
    """
    name = match_name(name, dataset_names() if name.casefold() not in _OWN else _OWN, "dataset")
    if name not in _loaded:
        _loaded[name] = _of_package(_entries()[0][name]) if name not in _OWN else _own(name)
    return _loaded[name]


def _own(name: str) -> Dataset:
    module, _, attribute = _OWN[name].partition(":")
    dataset: Dataset = getattr(importlib.import_module(module), attribute)
    return dataset


def _of_package(entry: EntryPoint) -> Dataset:
    try:
        dataset = entry.load()
    except (Exception, SystemExit) as exc:
        raise InputError(f"{_title(entry)}: cannot be imported: {_reason(exc)}") from exc
    if not isinstance(dataset, Dataset):
        raise InputError(f"{_title(entry)}: is a {type(dataset).__name__}, not a {Dataset.__module__}.Dataset")
    if dataset.name != entry.name:
        raise InputError(f"{_title(entry)}: calls itself {dataset.name!r}; entry point and dataset must agree")
    return dataset


def unusable() -> list[str]:
    """Return a line for each dataset of another package that cannot be used."""
    found, taken = _entries()
    lines = list(taken)
    for name in found:
        try:
            get_dataset(name)
        except InputError as exc:
            lines.append(str(exc))
    return lines


def find_folder(dataset: str, given: str | Path | None = None) -> Path | None:
    """Return the folder of a dataset's files, from ``paths.data`` or the usual places; None if it has none."""
    find = get_dataset(dataset).find
    return None if find is None else _ask(dataset, "find", find, given)


def list_sequences(dataset: str, folder: Path | None = None) -> tuple[str, ...]:
    """Return the names of the pairs of a dataset, in the order of tables."""
    names = tuple(_ask(dataset, "names", get_dataset(dataset).names, folder))
    if not names:
        raise InputError(f"dataset {dataset}: has no pairs")
    return names


def match_sequence(name: str, dataset: str, folder: Path | None = None) -> str:
    """Return the exact name of a pair, which is given without regard to case; for an unknown one the nearest."""
    names = list_sequences(dataset, folder)
    return name if name in names else match_name(name, names, f"{get_dataset(dataset).name} sequence")


def is_fixed(dataset: str) -> bool:
    """Tell whether the names and shapes of a dataset's pairs are the same in every folder."""
    return dataset == "middlebury" or get_dataset(dataset).find is None


def shape_of(name: str, dataset: str, folder: Path | None = None) -> tuple[int, int]:
    """Return height and width of a pair in pixels, by its exact name and without decoding it."""
    height, width = _ask(dataset, "shape", get_dataset(dataset).shape, name, folder)
    return int(height), int(width)


def digest_of(name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0) -> str:
    """Return the SHA-256 that identifies a pair, by its exact name."""
    digest = _ask(dataset, "digest", get_dataset(dataset).digest, name, folder, noise=noise, seed=seed)
    if not isinstance(digest, str):
        raise InputError(f"dataset {dataset}: the digest of {name!r} is no text but {type(digest).__name__}")
    return digest


def load_sequence(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0
) -> FramePair:
    """Load a pair by name.

    Parameters
    ----------
    name, dataset : str
        The pair and its dataset, without regard to case.
    folder : Path, optional
        Where the files are; looked up if not given.
    noise, seed : float and int, optional
        Of a rendered scene; see `fracbench.data.datasets.synthetic.scenes.scene`.

    Raises
    ------
    InputError
        Unknown pair or dataset; a DataError if the files are missing, corrupt or unreadable.
    """
    load = get_dataset(dataset).load
    pair = _ask(dataset, "load", load, match_sequence(name, dataset, folder), folder, noise=noise, seed=seed)
    if not isinstance(pair, FramePair):
        raise InputError(f"dataset {dataset}: {name!r} was loaded as {type(pair).__name__}, not as FramePair")
    return pair


def _ask(dataset: str, what: str, function: Callable[..., Any], *args: Any, **more: Any) -> Any:
    """Call a function of a dataset, which may be of another package; whatever it raises becomes one line."""
    try:
        return function(*args, **more)
    except FracbenchError:
        raise
    except Exception as exc:
        raise InputError(f"dataset {dataset}: `{what}` failed: {_reason(exc)}") from exc


def _reason(exc: BaseException) -> str:
    return " ".join(f"{type(exc).__name__}: {exc}".split())
