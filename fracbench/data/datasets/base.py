"""The interface of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fracbench.data.pair import FramePair


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A source of pairs of frames.

    `folder` is the folder of its files, from `find`; None for a dataset without files.

    Attributes
    ----------
    name : str
        Its name, as in ``dataset=NAME`` and as the name of its entry point.
    summary : str
        Its content, or where its files come from, in a few words.
    names : callable
        ``names(folder)`` returns the names of its pairs, in the order of tables.
    shape : callable
        ``shape(name, folder)`` returns height and width of a pair, without decoding it.
    load : callable
        ``load(name, folder, noise=..., seed=...)`` returns a `FramePair`; `noise`, `seed` and those
        `settings` that the user gives are for rendered scenes.
    digest : callable
        SHA-256, in hexadecimal, of what the pair is made from, without decoding it, with the same arguments. It is
        part of the key of every stored result.
    find : callable or None
        ``find(given)`` returns the folder of the files, from ``paths.data=given`` or, without it, from the usual
        places; None for a dataset without files.
    contents : callable or None
        ``contents(name, folder)`` returns the files that `load` reads, by path below the folder, to be sent to a
        worker that has none; None for a dataset without files.
    outliers : bool
        Whether KITTI's share of outliers, Fl-all, is among the errors of its pairs.
    settings : mapping
        The usual values of its rendered scenes' settings, by their key on the command line.
    """

    name: str
    summary: str
    names: Callable[[Path | None], Sequence[str]]
    shape: Callable[[str, Path | None], tuple[int, int]]
    load: Callable[..., FramePair]
    digest: Callable[..., str]
    find: Callable[[str | Path | None], Path] | None = None
    contents: Callable[[str, Path | None], Mapping[str, bytes]] | None = None
    outliers: bool = True
    settings: Mapping[str, float] = field(default_factory=dict)


def usual_places(*places: str) -> Iterator[tuple[str, Path]]:
    """Yield relative places with their paths: from the working folder, then from the checkout, if this is one."""
    checkout = Path(__file__).resolve().parents[3]
    for root in (Path(), checkout) if (checkout / "pyproject.toml").is_file() else (Path(),):
        for place in places:
            yield place, root / place
