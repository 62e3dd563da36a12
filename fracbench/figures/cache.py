"""Figures as files, drawn anew only where something they depend on has changed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fracbench
from fracbench.data.files import write_text
from fracbench.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PACKAGE = Path(fracbench.__file__).parent
#: The rooms whose code decides what a figure shows.
_ROOMS = ("figures", "studies", "report", "model")


def draw(stem: Path, make: Callable[..., Figure], *shown: Any, **looks: Any) -> list[Path]:
    """Write the figure ``make(*shown, **looks)`` as png and pdf, unless the files that are there show it.

    A hidden file beside them tells whether they show it: a digest of the arguments, of the drawing code and of
    matplotlib's version, and those of both files. Delete it, or a picture, to have the figure drawn again.
    Arguments are tables, arrays, numbers, texts, and sequences and mappings of them.
    """
    return keep(
        style.figure_files(stem),
        (make.__module__, make.__qualname__, shown, looks),
        lambda: style.save_figure(make(*shown, **looks), stem),
    )


def keep(files: Sequence[Path], depends_on: Any, write: Callable[[], Any]) -> list[Path]:
    """Call `write` unless `files` are as it left them and code and `depends_on` have not changed; see `draw`."""
    record = files[0].with_name(f".{files[0].stem}.made")
    wanted = hashlib.sha256(_code().encode())
    _feed(wanted, depends_on)
    if record.is_file() and record.read_text(encoding="utf-8") == _state(wanted.hexdigest(), files):
        return list(files)
    write()
    write_text(_state(wanted.hexdigest(), files), record)
    return list(files)


def _state(wanted: str, files: Sequence[Path]) -> str:
    found = [hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "none" for path in files]
    return "\n".join([wanted, *found, ""])


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a digest of the drawing code: the code of `_ROOMS`, and matplotlib's version."""
    sources = sorted(path for room in _ROOMS for path in (_PACKAGE / room).rglob("*.py"))
    content = b"".join(path.read_bytes() for path in sources)
    return f"{hashlib.sha256(content).hexdigest()} {version('matplotlib')} {version('numpy')}"


def _feed(digest: Any, value: Any) -> None:
    """Add a value to a digest, with its type, so that different values make different digests."""
    digest.update(f"\0{type(value).__name__}\0".encode())
    if hasattr(value, "to_csv"):
        digest.update(f"{value.dtypes.to_dict()}{value.to_csv()}".encode())
    elif hasattr(value, "tobytes"):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, Mapping):
        _feed(digest, [*value.items()])
    elif isinstance(value, list | tuple):
        digest.update(str(len(value)).encode())
        for item in value:
            _feed(digest, item)
    else:
        digest.update(repr(value).encode())
