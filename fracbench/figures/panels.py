"""A grid of panels: one column a region, one row an error, each with curves, a band and the paper's best value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.figures.curves import RING, draw_band, ring_zero, split_curves
from fracbench.figures.style import (
    METRICS,
    PALETTE,
    STAR,
    axis_label,
    equation,
    house_style,
    new_figure,
    plain_ticks,
    symbol,
    write_below,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STAR: Mapping[str, Any] = {**STAR, "markersize": 11}
_PAPER: Mapping[str, Any] = {"marker": "v", "color": "black", "markersize": 5, "linestyle": "none"}


@dataclass(frozen=True)
class Curve:
    """A line of a panel: rows of the swept key, ``aae`` [rad] and ``aepe`` [px], and matplotlib's properties.

    Lines of one label share an entry of the legend. `starred` marks and names the minimum, `ringed` rings the
    point at 0.
    """

    points: pd.DataFrame
    label: str
    look: Mapping[str, Any]
    starred: bool = False
    ringed: bool = False


@dataclass(frozen=True)
class Panel:
    """The panel of one region and one error, with its curves from back to front.

    `band` is a range behind them: the swept key, and ``aae_low``, ``aae_high``, ``aepe_low``, ``aepe_high``;
    `published` is where the paper finds the minimum.
    """

    heading: str
    curves: Sequence[Curve]
    band: pd.DataFrame | None = None
    band_label: str = ""
    published: float | None = None


def panel_grid(
    regions: Sequence[str], compose: Callable[[str, str], Panel], *, x: str, title: str, note: str = ""
) -> Figure:
    """Draw both errors against a swept key, a column for each region.

    `compose` returns the panel of a region and an error; `note`, in the legend, explains the rings. The errors are
    on a logarithmic axis: equal heights are equal ratios, in a valley as beside it.
    """
    with house_style():
        fig = new_figure(6.2)
        fig.suptitle(title)
        grid = fig.subplots(len(METRICS), len(regions), sharex=True, squeeze=False)
        for row, metric in zip(grid, METRICS, strict=True):
            for ax, region in zip(row, regions, strict=True):
                _draw_panel(ax, compose(region, metric), x, metric)
            row[0].set_ylabel(METRICS[metric])
        for ax in grid[-1]:
            ax.set_xlabel(axis_label(x))
        _legend(fig, x, note)
    return fig


def _draw_panel(ax: Axes, panel: Panel, x: str, metric: str) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.set_yscale("log")
    ax.margins(x=0.05, y=0.08)
    plain_ticks(ax.yaxis)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.xaxis.set_major_formatter("{x:g}")
    if panel.band is not None:
        draw_band(ax, panel.band, x, metric, panel.band_label)
    minima = []
    for curve in panel.curves:
        part = split_curves(curve.points, x, None, False)[None]
        ax.plot(part[x], part[metric], label=curve.label, **curve.look)
        if curve.starred and part[metric].notna().any():
            best = part.loc[part[metric].idxmin()]
            ax.plot([best[x]], [best[metric]], gid="minimum", **_STAR, color=curve.look["color"])
            minima.append((best[x], best[metric], curve.look["color"]))
        if curve.ringed:
            ring_zero(ax, part, x, metric)
    if len(minima) == 1:
        place, error, _ = minima[0]
        write_below(ax, place, error, equation(x, place))
    elif minima:
        _write_in_a_row(ax, x, [(place, color) for place, _, color in minima])
    if panel.published is not None:
        edge = ax.get_xaxis_transform()  # across in data, up in parts of the panel: on its upper edge
        ax.plot([panel.published], [1.02], gid="published", transform=edge, clip_on=False, **_PAPER)
        said = f"paper: {panel.published:g}"
        place = (panel.published, 1.05)
        ax.annotate(said, place, xycoords=edge, ha="center", va="bottom", fontsize=8, annotation_clip=False)
    ax.set_title(panel.heading, pad=20 if panel.published is not None else 6)


def _write_in_a_row(ax: Axes, x: str, minima: Sequence[tuple[float, str]]) -> None:
    """Write places of minima above all curves: below a star there may be another curve."""
    low, high = np.log(ax.get_ylim())
    ax.set_ylim(top=float(np.exp(high + 0.12 * (high - low))))
    for i, (place, color) in enumerate(reversed(minima)):
        text = equation(x, place) if i == len(minima) - 1 else f"{place:g}"
        where = (0.97 - 0.16 * i, 0.97)
        ax.annotate(text, where, xycoords="axes fraction", ha="right", va="top", color=color, fontsize=9)


def _legend(fig: Figure, x: str, note: str) -> None:
    from matplotlib.lines import Line2D

    entries: dict[str, Any] = {}
    for ax in fig.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    entries[f"smallest error, and its {symbol(x)}"] = Line2D([], [], **_STAR, color=PALETTE[0])
    if any(line.get_gid() == "published" for ax in fig.axes for line in ax.lines):
        entries[f"best {symbol(x)} in the paper"] = Line2D([], [], **_PAPER)
    if note:
        entries[note] = Line2D([], [], markersize=9, **RING)
    fig.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=2)
