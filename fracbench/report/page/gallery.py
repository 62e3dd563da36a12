"""The pictures of the report: for each sequence its frames, its true flow, our flows and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.datasets.registry import list_sequences
from fracbench.data.files import ensure_folder, read_flow
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.figures.flowcolor import color_wheel, fastest, flow_to_color
from fracbench.figures.style import MISSING
from fracbench.harness.run.compute_point import flow_file, keep_flow, point_arrays
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import RUNS
from fracbench.methods.registry import get_method
from fracbench.report.page.elements import Gallery, Picture, drawing, photograph, plain
from fracbench.report.sources import Sources

#: The shared scale of the error maps ends where so many of all errors are below it.
_SHOWN_SHARE = 95.0
#: Colours reach this much further than the true motion: an estimate may be a little faster.
_HEADROOM = 1.1


@dataclass(frozen=True)
class Estimate:
    """A flow that is shown: its method, the flow, and its end-point error at each pixel."""

    title: str
    flow: NDArray[np.float32]
    error: NDArray[np.float64]
    aepe: float


@dataclass(frozen=True)
class Scene:
    """A sequence with the flows that are shown of it."""

    name: str
    frames: tuple[NDArray[np.float64], NDArray[np.float64]]
    truth: NDArray[np.float32]
    estimates: Sequence[Estimate]


def scenes(sources: Sources) -> list[Scene]:
    """Return the sequences of Table 2 with the flows that `compute_flow` has left, two sequences in small form."""
    cache, plan = _cache(sources), sources.get("table2").plan
    found = []
    for name, entries in _shown(plan, sources):
        frame0, frame1, truth, _ = point_arrays(entries[0][1], plan.folder)
        if truth is None:
            continue
        estimates = []
        for label, point in entries:
            flow = read_flow(flow_file(point, cache))
            error = endpoint_error(flow, truth)
            estimates.append(Estimate(label, flow, error, flow_errors(flow, truth).aepe))
        found.append(Scene(sequence_name(name), (frame0, frame1), truth, estimates))
    return found


def missing_flows(sources: Sources) -> list[tuple[Point, Path | None, Path]]:
    """Return the arguments of `compute_flow` for each flow that is missing, a tuple a flow."""
    plan = sources.get("table2").plan
    points = [point for _, entries in _shown(plan, sources) for _, point in entries]
    wanted = {flow_file(point, _cache(sources)): point for point in points}
    return [(point, plan.folder, path) for path, point in wanted.items() if not path.is_file()]


def _cache(sources: Sources) -> Path:
    return sources.results.resolve() / RUNS / "flows"


def _shown(plan: Plan, sources: Sources) -> list[tuple[str, list[tuple[str, Point]]]]:
    """Return the points of each sequence: Table 2's under the reference, and the recommended method's."""
    reference = [planned for planned in plan.points if planned.labels["protocol"] == "reference"]
    names = list(dict.fromkeys(planned.labels["sequence"] for planned in reference))
    names = names[:2] if sources.small else names
    if not names:
        return []
    ours = make_plan(
        ["protocol=recommended", "method=tvl1_sb_alpha", f"sequence={','.join(names)}", *sources.settings],
        allow_download=False,
    )
    entries: dict[str, list[tuple[str, Point]]] = {name: [] for name in names}
    for planned in (*reference, *ours.points):
        label = f"{get_method(planned.point.method).label}, {planned.labels['protocol']}"
        if planned.labels["protocol"] == "recommended":
            label += f" (α = {planned.point.canonical['alpha']})"
        if planned.labels["sequence"] in entries:
            entries[planned.labels["sequence"]].append((label, planned.point))
    return list(entries.items())


def compute_flow(point: Point, data: Path | None, path: Path) -> None:
    """Compute a flow that is missing, in a folder that is made; see `missing_flows` and `keep_flow`."""
    ensure_folder(path.parent)
    keep_flow(point, data, path)


def sequence_name(label: str) -> str:
    """Return the name of a sequence on the page: as the data set spells it; scenes by their label."""
    names = {name.lower(): name for name in list_sequences("middlebury")}
    return names.get(label, label.replace("synthetic_", "scene "))


def shared_scale(shown: Sequence[Scene]) -> float:
    """Return the error in pixels at the end of the scale that all maps share: 1, 2 or 5 times a power of ten."""
    errors = np.concatenate([[], *(np.ravel(estimate.error) for scene in shown for estimate in scene.estimates)])
    errors = errors[np.isfinite(errors)]
    top = float(np.percentile(errors, _SHOWN_SHARE)) if errors.size else 0.0
    if top <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(top))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= top * (1 - 1e-9)))


def gallery(scene: Scene, top: float) -> Gallery:
    """Return the pictures of a sequence, frames and truth, flows, error maps, in three rows.

    The error maps' scale ends at `top` pixels.
    """
    rim = _HEADROOM * fastest(scene.truth) or 1.0
    name = scene.name
    shown = [
        photograph(
            np.clip(np.rint(frame), 0, 255).astype(np.uint8), f"{name}: {word} frame, gray", f"{word} frame"
        )
        for word, frame in zip(("first", "second"), scene.frames, strict=True)
    ]
    alt = f"{name}: true flow in the colour code of the wheel"
    shown.append(photograph(flow_to_color(scene.truth, rim), alt, "true flow"))
    for estimate in scene.estimates:
        alt = f"{name}: flow of {estimate.title}, in the colour code of the wheel"
        shown.append(photograph(flow_to_color(estimate.flow, rim), alt, plain(estimate.title)))
    for estimate in scene.estimates:
        mean = f"mean {estimate.aepe:.3f} px" if np.isfinite(estimate.aepe) else "not finite"
        alt, caption = f"{name}: end-point error of {estimate.title}, {mean}", f"its error: {mean}"
        shown.append(photograph(error_picture(estimate.error, top), alt, caption))
    return Gallery(f"pictures of {name}", shown, legend(rim, top, bool(np.isnan(scene.truth).any())))


def legend(rim: float, top: float, unknown: bool) -> list[Picture]:
    """Return the colour wheel, and the bar of the error maps, with their captions."""
    bar = error_picture(np.linspace(0.0, top, 160)[None, :].repeat(16, axis=0), top)
    black = " Black: unknown." if unknown else ""
    gray = " Gray: true flow unknown." if unknown else ""
    return [
        drawing(
            color_wheel(96),
            "colour wheel: the colour of a motion is that of the disc in its direction from the centre",
            f"Flow: hue is the direction from the centre, saturation the speed; the rim is {rim:.3g} px.{black}",
            disc=True,
        ),
        drawing(
            bar,
            f"error scale from black, 0 pixels, over red to pale yellow, {top:g} pixels and more",
            f"Error: 0 to {top:g} px and above, the same scale in every map on this page.{gray}",
        ),
    ]


def error_picture(error: Any, top: float) -> NDArray[np.uint8]:
    """Paint an (H, W) map of end-point errors, brightest from `top` pixels on; NaN, the truth unknown, is gray."""
    import matplotlib

    colours = matplotlib.colormaps["inferno"].with_extremes(bad=MISSING)
    scaled = np.ma.masked_invalid(np.where(np.isposinf(error), top, error)) / top
    return np.asarray(colours(scaled, bytes=True)[..., :3], dtype=np.uint8)
