"""Two frames with the true flow between them, from either data set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError, match_name

DATASETS = ("middlebury", "synthetic")


@dataclass(frozen=True, eq=False)
class Sequence:
    """Two frames, the flow from the first to the second, and what identifies them.

    Attributes
    ----------
    name : str
        E.g. ``"Grove2"`` or ``"edge"``.
    dataset : str
        ``"middlebury"`` or ``"synthetic"``.
    frame0, frame1 : ndarray of float64, (H, W)
        Gray levels on the scale 0..255; read-only.
    truth : ndarray of float32, (2, H, W), or None
        True flow in pixels, NaN in both components where unknown; read-only.
    digest : str
        SHA-256, in hexadecimal, of what the data are made from: equal digests mean equal data.
    frame0_color : ndarray of uint8, (H, W, 3), or None
        The first frame in colour, for pictures; read-only.

    Raises
    ------
    InputError
        If the shapes do not belong together.
    """

    name: str
    dataset: str
    frame0: NDArray[np.float64]
    frame1: NDArray[np.float64]
    truth: NDArray[np.float32] | None
    digest: str
    frame0_color: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.frame0)
        self._freeze("frame0", np.float64, shape[:2])
        self._freeze("frame1", np.float64, shape)
        if self.truth is not None:
            self._freeze("truth", np.float32, (2, *shape))
        if self.frame0_color is not None:
            self._freeze("frame0_color", np.uint8, (*shape, 3))

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.frame0.shape
        return height, width

    def _freeze(self, field: str, dtype: type[np.generic], shape: tuple[int, ...]) -> None:
        array: NDArray[Any] = np.array(getattr(self, field), dtype=dtype, order="C")
        if array.shape != shape:
            raise InputError(f"sequence {self.name!r}: {field} has the shape {array.shape}, not {shape}")
        array.setflags(write=False)
        object.__setattr__(self, field, array)


def list_sequences(dataset: str) -> tuple[str, ...]:
    """Return the names of the sequences of a data set.

    Parameters
    ----------
    dataset : {"middlebury", "synthetic"}
        The data set.

    Returns
    -------
    tuple of str
        In the order of tables.

    Raises
    ------
    InputError
        If there is no such data set.
    """
    if match_name(dataset, DATASETS, "dataset") == "middlebury":
        from fracbench.data.datasets.middlebury import SEQUENCES

        return SEQUENCES
    from fracbench.data.datasets.synthetic.scenes import ALL

    return ALL


def shape_of(name: str, dataset: str) -> tuple[int, int]:
    """Return height and width of a sequence, without loading it.

    Parameters
    ----------
    name : str
        The sequence, without regard to case.
    dataset : {"middlebury", "synthetic"}
        The data set.

    Returns
    -------
    (int, int)
        Pixels.

    Raises
    ------
    InputError
        If there is no such sequence or data set.
    """
    dataset = match_name(dataset, DATASETS, "dataset")
    name = match_name(name, list_sequences(dataset), f"{dataset} sequence")
    if dataset == "middlebury":
        from fracbench.data.datasets.middlebury import SIZES

        return SIZES[name]
    from fracbench.data.datasets.synthetic.scenes import SHAPES

    return SHAPES[name]


def load_sequence(
    name: str, dataset: str, folder: Path | None = None, *, noise: float = 0.0, seed: int = 0
) -> Sequence:
    """Load a sequence by name.

    Parameters
    ----------
    name : str
        The sequence, without regard to case.
    dataset : {"middlebury", "synthetic"}
        The data set; `fracbench.data.datasets.middlebury.resolve` turns ``"auto"`` into one of them.
    folder : Path, optional
        Where the Middlebury files are; looked up by `fracbench.data.datasets.middlebury.find` if not given.
    noise, seed : float and int, optional
        Of a rendered scene; see `fracbench.data.datasets.synthetic.scenes.scene`.

    Returns
    -------
    Sequence
        Verified (Middlebury) or rendered (synthetic).

    Raises
    ------
    InputError
        If there is no such sequence or data set.
    DataError
        If the files are missing, corrupt or unreadable.
    """
    dataset = match_name(dataset, DATASETS, "dataset")
    name = match_name(name, list_sequences(dataset), f"{dataset} sequence")
    if dataset == "synthetic":
        from fracbench.data.datasets.synthetic import scenes as synthetic

        return synthetic.scene(name, noise=noise, seed=seed)
    from fracbench.data.datasets import middlebury

    return middlebury.load(name, middlebury.find().folder if folder is None else folder)
