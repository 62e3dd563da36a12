"""Compare our flow of real particle images, those in OpenPIV's package, with OpenPIV's.

No truth is known of these pairs: the difference tells how well the two agree, not which of them is right.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import Any

import common
import numpy as np

from fracbench.api import estimate_flow
from fracbench.commands import console
from fracbench.commands.bench import results_stem, write_results
from fracbench.commands.field_output import Units, to_field
from fracbench.data.files import atomic_path, read_image
from fracbench.data.gray import to_gray
from fracbench.figures.fields import arrow_panels
from fracbench.figures.style import render

#: Pairs below ``openpiv/data``, from five experiments.
PAIRS = {
    "exp1_001": ("test1/exp1_001_a.bmp", "test1/exp1_001_b.bmp"),
    "2image_0": ("test2/2image_00.tif", "test2/2image_01.tif"),
    "pair_4": ("test3/pair_4_frame_0.jpg", "test3/pair_4_frame_1.jpg"),
    "Camera1": ("test4/Camera1-0101.tif", "test4/Camera1-0102.tif"),
    "Pattern_1": ("test5/Pattern_1_A.tif", "test5/Pattern_1_B.tif"),
}
#: The centre of larger pictures is cut to so many pixels a side.
SIDE = 512
#: Pixels from one vector of OpenPIV's last pass, and from the edge, to the next: half its windows of 16.
STEP = 8
GRID = 16  # pixels between the arrows that are drawn


def pictures() -> Path | None:
    """Return the folder of the pictures, or None if OpenPIV is not installed."""
    found = importlib.util.find_spec("openpiv")
    return Path(found.origin).parent / "data" if found and found.origin else None


def central(frame: Any) -> Any:
    """Return the centre of a gray or colour picture as gray levels."""
    gray = to_gray(frame)
    top, left = (max(0, (side - SIDE) // 2) for side in gray.shape)
    return gray[top : top + SIDE, left : left + SIDE]


def compare(frame0: Any, frame1: Any) -> tuple[Any, Any, Any]:
    """Return both flows, ours and OpenPIV's, and their distances on OpenPIV's grid, pixels."""
    ours = estimate_flow(frame0, frame1, protocol="fluid").flow
    theirs = estimate_flow(frame0, frame1, method="openpiv").flow
    at = slice(STEP, 1 - STEP, STEP)
    return ours, theirs, np.hypot(*(ours - theirs).astype(np.float64)[:, at, at])


def measure(arguments: argparse.Namespace) -> None:
    """Compare, print and write the table and the pictures."""
    folder = pictures()
    if folder is None:
        console.note("skipped: OpenPIV, whose pictures these are, is not installed: pip install 'fracbench[piv]'")
        return
    stem = results_stem(arguments.overrides, "openpiv_images")
    records = []
    for name, files in PAIRS.items():
        if not all((folder / file).is_file() for file in files):
            console.note(f"{name}: skipped: OpenPIV's package does not hold {' and '.join(files)}")
            continue
        frames = [central(read_image(folder / file)) for file in files]
        try:
            ours, theirs, distances = compare(*frames)
        except ValueError as exc:  # of OpenPIV's validation
            console.note(f"{name}: skipped: OpenPIV finds no flow ({exc})")
            continue
        records.append({
            "pair": name, "height": ours.shape[1], "width": ours.shape[2],
            "ours": float(np.median(np.hypot(*ours))), "openpiv": float(np.median(np.hypot(*theirs))),
            "difference": np.median(distances), "difference_90": np.quantile(distances, 0.9),
        })  # fmt: skip
        fields = {"fracbench, protocol=fluid": to_field(ours, Units()), "OpenPIV": to_field(theirs, Units())}
        top = float(np.quantile(np.hypot(*theirs), 0.999))
        title = f"{name}: agreement only, no truth is known"
        with atomic_path(stem.with_name(f"{stem.name}_{name}.png")) as temporary:
            temporary.write_bytes(render(arrow_panels(fields, GRID, top, title), "png"))
        console.say(f"wrote {stem.with_name(f'{stem.name}_{name}.png')}")
    note = "medians in pixels, of the difference on OpenPIV's grid with its 90th percentile; no truth is known"
    write_results(records, stem, "Our flow and OpenPIV's on real images: agreement only", note)


def main(argv: list[str]) -> int:
    """Run the comparison and return its exit code."""
    return common.run(measure, common.parser(__doc__, repeats=False), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
