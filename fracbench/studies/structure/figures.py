"""Figures of errors against alpha by structure, and pictures of the classes: tables and arrays in, figures out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.figures.style import PALETTE, SHADE, STAR, axis_label, house_style, label_outer, new_figure
from fracbench.model.structure import CLASSES, structure_classes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The word for a class's colour, and the colour.
_COLOURS = ("gray", "#808080"), ("blue", PALETTE[0]), ("red", PALETTE[1]), ("green", PALETTE[2])
CLASS_COLOURS: Mapping[str, tuple[str, str]] = dict(zip(CLASSES, _COLOURS, strict=True))
_ORDER = (*SINGLE_STRUCTURE, "all", *CLASSES)
_BOUNDARIES = {"zero": (PALETTE[1], "s"), "reflect": (PALETTE[0], "o")}
#: Ratios above this are cut off: the differences of interest are near 1.
_TOP = 2.0
_VEIL = 0.5


def structure_panels(curves: pd.DataFrame, paper: Mapping[str, tuple[float, float]], title: str) -> Figure:
    """Draw errors relative to alpha = 1, a panel for each structure, in it a line with its interval by boundary.

    `curves`: one part, one noise and one error of `fracbench.studies.structure.tables.curve_table`. `paper`: the
    range of best alphas by structure, which is shaded. Minima are starred.
    """
    names = sorted(curves["structure"].unique(), key=lambda name: (*_ORDER, name).index(name))
    columns = min(3, len(names))
    n_rows = -(-len(names) // columns)
    with house_style():
        fig = new_figure(2.4 * n_rows + 1.0)
        fig.suptitle(title)
        grid = fig.subplots(n_rows, columns, sharex=True, sharey=True, squeeze=False)
        lowest = 1.0
        for ax, name in zip(grid.flat, names, strict=False):
            lowest = min(lowest, _draw_panel(ax, curves[curves["structure"] == name], paper.get(name)))
            ax.set_title(name.removeprefix("lone_"))
        grid[0, 0].set_ylim(max(0.0, lowest - 0.05), _TOP)
        label_outer(grid, len(names), axis_label("alpha"), "error / error at 1")
        found = [zip(*ax.get_legend_handles_labels(), strict=True) for ax in grid.flat]
        handles = {label: handle for pairs in found for handle, label in pairs}
        fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)
    return fig


def _draw_panel(ax: Axes, curves: pd.DataFrame, said: tuple[float, float] | None) -> float:
    """Draw one structure and return the smallest ratio shown."""
    if said is not None:
        ax.axvspan(*said, color=SHADE, zorder=0, label="best in the paper")
    ax.axhline(1.0, color="black", linewidth=0.7)
    lowest = 1.0
    for boundary, part in curves.groupby("boundary", sort=False):
        color, marker = _BOUNDARIES.get(str(boundary), (PALETTE[2], "D"))
        part = part.sort_values("alpha")
        ax.fill_between(part["alpha"], part["low"], part["high"], color=color, alpha=0.2, linewidth=0)
        look: dict[str, Any] = {"color": color, "marker": marker, "markersize": 3, "linewidth": 1.3}
        ax.plot(part["alpha"], part["ratio"], label=f"boundary {boundary}, with 95 % interval", **look)
        best = part.loc[part["ratio"].idxmin()]
        ax.plot([best["alpha"]], [best["ratio"]], **{**STAR, "markersize": 10}, color=color)
        lowest = min(lowest, part["ratio"].min(), part["low"].min())
    ax.set_xticks([0.0, 0.5, 1.0, 1.5, 2.0])
    return lowest


def class_overlay(frame: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return a gray frame, 0..255, under a veil in the colours of its classes: (H, W, 3) of uint8."""
    return veiled(frame, structure_classes(frame), [colour for _, colour in CLASS_COLOURS.values()])


def veiled(frame: NDArray[Any], indices: NDArray[Any], colours: Sequence[Any]) -> NDArray[np.uint8]:
    """Return a gray frame, 0..255, under a veil in the colours of its pixels' indices: (H, W, 3) of uint8."""
    from matplotlib.colors import to_rgb

    palette = np.array([to_rgb(colour) for colour in colours]) * 255.0
    mixed = (1.0 - _VEIL) * np.clip(frame, 0.0, 255.0)[..., None] + _VEIL * palette[indices]
    return np.rint(mixed).astype(np.uint8)
