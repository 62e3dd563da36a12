"""A computed flow as commands show it: its result and errors in words, its file and its picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.commands import console
from fracbench.errors import InputError

if TYPE_CHECKING:
    from fracbench.model.coarse_to_fine import FlowResult


def say_result(result: FlowResult, name: str = "") -> None:
    """Print notices, method or a longer `name`, iterations, seconds and ending; refuse a flow that diverged."""
    for notice in result.notices:
        console.note(f"note: {notice}")
    if result.stop_reason == "diverged":
        raise InputError("the computation diverged: the flow is not finite; smaller lambda or theta may help")
    counted = f"{sum(map(sum, result.iterations))} iterations, " if result.iterations else ""
    console.say(f"{name or result.method}: {counted}{sum(result.seconds.values()):.2f} s; {result.ending}")


def say_errors(flow: Any, truth: Any) -> None:
    """Print the errors of a flow, shape (2, H, W), in radians, degrees, pixels and per cent."""
    from fracbench.evaluation.metrics import accuracy, endpoint_error, flow_errors, robustness

    errors = flow_errors(flow, truth)
    distances = endpoint_error(flow, truth)
    degrees, spread = errors.degrees
    console.say(
        f"AAE {errors.aae:.4f} rad ({degrees:.2f} deg), SDAE {errors.sdae:.4f} rad ({spread:.2f} deg), "
        f"AEPE {errors.aepe:.4f} px, R1.0 {robustness(distances, 1.0):.2f} %, "
        f"A95 {accuracy(distances, 95):.3f} px; {errors.n_pixels} pixels scored, "
        f"{errors.n_unknown} of unknown truth, {errors.n_nonfinite} not finite"
    )


def picture_beside(flow: Path) -> Path:
    """Return the default place of a flow's colour picture: ``NAME.color.png`` beside it."""
    return flow.with_name(f"{flow.stem}.color.png")


def write_flow_and_picture(flow: Any, path: Path, picture: Path) -> None:
    """Write a flow, shape (2, H, W), as ``.flo`` or KITTI ``.png``, and its colour picture."""
    from fracbench.data.files import write_flow, write_image
    from fracbench.figures.flowcolor import flow_to_color

    write_flow(path, flow)
    write_image(picture, flow_to_color(flow))
    console.say(f"wrote {path}")
    console.say(f"wrote {picture}")
