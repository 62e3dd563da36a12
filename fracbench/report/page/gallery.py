"""The pictures of the report: for each sequence its frames, its true flow, our flows and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.datasets.registry import list_sequences
from fracbench.data.files import read_flow
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.figures.flowcolor import color_wheel, fastest, flow_to_color
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.flows import flow_file, keep_flow
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import RUNS
from fracbench.report.page.elements import Gallery, Picture, embedded
from fracbench.report.sources import Sources

#: The shared scale of the error maps ends where so many of all errors are below it.
_SHOWN_SHARE = 95.0
#: Colours reach this much further than the true motion: an estimate may be a little faster.
_HEADROOM = 1.1
_SMALL = 2
_WIDTH = 480
_WHEEL = 96


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
    """Return the sequences of Table 2 with their flows, which `compute_flow` has left.

    Parameters
    ----------
    sources : Sources
        The experiments; in small form two sequences are shown.

    Returns
    -------
    list of Scene
        In the order of the table; empty where there is no such table.

    Raises
    ------
    InputError
        Data or flows that cannot be read.
    """
    source = sources.get("table2")
    if source is None:
        return []
    return [
        _scene(name, entries, source.plan.folder, _cache(sources))
        for name, entries in _shown(source.plan, sources)
    ]


def missing_flows(sources: Sources) -> list[tuple[Point, Path | None, Path]]:
    """Return the arguments of `compute_flow` for each flow that is missing, a tuple a flow."""
    source = sources.get("table2")
    if source is None:
        return []
    cache = _cache(sources)
    points = [point for _, entries in _shown(source.plan, sources) for _, point in entries]
    wanted = {flow_file(point, cache): point for point in points}
    return [(point, source.plan.folder, path) for path, point in wanted.items() if not path.is_file()]


def _cache(sources: Sources) -> Path:
    return sources.results.resolve() / RUNS / "flows"


def _shown(plan: Plan, sources: Sources) -> list[tuple[str, list[tuple[str, Point]]]]:
    """Return the points of each sequence: Table 2's under the reference, and the recommended method's."""
    reference = [planned for planned in plan.points if planned.labels["protocol"] == "reference"]
    names = list(dict.fromkeys(planned.labels["sequence"] for planned in reference))
    names = names[:_SMALL] if sources.small else names
    ours = make_plan(
        ["protocol=recommended", "method=tvl1_sb_alpha", f"sequence={','.join(names)}", *sources.settings],
        allow_download=False,
    )
    from fracbench.methods.registry import get_method

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
    from fracbench.data.files import ensure_folder

    ensure_folder(path.parent)
    keep_flow(point, data, path)


def _scene(name: str, entries: Sequence[tuple[str, Point]], folder: Path | None, cache: Path) -> Scene:
    frame0, frame1, truth, _ = point_arrays(entries[0][1], folder)
    estimates = []
    for label, point in entries:
        flow = read_flow(flow_file(point, cache))
        errors = endpoint_error(flow, truth)
        estimates.append(Estimate(label, flow, errors, flow_errors(flow, truth).aepe))
    return Scene(sequence_name(name), (frame0, frame1), truth, estimates)


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
    """Return the pictures of a sequence: frames and truth, flows, error maps, in three rows.

    Parameters
    ----------
    scene : Scene
        The sequence and its flows.
    top : float
        End of the error maps' scale in pixels.

    Returns
    -------
    Gallery
        With the colour wheel and the error scale as its legend.
    """
    rim = _HEADROOM * fastest(scene.truth) or 1.0
    name = scene.name
    shown = [
        _picture(_gray(frame), f"{name}: {word} frame, gray", f"{word} frame")
        for word, frame in zip(("first", "second"), scene.frames, strict=True)
    ]
    shown.append(
        _picture(
            flow_to_color(scene.truth, rim), f"{name}: true flow in the colour code of the wheel", "true flow"
        )
    )
    for estimate in scene.estimates:
        alt = f"{name}: flow of {estimate.title}, in the colour code of the wheel"
        shown.append(_picture(flow_to_color(estimate.flow, rim), alt, estimate.title))
    for estimate in scene.estimates:
        mean = f"mean {estimate.aepe:.3f} px" if np.isfinite(estimate.aepe) else "not finite"
        alt, caption = f"{name}: end-point error of {estimate.title}, {mean}", f"its error: {mean}"
        shown.append(_picture(error_picture(estimate.error, top), alt, caption))
    return Gallery(f"pictures of {name}", shown, legend(rim, top, bool(np.isnan(scene.truth).any())))


def legend(rim: float, top: float, unknown: bool) -> list[Picture]:
    """Return the colour wheel, and the bar of the error maps, with their captions."""
    wheel, wheel_size = embedded(color_wheel(_WHEEL))
    bar, bar_size = embedded(error_picture(np.linspace(0.0, top, 160)[None, :].repeat(16, axis=0), top))
    black = " Black: unknown." if unknown else ""
    gray = " Gray: true flow unknown." if unknown else ""
    return [
        Picture(
            wheel,
            "colour wheel: the colour of a motion is that of the disc in its direction from the centre",
            f"Flow: direction from the centre is hue, speed is saturation; rim {rim:.3g} px.{black}",
            wheel_size,
            round=True,
        ),
        Picture(
            bar,
            f"error scale from black, 0 pixels, over red to pale yellow, {top:g} pixels and more",
            f"Error: 0 to {top:g} px and above, the same scale in every map on this page.{gray}",
            bar_size,
        ),
    ]


def error_picture(error: Any, top: float) -> NDArray[np.uint8]:
    """Paint a map of end-point errors.

    Parameters
    ----------
    error : ndarray, (H, W)
        Pixels; NaN where the true flow is unknown, infinite where the estimate is not finite.
    top : float
        Error of the brightest colour, in pixels.

    Returns
    -------
    ndarray of uint8, (H, W, 3)
        RGB.
    """
    import matplotlib

    from fracbench.figures.style import MISSING

    colours = matplotlib.colormaps["inferno"].with_extremes(bad=MISSING)
    scaled = np.ma.masked_invalid(np.where(np.isposinf(error), top, error)) / top
    return np.asarray(colours(scaled, bytes=True)[..., :3], dtype=np.uint8)


def _gray(frame: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.clip(np.rint(frame), 0, 255).astype(np.uint8)


def _picture(image: NDArray[np.uint8], alt: str, caption: str) -> Picture:
    uri, size = embedded(image, width=_WIDTH, lossy=True)
    return Picture(uri, alt, caption, size)
