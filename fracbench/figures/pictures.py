"""Pictures: frames, flow fields and error maps as matplotlib figures. No file is read or written here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError, unknown_name
from fracbench.figures.flowcolor import checked_flow, color_wheel, fastest, flow_to_color, known_pixels
from fracbench.figures.style import MISSING, PALETTE, WIDTH, house_style, new_figure, picture_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Item = tuple[str, NDArray[Any]]
"""A picture's title and its array."""

Box = tuple[int, int, int, int]
"""First row, one past the last, first column, one past the last."""

_TITLE = 0.32  # inches
_BOX_COLOURS = {"A": PALETTE[1], "B": PALETTE[0]}


def frame_panel(
    items: Sequence[Item], *, columns: int = 4, boxes: Sequence[Mapping[str, Box]] = (), title: str = ""
) -> Figure:
    """Show frames beside each other, with boxes drawn on them.

    Parameters
    ----------
    items : sequence of (str, numpy.ndarray)
        Titles and pictures: (H, W, 3) uint8, or (H, W) gray levels 0..255.
    columns : int, optional
        Pictures in a row, at most.
    boxes : sequence of mapping of str to tuple, optional
        For each picture its boxes by the letter beside them: A is red, B blue, as in the paper's Figure 5.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The pictures in rows.

    Raises
    ------
    InputError
        If there is no picture, `columns` is not positive, or there is no colour for the letter of a box.
    """
    if not items or columns < 1:
        raise InputError(f"a panel of frames needs frames and columns, got {len(items)} in {columns} columns")
    columns = min(columns, len(items))
    shapes = [picture.shape[:2] for _, picture in items]
    tallest = [max(h / w for h, w in shapes[i : i + columns]) for i in range(0, len(items), columns)]
    with house_style():
        fig = new_figure(sum(WIDTH / columns * height + _TITLE for height in tallest) + _TITLE)
        fig.suptitle(title)
        grid = fig.subplots(len(tallest), columns, squeeze=False, height_ratios=tallest)
        axes = list(grid.flat)
        for ax in axes:
            ax.set_axis_off()
            ax.set_anchor("N")
        for ax, (name, picture) in zip(axes, items, strict=False):
            ax.imshow(picture, cmap="gray", vmin=0, vmax=255)
            ax.set_title(name)
        for ax, found in zip(axes, boxes, strict=False):
            for letter, box in found.items():
                _draw_box(ax, letter, box)
    return fig


def flow_panel(items: Sequence[Item], *, columns: int = 3, max_motion: float | None = None) -> Figure:
    """Show flow fields in the Middlebury colour code, all on one scale, beside its colour wheel.

    Parameters
    ----------
    items : sequence of (str, numpy.ndarray)
        Titles and (2, H, W) flows in pixels; unknown pixels are black.
    columns : int, optional
        Pictures in a row, at most.
    max_motion : float, optional
        Speed in pixels at the rim of the wheel; by default the largest known speed of all items.

    Returns
    -------
    matplotlib.figure.Figure
        The pictures in rows, the wheel at their right.

    Raises
    ------
    InputError
        If there is no item, a flow is not (2, H, W), or `max_motion` is not positive.
    """
    flows = [checked_flow(flow) for _, flow in items]
    rim = max_motion if max_motion is not None else max(map(fastest, flows), default=0.0) or 1.0
    with house_style():
        fig, axes, side = picture_grid([flow.shape[1:] for flow in flows], columns)
        for ax, (title, _), flow in zip(axes, items, flows, strict=True):
            ax.imshow(flow_to_color(flow, rim))
            ax.set_title(title)
        side.imshow(color_wheel(256))
        dark = "" if all(known_pixels(flow).all() for flow in flows) else "\nblack: unknown"
        side.set_anchor("N")
        side.text(
            0.5,
            -0.08,
            f"rim: {rim:.3g} px{dark}",
            ha="center",
            va="top",
            fontsize=8.5,
            transform=side.transAxes,
        )
    return fig


def error_maps(items: Sequence[Item], vmax: float | None = None, *, columns: int = 3) -> Figure:
    """Show maps of the endpoint error, all on one colour scale.

    Parameters
    ----------
    items : sequence of (str, numpy.ndarray)
        Titles and (H, W) endpoint errors in pixels; NaN, where the truth is unknown, is gray.
    vmax : float, optional
        Error in pixels at the top of the scale; by default the 99th percentile of all finite errors.
    columns : int, optional
        Pictures in a row, at most.

    Returns
    -------
    matplotlib.figure.Figure
        The maps in rows, the colour bar at their right.

    Raises
    ------
    InputError
        If there is no item, a map is not (H, W), or `vmax` is not positive.
    """
    import matplotlib

    maps = [_error_map(title, error) for title, error in items]
    known = np.concatenate([m[np.isfinite(m)] for m in maps]) if maps else np.empty(0)
    top = vmax if vmax is not None else (float(np.percentile(known, 99)) if known.size else 0.0) or 1.0
    if not (math.isfinite(top) and top > 0):
        raise InputError(f"error_maps: `vmax` must be a positive number of pixels, got {vmax}")
    cmap = matplotlib.colormaps["inferno"].with_extremes(bad=MISSING)
    with house_style():
        fig, axes, side = picture_grid([m.shape for m in maps], columns)
        for ax, (title, _), error in zip(axes, items, maps, strict=True):
            image = ax.imshow(error, cmap=cmap, vmin=0.0, vmax=top)
            ax.set_title(title)
        bar = side.inset_axes((0.05, 0.0, 0.2, 1.0))
        above = "max" if (known > top).any() else "neither"
        fig.colorbar(image, cax=bar, extend=above, label="endpoint error [px]")
    return fig


def _error_map(title: str, error: NDArray[Any]) -> NDArray[np.float64]:
    values = np.asarray(error, dtype=np.float64)
    if values.ndim != 2:
        raise InputError(f"error_maps: {title!r} must have shape (H, W), got {values.shape}")
    return values


def _draw_box(ax: Axes, letter: str, box: Box) -> None:
    from matplotlib.patches import Rectangle

    if letter not in _BOX_COLOURS:
        raise unknown_name("letter of a box", letter, _BOX_COLOURS)
    first_row, stop_row, first_column, stop_column = box
    colour = _BOX_COLOURS[letter]
    # Pixel centres are whole numbers: the edge of a box is half a pixel before its first one.
    corner = (first_column - 0.5, first_row - 0.5)
    size = (stop_column - first_column, stop_row - first_row)
    ax.add_patch(Rectangle(corner, *size, fill=False, edgecolor="white", linewidth=3.0))
    ax.add_patch(Rectangle(corner, *size, fill=False, edgecolor=colour, linewidth=1.8))
    paper = {"facecolor": colour, "edgecolor": "white", "linewidth": 0.8, "pad": 1.5}
    place = (first_column, first_row)
    ax.annotate(
        letter, place, xytext=(5, -4), textcoords="offset points", va="top", color="white", bbox=paper, fontsize=8
    )
