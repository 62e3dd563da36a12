"""MPI Sintel, the training set: consecutive frames of its scenes, in the passes ``clean`` and ``final``.

Source: D. J. Butler, J. Wulff, G. B. Stanley, M. J. Black, A Naturalistic Open Source Movie for Optical Flow
Evaluation, European Conference on Computer Vision, 2012.
"""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from fracbench.data.datasets.pair_files import Roles, file_dataset, list_folder
from fracbench.errors import DataError

PASSES = ("clean", "final")

_LAYOUT = "training/clean/SCENE/frame_0001.png and training/flow/SCENE/frame_0001.flo"
_FRAME = re.compile(r"frame_(\d{4})\.(png|flo)")
_NAME = re.compile(rf"({'|'.join(PASSES)})_(.+)_(\d{{4}})")


def names(folder: Path) -> list[str]:
    """Return the pairs, ``PASS_SCENE_NNNN``, NNNN the number of the first frame."""
    training, found = folder / "training", []
    for kind in PASSES:
        scenes = list_folder(training / kind) if (training / kind).is_dir() else []
        for scene in (path for path in scenes if path.is_dir()):
            numbers = _numbers(scene)
            if len(numbers) < 2:
                raise DataError(f"{scene}: {len(numbers)} frames, but a pair is two frames in succession")
            truths = _numbers(training / "flow" / scene.name) if (training / "flow" / scene.name).is_dir() else []
            for number in truths:
                if not {number, number + 1} <= set(numbers):
                    raise DataError(
                        f"{training / 'flow' / scene.name}: frame_{number:04d}.flo belongs to frames {number} and "
                        f"{number + 1}, of which one is missing in {scene}"
                    )
            starts = [first for first, second in pairwise(numbers) if second == first + 1]
            found += [f"{kind}_{scene.name}_{first:04d}" for first in starts]
    if not found:
        raise DataError(f"{folder}: no pairs in it; dataset=sintel reads {_LAYOUT}")
    return found


def roles(name: str, folder: Path) -> Roles:
    """Return the files of a pair: its masks are those of the pixels that are invalid, and occluded."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise DataError(f"{folder}: no pair of Sintel is called {name!r}")
    kind, scene, number = match[1], match[2], int(match[3])
    frames = {f"frame{i}": f"training/{kind}/{scene}/frame_{number + i:04d}.png" for i in range(2)}
    others = {
        "flow": f"training/flow/{scene}/frame_{number:04d}.flo",
        "invalid": f"training/invalid/{scene}/frame_{number:04d}.png",
        "occluded": f"training/occlusions/{scene}/frame_{number:04d}.png",
    }
    return frames | {role: path for role, path in others.items() if (folder / path).exists()}


def _numbers(scene: Path) -> list[int]:
    return [int(match[1]) for path in list_folder(scene) if (match := _FRAME.fullmatch(path.name))]


DATASET = file_dataset(
    "sintel", f"MPI Sintel (http://sintel.is.tue.mpg.de), as it is unpacked: {_LAYOUT}", names, roles
)
