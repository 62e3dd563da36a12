"""The doors for files and words of others, each as a function of bytes; `FracbenchError` in one line is an answer.

``tools/fuzz.py`` feeds them with new inputs, ``tests/fuzz`` with those of the corpus.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import yaml
from omegaconf import OmegaConf

from fracbench.data import files
from fracbench.errors import FracbenchError, InputError
from fracbench.harness.config import compose, composition_cache, working_folder
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run.store import Row, Store
from fracbench.studies.options import require_options

_MOST_SHOWN = 100  # values of a grid
_HEADER = b"# @package _global_\n"
_ROW = Row(key="new", identity="i", spec={}, solver_version=1, status="done")
_by_hydra = compose._by_hydra


def flo(data: bytes) -> None:
    """A Middlebury flow, and the look at its head."""
    files.flow_shape(data, "a.flo")
    files.decode_flo(data, "a.flo")


def kitti(data: bytes) -> None:
    """A KITTI flow, and the look at its head."""
    data = _with_checksums(data)
    files.flow_shape(data, "a.png")
    files.decode_kitti_png(data, "a.png")


def picture(data: bytes) -> None:
    """A picture, a mask, and the look at its head."""
    data = _with_checksums(data)
    files.image_shape(data, "a")
    files.decode_image(data, "a")
    files.mask_shape(data, "a")


def _with_checksums(data: bytes) -> bytes:
    """Correct the checksums of a PNG: where a change has broken one, no reader looks any further."""
    corrected, start = bytearray(data), 8
    while data.startswith(b"\x89PNG\r\n") and start + 12 <= len(data):
        end = start + 8 + int.from_bytes(data[start : start + 4])
        corrected[end : end + 4] = zlib.crc32(data[start + 4 : end]).to_bytes(4)
        start = end + 4
    return bytes(corrected)


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


def protocol(data: bytes) -> compose.RunConfig:
    """A protocol of the working folder, without Hydra, which takes longer than all else."""
    no_folder = Path(os.devnull)  # each input would leave a file in the cache
    with (
        mock.patch.object(compose, "_by_hydra", _merged),
        mock.patch.object(composition_cache, "cache_folder", lambda: no_folder),
    ):
        return by_hydra(data)


def by_hydra(data: bytes) -> compose.RunConfig:
    """A protocol of the working folder, as the program reads it."""
    Path("conf/protocol").mkdir(parents=True, exist_ok=True)
    Path("conf/protocol/own.yaml").write_bytes(_HEADER + data)
    compose._compose.cache_clear()
    return compose.load_config({"protocol": "own"})


def _merged(folder: Path, overrides: list[str], own: working_folder.Files) -> Any:
    """Merge the file into what Hydra makes of its `defaults`."""
    try:
        content = OmegaConf.load(own[0][0])
        defaults = OmegaConf.to_container(content.pop("defaults", OmegaConf.create([])))
        before, after = _around(folder, tuple(overrides), yaml.safe_dump({"defaults": defaults}))
        return OmegaConf.to_container(OmegaConf.merge(before, content, after), resolve=True)
    except Exception as exc:  # as many as the program takes for a bad file
        raise InputError(" ".join(str(exc).split())) from exc


@cache
def _around(folder: Path, overrides: tuple[str, ...], defaults: str) -> tuple[Any, Any]:
    """Return Hydra's composition with a protocol of these `defaults` alone, and what comes after it."""
    with TemporaryDirectory() as other:
        path = Path(other) / "conf" / "protocol" / "own.yaml"
        path.parent.mkdir(parents=True)
        path.write_bytes(_HEADER + defaults.encode())
        composed = OmegaConf.create(_by_hydra(folder, list(overrides), ((path, 0, 0),)))
    after = OmegaConf.load(folder / "config.yaml")
    del after["defaults"]
    after.parallel = composed.parallel
    return composed, after


def store(data: bytes) -> None:
    """A store, to read and to write."""
    for readonly in (True, False):
        path = Path("store.sqlite")
        for leftover in Path().glob("store.sqlite*"):
            leftover.unlink()
        path.write_bytes(data)
        with Store(path, readonly=readonly) as found:
            assert sum(found.counts().values()) >= 0
            rows = found.rows()
            if not readonly:
                found.put(_ROW)
                found.put_many([*found.get_encoded(row.key for row in rows).values()])


TARGETS: dict[str, Callable[[bytes], Any]] = {
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
