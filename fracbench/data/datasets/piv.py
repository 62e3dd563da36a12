"""Synthetic particle images of fluids with true flow, by Cai et al.

Source: S. Cai, S. Zhou, C. Xu, Q. Gao, Dense motion estimation of particle images via a convolutional neural
network, Experiments in Fluids 60:73, 2019.

The file of a flow holds at x the displacement of the particle that is at x halfway between the frames: frame 0 at
``x - u/2`` agrees with frame 1 at ``x + u/2`` better than frame 0 at x with frame 1 at ``x + u`` or frame 0 at
``x - u`` with frame 1 at x (docs/datasets.md). The true flow of a pair is that displacement at the place of the
particle in frame 0, as everywhere in this package.
"""

from __future__ import annotations

from pathlib import Path

from fracbench.data.datasets.pair_files import Roles, file_dataset, list_folder
from fracbench.errors import DataError

_FRAMES = ("_img1.tif", "_img2.tif")
_FLOW = "_flow.flo"
_LAYOUT = "NAME_img1.tif, NAME_img2.tif and NAME_flow.flo"


def names(folder: Path) -> list[str]:
    """Return the pairs of which a frame or a true flow is there."""
    stems = {
        path.name.removesuffix(end)
        for path in list_folder(folder)
        for end in (*_FRAMES, _FLOW)
        if path.name.endswith(end) and path.name != end
    }
    if not stems:
        raise DataError(f"{folder}: no pairs in it; dataset=piv reads {_LAYOUT}")
    return sorted(stems)


def roles(name: str, folder: Path) -> Roles:
    """Return the files of a pair: both frames, and the true flow where it is."""
    frames = {f"frame{i}": f"{name}{end}" for i, end in enumerate(_FRAMES)}
    return frames | ({"middle_flow": f"{name}{_FLOW}"} if (folder / f"{name}{_FLOW}").exists() else {})


DATASET = file_dataset(
    "piv",
    f"particle images of Cai et al. (https://github.com/shengzesnail/PIV_dataset), in one folder: {_LAYOUT}",
    names,
    roles,
    variable="FRACBENCH_PIV",
    shared=True,
)
