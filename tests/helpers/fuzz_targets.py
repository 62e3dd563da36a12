"""The doors for files and words of others, each as a function of bytes; `FracbenchError` in one line is an answer.

``tools/fuzz.py`` feeds them with new inputs, ``tests/fuzz`` with those of the corpus.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

from fracbench.data import files
from fracbench.errors import FracbenchError
from fracbench.harness.config.compose import _compose, load_config
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run.store import Store
from fracbench.studies.options import require_options

_MOST_SHOWN = 100  # values of a grid


def flo(data: bytes) -> None:
    """A Middlebury flow."""
    files.decode_flo(data, "a.flo")


def kitti(data: bytes) -> None:
    """A KITTI flow, and the look at its head."""
    files.flow_shape(data, "a.png")
    files.decode_kitti_png(data, "a.png")


def picture(data: bytes) -> None:
    """A picture, a mask, and the look at its head."""
    files.image_shape(data, "a")
    files.decode_image(data, "a")
    files.mask_shape(data, "a")


def grid(data: bytes) -> None:
    """Overrides of a command line."""
    made = parse_overrides(data.decode("utf-8", "replace").split("\n"))
    assert made.size > 0
    for _, values in zip(range(_MOST_SHOWN), made.points(), strict=False):
        again = parse_overrides([f"{key}='{value}'" for key, value in values.items() if "'" not in value])
        assert all(values[key] == value for key, value in again.fixed.items()), "a value has two meanings"


def experiment(data: bytes) -> None:
    """An experiment of the working folder."""
    (Path("experiments")).mkdir(exist_ok=True)
    Path("experiments/own.yaml").write_bytes(data)
    found = load_experiment("own")
    require_options(found)
    for tokens in found.grids.values():
        parse_overrides(tokens)


def protocol(data: bytes) -> None:
    """A protocol of the working folder."""
    Path("conf/protocol").mkdir(parents=True, exist_ok=True)
    Path("conf/protocol/own.yaml").write_bytes(b"# @package _global_\n" + data)
    _compose.cache_clear()
    load_config({"protocol": "own"})


def store(data: bytes) -> None:
    """A store, to read and to write."""
    for readonly in (True, False):
        path = Path("store.sqlite")
        for leftover in Path().glob("store.sqlite*"):
            leftover.unlink()
        path.write_bytes(data)
        with Store(path, readonly=readonly) as found:
            assert sum(found.counts().values()) >= 0
            for row in found.rows():
                found.put(row) if not readonly else row.to_json()


TARGETS: dict[str, Callable[[bytes], None]] = {
    target.__name__: target for target in (flo, kitti, picture, grid, experiment, protocol, store)
}


_WRITING = ("experiment", "protocol", "store")


def run(name: str, data: bytes) -> bool:
    """Run a target in an empty folder of its own; tell whether it took the input, and raise on a wrong answer."""
    before = Path.cwd()
    with TemporaryDirectory() if name in _WRITING else nullcontext(".") as folder:
        os.chdir(folder)
        try:
            TARGETS[name](data)
        except FracbenchError as exc:
            assert len(str(exc).splitlines()) == 1, f"not one line: {exc!r}"
            return False
        finally:
            os.chdir(before)
    return True
