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
    """Return a dataset by its name, without regard to case; for an unknown one the nearest is offered."""
    return DATASETS[match_name(name, DATASETS, "dataset")]


def list_sequences(dataset: str) -> tuple[str, ...]:
    """Return the names of the pairs of a dataset, in the order of tables."""
    return tuple(get_dataset(dataset).shapes)


def _named(name: str, dataset: str) -> tuple[Dataset, str]:
    found = get_dataset(dataset)
    return found, match_name(name, found.shapes, f"{found.name} sequence")


def shape_of(name: str, dataset: str) -> tuple[int, int]:
    """Return height and width of a pair in pixels, without loading it."""
    found, name = _named(name, dataset)
    return found.shapes[name]


def load_sequence(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0
) -> FramePair:
    """Load a pair by name.

    Parameters
    ----------
    name, dataset : str
        The pair and one of `DATASETS`, without regard to case.
    folder : Path, optional
        Where the files are; looked up if not given.
    noise, seed : float and int, optional
        Of a rendered scene; see `fracbench.data.datasets.synthetic.scenes.scene`.

    Raises
    ------
    InputError
        Unknown pair or dataset; a DataError if the files are missing, corrupt or unreadable.
    """
    found, name = _named(name, dataset)
    return found.load(name, folder, noise=noise, seed=seed)
