"""The flow between two image files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.commands import console
from fracbench.commands.field_output import FieldFiles, Units, say_written, to_field
from fracbench.commands.flow_output import picture_beside, say_errors, say_result, write_flow_and_picture
from fracbench.commands.warmup import compile_for
from fracbench.errors import InputError
from fracbench.harness.config.grid import parse_overrides

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fracbench.methods.method import Method
    from fracbench.model.confidence import Confidence


def estimate_pair(
    frame0: Path,
    frame1: Path,
    output: Path,
    *,
    color: Path | None = None,
    truth: Path | None = None,
    mask: Path | None = None,
    initial_flow: Path | None = None,
    confidence: Path | None = None,
    fields: FieldFiles = FieldFiles(),  # noqa: B008 - a tuple
    units: Units = Units(),  # noqa: B008
    method: str | None = None,
    threads: int = 1,
    overrides: Sequence[str] = (),
) -> None:
    """Compute the flow between two image files; write it (``.flo``, or KITTI's ``.png``) and its colour picture.

    The errors are printed if the true flow is given, and the confidence is drawn if a file for it is named; so are
    the files of the velocity field.
    `method` is by default that of the protocol in `overrides`.
    """
    from fracbench.api import estimate_flow
    from fracbench.data.files import read_flow, read_image, write_image
    from fracbench.data.gray import to_gray
    from fracbench.model.coarse_to_fine import check_frames

    # It refuses wrong settings before a file is read.
    given, chosen, settings, name = read_settings("estimate", overrides, method)
    picture = color or picture_beside(output)
    inputs = [path for path in (frame0, frame1, truth, mask, initial_flow) if path is not None]
    _require_outputs(output, [picture, confidence] if confidence else [picture], fields, inputs)
    units.require(bool(fields.paths))
    first, second = read_image(frame0), read_image(frame1)
    size = first.shape[:2]
    expected = of_size(size, truth, "true flow", read_flow(truth)) if truth else None
    start = of_size(size, initial_flow, "initial flow", read_flow(initial_flow)) if initial_flow else None
    hidden = of_size(size, mask, "mask", not_black(read_image(mask))) if mask else None
    check_frames(to_gray(first, name="frame0", nan=True), to_gray(second, name="frame1", nan=True))
    grid = units.step(size) if fields.paths else 0
    compile_for([(chosen.name, settings)], errors=truth is not None)
    result = estimate_flow(
        first,
        second,
        mask=hidden,
        initial_flow=start,
        confidence=confidence is not None,
        threads=threads,
        **given,
    )
    say_result(result, name)
    if expected is not None:
        say_errors(result.flow, expected)
    write_flow_and_picture(result.flow, output, picture)
    if confidence is not None and result.confidence is not None:
        share = float(result.confidence.agrees.mean())
        console.say(f"the flows forward and back agree at {share:.1%} of the pixels")
        write_image(confidence, confidence_picture(result.confidence))
        console.say(f"wrote {confidence}")
    if fields.paths:
        doubtful = None if result.confidence is None else ~result.confidence.agrees
        fields.write(to_field(result.flow, units, hidden, doubtful), grid, f"fracbench, {name}")
        say_written(fields)


def read_settings(
    command: str, overrides: Sequence[str], method: str | None
) -> tuple[dict[str, Any], Method, Any, str]:
    """Return arguments of `estimate_flow`, the method and the parameters that they stand for, and all in words."""
    from fracbench.api import DEFAULT_PROTOCOL, preset_of, settings_of

    grid = parse_overrides(overrides)
    if grid.size > 1:
        raise InputError(f"{command} takes one value a parameter ({' '.join(overrides)}); use sweep for grids")
    given: dict[str, Any] = next(grid.points())
    if method and "method" in given:
        raise InputError(f"--method {method} and method={given['method']}: give one of them")
    method = given.pop("method", method)
    protocol = given.pop("protocol", DEFAULT_PROTOCOL)
    chosen, settings = settings_of(protocol, method, given)
    changes = " ".join(token for token in overrides if not token.startswith(("protocol=", "method=")))
    words = [f"preset {protocol}"]
    if preset_of(protocol, chosen) is None:  # it says nothing on this method
        words = ["its defaults"]
        if protocol != DEFAULT_PROTOCOL:
            console.note(f"note: {chosen.name} has parameters of its own, and takes none of the preset {protocol}")
    name = f"{chosen.name} ({' with '.join([*words, *([changes] if changes else [])])})"
    return {"protocol": protocol, "method": method, **given}, chosen, settings, name


def confidence_picture(confidence: Confidence) -> NDArray[Any]:
    """Return a check as 8-bit gray: 0 where the flows disagree, else 255 (distance 0) down to 1 (1 px or more)."""
    import numpy as np

    levels = np.rint(255.0 - 254.0 * np.minimum(confidence.distance, 1.0))
    picture: NDArray[Any] = (levels * confidence.agrees).astype(np.uint8)
    return picture


def not_black(image: NDArray[Any]) -> NDArray[Any]:
    """Return the mask, (H, W) bool, that a picture stands for."""
    brightest: NDArray[Any] = image if image.ndim == 2 else image.max(axis=2)
    return brightest > 0


def of_size(size: tuple[int, ...], path: Path, what: str, array: NDArray[Any]) -> NDArray[Any]:
    """Return a flow (2, H, W) or a mask (H, W) if it has the size of the frames, (H, W)."""
    if array.shape[-2:] != size:
        raise InputError(
            f"{path}: the {what} is {array.shape[-1]} x {array.shape[-2]}, the frames are {size[1]} x {size[0]} "
            "(width x height)"
        )
    return array


def _require_outputs(output: Path, pictures: Sequence[Path], fields: FieldFiles, inputs: Sequence[Path]) -> None:
    """Refuse an output that cannot be written, or that would replace an input, before anything is computed."""
    from PIL import Image

    if output.suffix.lower() not in (".flo", ".png"):
        raise InputError(f"{output}: a flow is written as .flo or as .png (KITTI), not as {output.suffix!r}")
    for picture in pictures:
        if picture.suffix.lower() not in Image.registered_extensions():
            raise InputError(f"{picture}: no picture format has the suffix {picture.suffix!r}; use .png")
    fields.require()
    taken = {path.resolve() for path in inputs}
    for path in (output, *pictures, *fields.paths):
        # Path.is_dir raises where a parent may not be entered
        if not (os.path.isdir(path.parent) and os.access(path.parent, os.W_OK)):  # noqa: PTH112
            raise InputError(f"{path}: {str(path.parent)!r} is not a folder that can be written to")
        if path.resolve() in taken:
            raise InputError(f"{path}: the command names this file twice; choose another output")
        taken.add(path.resolve())
