"""What every dataset tells of itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fracbench.data.pair import FramePair


@dataclass(frozen=True)
class Dataset:
    """A source of pairs.

    Attributes
    ----------
    name : str
        Its name, as in ``dataset=NAME``.
    shapes : mapping of str to (int, int)
        Height and width of its pairs, in the order of tables.
    load : callable
        ``load(name, folder, noise=..., seed=...)`` returns a `FramePair`. `folder` is where the files are, None
        for a dataset without files; `noise` and `seed` are for rendered scenes.
    digest : callable
        SHA-256, in hexadecimal, of what the pair is made from, without decoding it, with the same arguments. It is
        part of the key of every stored result.
    contents : callable or None
        ``contents(name, folder)`` returns the files that `load` reads, by name, to be sent to a worker that has
        none; None for a dataset without files.
    """

    name: str
    shapes: Mapping[str, tuple[int, int]]
    load: Callable[..., FramePair]
    digest: Callable[..., str]
    contents: Callable[[str, Path | None], Mapping[str, bytes]] | None = None
