"""The training sets of KITTI 2012 and 2015: frames 10 and 11 of each scene.

Sources: A. Geiger, P. Lenz, R. Urtasun, Are We Ready for Autonomous Driving? The KITTI Vision Benchmark Suite,
IEEE Conference on Computer Vision and Pattern Recognition, 2012; M. Menze, A. Geiger, Object Scene Flow for
Autonomous Vehicles, the same conference, 2015.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from fracbench.data.datasets.base import Dataset
from fracbench.data.datasets.pair_files import Roles, file_dataset, list_folder
from fracbench.errors import DataError

_FIRST = re.compile(r"(\d{6})_10\.png")
_PREFIX = "scene_"  # a name that is a number would lose its zeros in a grid and in a table


def _dataset(name: str, title: str, images: Sequence[str]) -> Dataset:
    layout = f"training/{images[0]}/000000_10.png and _11.png, training/flow_occ, training/flow_noc"
    summary = f"{title} (https://www.cvlibs.net/datasets/kitti), as it is unpacked: {layout}"
    return file_dataset(
        name, summary, partial(names, images, f"dataset={name} reads {layout}"), partial(roles, images)
    )


def names(images: Sequence[str], layout: str, folder: Path) -> list[str]:
    """Return the scenes, ``scene_NNNNNN``."""
    place = folder / "training" / _images(images, folder)
    matches = [_FIRST.fullmatch(path.name) for path in list_folder(place)] if place.is_dir() else []
    found = [f"{_PREFIX}{match[1]}" for match in matches if match]
    if not found:
        raise DataError(f"{folder}: no pairs in it; {layout}")
    return found


def roles(images: Sequence[str], name: str, folder: Path) -> Roles:
    """Return the files of a pair: its true flow is that of all pixels, with that of the visible ones as a mask."""
    number, place = name.removeprefix(_PREFIX), _images(images, folder)
    frames = {f"frame{i}": f"training/{place}/{number}_1{i}.png" for i in range(2)}
    truths = {"flow": f"training/flow_occ/{number}_10.png", "matched_flow": f"training/flow_noc/{number}_10.png"}
    there = {role: path for role, path in truths.items() if (folder / path).exists()}
    if "matched_flow" in there and "flow" not in there:
        raise DataError(f"{folder / there['matched_flow']}: there is no {truths['flow']} beside it")
    return frames | there


def _images(images: Sequence[str], folder: Path) -> str:
    return next((name for name in images if (folder / "training" / name).is_dir()), images[0])


KITTI2012 = _dataset("kitti2012", "KITTI 2012", ("colored_0", "image_0"))
KITTI2015 = _dataset("kitti2015", "KITTI 2015", ("image_2",))
