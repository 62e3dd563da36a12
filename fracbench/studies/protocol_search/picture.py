"""The picture of a search: the least distance with each switch forced to each value."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: The darkest colour is this many times the least distance.
_FAR = 3.0
_ROW = 0.24  # height, inches
_LONG = 10  # letters that fit a cell


def value_grid(switches: pd.DataFrame, values: pd.DataFrame, least: float) -> Figure:
    """Draw a row for each switch, its values in cells coloured by the least distance with them; beside,
    importance.

    `switches` and `values` are tables of `analysis` for the same methods, `least` is the least distance.
    """
    from matplotlib.patches import Rectangle

    from fracbench.figures.style import MISSING, PALETTE, house_style, new_figure

    ordered = switches.sort_values("least distance with another", ascending=False, kind="stable")
    names = list(ordered["switch"])
    with house_style():
        fig = new_figure(_ROW * len(names) + 1.4)
        left, right = fig.subplots(1, 2, width_ratios=[6, 1], sharey=True)
        cells = np.full((len(names), int(values.groupby("switch").size().max())), np.nan)
        for row, name in enumerate(names):
            mine = values[values["switch"] == name]
            with np.errstate(divide="ignore"):
                cells[row, : len(mine)] = mine["least distance"].to_numpy() / least
            best = ordered["best value"].iloc[row]
            for column, (value, ratio) in enumerate(zip(mine["value"], cells[row], strict=False)):
                if not math.isfinite(ratio):
                    left.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, color=MISSING))
                if value == best:
                    box = Rectangle((column - 0.46, row - 0.44), 0.92, 0.88, fill=False, lw=1.6, ec=PALETTE[1])
                    left.add_patch(box)
                dark = not math.isfinite(ratio) or ratio > math.sqrt(_FAR) * 1.15
                long = len(value) > _LONG
                text, size = (value.replace("_", "\n", 1), 4.2) if long else (value, 5.5)
                look = {"fontsize": size, "color": "w" if dark else "k", "linespacing": 0.9}
                left.text(column, row, text, ha="center", va="center", **look)
        shown = np.where(np.isfinite(cells), np.clip(cells, 1.0, _FAR), np.nan)
        image = left.imshow(shown, cmap="Blues", vmin=1.0, vmax=_FAR, aspect="auto", interpolation="nearest")
        left.set_yticks(range(len(names)), names, fontsize=7)
        left.set_xticks([])
        left.set_xlabel("values of the switch, as in the search's file (framed: the nearest run)")
        right.barh(range(len(names)), ordered["importance"], color=PALETTE[0], height=0.7)
        right.set_xlabel("importance")
        for ax in (left, right):
            ax.grid(visible=False)
        fig.colorbar(
            image,
            ax=[left, right],
            location="bottom",
            shrink=0.6,
            aspect=40,
            label=f"least distance with the value, over that of the nearest run ({least:.3f}); gray: no whole run",
        )
    return fig
