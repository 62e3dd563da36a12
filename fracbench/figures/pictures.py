"""A panel of frames with boxes drawn on them. No file is read or written here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from fracbench.errors import InputError, unknown_name
from fracbench.figures.style import PALETTE, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Box = tuple[int, int, int, int]  # first row, one past the last, first column, one past the last

_TITLE = 0.32  # inches
_BOX_COLOURS = {"A": PALETTE[1], "B": PALETTE[0]}


def frame_panel(
    items: Sequence[tuple[str, NDArray[Any]]],
    *,
    columns: int = 4,
    boxes: Sequence[Mapping[str, Box]] = (),
    title: str = "",
) -> Figure:
    """Show titled frames beside each other, (H, W, 3) uint8 or gray levels (H, W), with boxes drawn on them.

    `boxes` holds for each frame its boxes by the letter beside them: A is red, B blue, as in the paper's Figure 5.
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
