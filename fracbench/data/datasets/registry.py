"""The datasets by name: the project's own, and those of installed packages.

A package registers a dataset by an entry point of the group ``fracbench.datasets``, whose name is the dataset's
and whose value is a `Dataset`. It is imported when it is asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from fracbench.data.datasets.base import Dataset
from fracbench.data.pair import FramePair
from fracbench.entry_points import Offers, described
from fracbench.errors import FracbenchError, InputError, match_name

#: Takes Middlebury where it can be had, else the rendered scenes.
AUTO = "auto"
_HERE = "fracbench.data.datasets"
_OWN = {
    "middlebury": f"{_HERE}.middlebury:DATASET",
    "synthetic": f"{_HERE}.synthetic.scenes:DATASET",
    "particles": f"{_HERE}.particles.images:DATASET",
    "folder": f"{_HERE}.folder:DATASET",
    "sintel": f"{_HERE}.sintel:DATASET",
    "kitti2012": f"{_HERE}.kitti:KITTI2012",
    "kitti2015": f"{_HERE}.kitti:KITTI2015",
    "piv": f"{_HERE}.piv:DATASET",
}
_OTHERS = Offers(Dataset, (*_OWN, AUTO))


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets, the project's own first; none is imported."""
    return (*_OWN, *_OTHERS.names())


def get_dataset(name: str) -> Dataset:
    """Return a dataset by its name, without regard to case.

    Raises
    ------
    InputError
        Unknown name, with the nearest; a package that cannot be imported or offers something else.
    """
    name = match_name(name, _OWN if name.casefold() in _OWN else dataset_names(), "dataset")
    return _own(name) if name in _OWN else _OTHERS.load(name)


@cache
def _own(name: str) -> Dataset:
    module, _, attribute = _OWN[name].partition(":")
    dataset: Dataset = getattr(importlib.import_module(module), attribute)
    return dataset


def all_datasets() -> tuple[list[Dataset], list[str]]:
    """Return all datasets, the project's own first, and a line for each entry point that cannot be used."""
    others, unusable = _OTHERS.load_all()
    return [*map(_own, _OWN), *others], unusable


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


def digest_of(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0, **scene: float
) -> str:
    """Return the SHA-256 that identifies a pair, by its exact name."""
    digest = _ask(dataset, "digest", get_dataset(dataset).digest, name, folder, noise=noise, seed=seed, **scene)
    if not isinstance(digest, str):
        raise InputError(f"dataset {dataset}: the digest of {name!r} is no text but {type(digest).__name__}")
    return digest


def load_sequence(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0, **scene: float
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
    **scene : float
        Further settings of a rendered scene; see `fracbench.data.datasets.particles.images.particle_pair`.

    Raises
    ------
    InputError
        Unknown pair or dataset; a DataError if the files are missing, corrupt or unreadable.
    """
    load = get_dataset(dataset).load
    exact = match_sequence(name, dataset, folder)
    pair = _ask(dataset, "load", load, exact, folder, noise=noise, seed=seed, **scene)
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
        raise InputError(f"dataset {dataset}: `{what}` failed: {described(exc)}") from exc
