"""The datasets by name, and their pairs."""

from __future__ import annotations

from pathlib import Path

from fracbench.data.datasets import middlebury
from fracbench.data.datasets.base import Dataset
from fracbench.data.datasets.synthetic import scenes
from fracbench.data.pair import FramePair
from fracbench.errors import match_name

DATASETS = {dataset.name: dataset for dataset in (middlebury.DATASET, scenes.DATASET)}
#: Takes Middlebury where it can be had, else the rendered scenes.
AUTO = "auto"


def get_dataset(name: str) -> Dataset:
    """Return a dataset by its name, without regard to case.

    Raises
    ------
    InputError
        Unknown name; the nearest is offered.
    """
    return DATASETS[match_name(name, DATASETS, "dataset")]


def list_sequences(dataset: str) -> tuple[str, ...]:
    """Return the names of the pairs of a dataset, in the order of tables.

    Raises
    ------
    InputError
        Unknown dataset.
    """
    return tuple(get_dataset(dataset).shapes)


def _named(name: str, dataset: str) -> tuple[Dataset, str]:
    found = get_dataset(dataset)
    return found, match_name(name, found.shapes, f"{found.name} sequence")


def shape_of(name: str, dataset: str) -> tuple[int, int]:
    """Return height and width of a pair, without loading it.

    Parameters
    ----------
    name : str
        The pair, without regard to case.
    dataset : str
        One of `DATASETS`.

    Returns
    -------
    (int, int)
        Pixels.

    Raises
    ------
    InputError
        Unknown pair or dataset.
    """
    found, name = _named(name, dataset)
    return found.shapes[name]


def load_sequence(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0
) -> FramePair:
    """Load a pair by name.

    Parameters
    ----------
    name : str
        The pair, without regard to case.
    dataset : str
        One of `DATASETS`; `fracbench.data.datasets.middlebury.resolve` turns ``"auto"`` into one of them.
    folder : Path, optional
        Where the files are; looked up if not given.
    noise, seed : float and int, optional
        Of a rendered scene; see `fracbench.data.datasets.synthetic.scenes.scene`.

    Returns
    -------
    FramePair
        Verified (Middlebury) or rendered (synthetic).

    Raises
    ------
    InputError
        Unknown pair or dataset.
    DataError
        If the files are missing, corrupt or unreadable.
    """
    found, name = _named(name, dataset)
    return found.load(name, folder, noise=noise, seed=seed)
