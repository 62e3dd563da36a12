"""The figures: tidy tables in, matplotlib figures out. No file is read or written here.

Tables hold one row a point, with the swept keys and the columns ``aae`` (radians) and ``aepe`` (pixels). A
point whose error is not finite, because it failed or diverged, is a gap in its curve or a gray cell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.errors import InputError, unknown_name
from fracbench.figures.style import (
    METRICS,
    MISSING,
    PALETTE,
    SHADE,
    STAR,
    axis_label,
    caption_style,
    equation,
    house_style,
    legend_below,
    method_lines,
    new_figure,
    plain_ticks,
    symbol,
    two_panels,
    write_below,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The markers of the paper's figures 3 and 4, in the order of their captions.
MARKERS = ("o", "*", "x", "D", "^", "+")
#: Those of `alpha_curves`, where a star stands for a minimum.
_CURVE_MARKERS = ("o", "s", "D", "^", "v", "P")
#: The ring about a point at 0.
RING: Mapping[str, Any] = {"marker": "o", "color": "none", "markeredgecolor": "#404040", "linestyle": "none"}
_MAX_TICKS = 11
# Drawn at one size, these look smaller than a disc.
_SMALL_MARKERS = {"*": 8.5, "x": 6.5, "+": 8.0}


def alpha_curves(
    table: pd.DataFrame,
    *,
    x: str = "alpha",
    hue: str | None = None,
    title: str = "",
    logx: bool = False,
    zero_note: str = "",
) -> Figure:
    """Draw both errors against a swept key, with the minimum of each curve marked and named.

    Rows, one a point, come in any order; the column `hue` tells the curves apart, without it there is one. With
    `zero_note`, a remark on the point `x` = 0, that point is ringed and explained below the panels.
    """
    curves = split_curves(table, x, hue, logx)
    with house_style():
        fig, axes = two_panels(title)
        for ax, metric in zip(axes, METRICS, strict=True):
            _start_axes(ax, x, metric, logx)
            for i, (value, part) in enumerate(curves.items()):
                look: dict[str, Any] = {
                    "color": PALETTE[i % len(PALETTE)],
                    "marker": _CURVE_MARKERS[i % len(_CURVE_MARKERS)],
                }
                label = equation(hue, value) if hue else None
                _draw_curve(ax, part, x, metric, look, label, name_minimum=len(curves) == 1)
                if zero_note:
                    ring_zero(ax, part, x, metric)
        legend_below(fig)
        if zero_note and any((part[x] == 0).any() for part in curves.values()):
            fig.supxlabel(f"ringed: {symbol(x)} = 0, {zero_note}", fontsize=8.5)
    return fig


def line_family(
    table: pd.DataFrame,
    *,
    x: str,
    family: str,
    title: str = "",
    styles: Sequence[str] = (),
    logx: bool = False,
    logy: bool = False,
    shade: tuple[float, float] | None = None,
) -> Figure:
    """Draw both errors against `x`, a line for each value of `family` and each method (figures 2-4).

    The values differ in marker and colour, the methods in the line's style: TV-L1 dashed, TV-L1-SB solid. With
    `styles`, for a single method, the caption gives line and marker of each value, e.g. ``"--*"`` or ``"-."``.
    `shade` is the range of `x` where the paper finds the errors smallest.
    """
    from matplotlib.lines import Line2D

    _need_columns(table, [family, "method"])
    lines = method_lines(_values(table["method"]))
    captions: list[tuple[Any, str]] = [*map(caption_style, styles)] or [("", marker) for marker in MARKERS]
    with house_style():
        fig, axes = two_panels(title)
        for ax, metric in zip(axes, METRICS, strict=True):
            _start_axes(ax, x, metric, logx)
            if logy:
                ax.set_yscale("log")
                plain_ticks(ax.yaxis)
        handles: list[Any] = []
        for i, value in enumerate(_values(table[family])):
            line, marker = captions[i % len(captions)]
            look: dict[str, Any] = {
                "color": PALETTE[i % len(PALETTE)],
                "marker": marker,
                "markersize": _SMALL_MARKERS.get(marker, 5),
            }
            handles.append(Line2D([], [], label=equation(family, value), linestyle=line or "-", **look))
            rows = table[table[family] == value]
            for method, part in split_curves(rows, x, "method", logx).items():
                style = line or lines[method][1]
                for ax, metric in zip(axes, METRICS, strict=True):
                    ax.plot(part[x], part[metric], linestyle=style, **look)
        if not styles:
            handles += [
                Line2D([], [], label=name, linestyle=style, color="black") for name, style in lines.values()
            ]
        if shade:
            handles += [ax.axvspan(*shade, color=SHADE, zorder=0, label="best in the paper") for ax in axes][:1]
        fig.legend(handles=handles, loc="outside right center", handlelength=3.2)
    return fig


def heat_map(table: pd.DataFrame, *, x: str, y: str, title: str = "") -> Figure:
    """Draw the errors of a two-key sweep as maps, with the best cell marked and named.

    Cells are equally large whatever the grid's spacing; one without a point is gray.
    """
    _need_columns(table, [x, y, *METRICS])
    if table.duplicated([x, y]).any():
        raise InputError(f"heat_map: several rows share one ({x}, {y}); select one region and method first")
    with house_style():
        fig = new_figure(3.7)
        fig.suptitle(title)
        for ax, metric in zip(fig.subplots(1, len(METRICS)), METRICS, strict=True):
            _draw_cells(ax, table.pivot(index=y, columns=x, values=metric), metric)
    return fig


def _need_columns(table: pd.DataFrame, columns: Sequence[str]) -> None:
    for column in columns:
        if column not in table.columns:
            raise unknown_name("column", column, map(str, table.columns))
    if not len(table):
        raise InputError(f"the table to draw has no rows (columns: {', '.join(map(str, table.columns))})")


def _values(column: pd.Series) -> list[Any]:
    """Return the distinct values: numbers in rising order, names as they come."""
    distinct = column.dropna().unique().tolist()
    return sorted(distinct) if column.dtype.kind in "iuf" else distinct


def split_curves(table: pd.DataFrame, x: str, hue: str | None, logx: bool) -> dict[Any, pd.DataFrame]:
    """Split a table into curves by `hue`, sorted by `x`, with NaN for errors that are not finite."""
    _need_columns(table, [x, *METRICS, *([hue] if hue else [])])
    try:
        numbers = table.astype(dict.fromkeys((x, *METRICS), float))
    except (TypeError, ValueError) as exc:
        raise InputError(f"columns {x!r}, 'aae' and 'aepe' must hold numbers: {exc}") from exc
    if not np.isfinite(numbers[x]).all() or (logx and (numbers[x] <= 0).any()):
        raise InputError(f"column {x!r} must hold {'positive' if logx else 'finite'} numbers")
    numbers = numbers.replace([np.inf, -np.inf], np.nan).sort_values(x, kind="stable")
    curves = {v: numbers[numbers[hue] == v] for v in _values(table[hue])} if hue else {None: numbers}
    for value, part in curves.items():
        if part[x].duplicated().any():
            where = f" with {hue} = {value}" if hue else ""
            again = part[x][part[x].duplicated()].iloc[0]
            raise InputError(f"several rows{where} share {x} = {again:g}: give the column that tells them apart")
    return curves


def _start_axes(ax: Axes, x: str, metric: str, logx: bool) -> None:
    ax.set(xlabel=axis_label(x), ylabel=METRICS[metric], xscale="log" if logx else "linear")
    if logx:
        plain_ticks(ax.xaxis, (1.0,))
    ax.margins(x=0.04, y=0.1)


def draw_band(ax: Axes, band: pd.DataFrame, x: str, metric: str, label: str) -> None:
    """Fill the range between the columns ``METRIC_low`` and ``METRIC_high``."""
    low, high = f"{metric}_low", f"{metric}_high"
    _need_columns(band, [x, low, high])
    band = band.sort_values(x)
    ax.fill_between(band[x], band[low], band[high], color=PALETTE[0], alpha=0.16, linewidth=0, label=label)


def _draw_curve(
    ax: Axes,
    part: pd.DataFrame,
    x: str,
    metric: str,
    look: Mapping[str, Any],
    label: str | None,
    name_minimum: bool,
) -> None:
    """Draw one curve and its minimum, whose place is named there or, among several curves, in the legend."""
    (line,) = ax.plot(part[x], part[metric], label=label, **look)
    if part[metric].notna().any():
        best = part.loc[part[metric].idxmin()]
        text = f"min at {equation(x, best[x])}"
        ax.plot([best[x]], [best[metric]], gid="minimum", **STAR, color=look["color"])
        if name_minimum:
            write_below(ax, best[x], best[metric], text)
    else:
        text = "no finite error"
    if label is not None and not name_minimum:
        line.set_label(f"{label}: {text}")


def ring_zero(ax: Axes, part: pd.DataFrame, x: str, metric: str) -> None:
    """Ring the point at 0 of a curve, if it has one."""
    zero = part[part[x] == 0]
    ax.plot(zero[x], zero[metric], gid="zero", markersize=12, zorder=4, **RING)


def _draw_cells(ax: Axes, cells: pd.DataFrame, metric: str) -> None:
    """Draw one panel of `heat_map`: rows of `cells` upwards, its best cell starred and named in the title."""
    import matplotlib

    grid = cells.to_numpy(dtype=np.float64)
    grid = np.where(np.isfinite(grid), grid, np.nan)
    cmap = matplotlib.colormaps["cividis"].with_extremes(bad=MISSING)
    image = ax.imshow(grid, cmap=cmap, origin="lower", aspect="auto")
    ax.figure.colorbar(image, ax=ax, label=METRICS[metric])
    ax.grid(False)
    x, y = str(cells.columns.name), str(cells.index.name)
    ax.set(xlabel=axis_label(x), ylabel=axis_label(y))
    for axis, ticks in ((ax.xaxis, cells.columns), (ax.yaxis, cells.index)):
        step = math.ceil(len(ticks) / _MAX_TICKS)
        axis.set_ticks(range(0, len(ticks), step), [f"{tick:g}" for tick in ticks[::step]])
    if np.isnan(grid).all():
        ax.set_title("no finite error")
        return
    row, column = np.unravel_index(np.nanargmin(grid), grid.shape)
    ax.plot([column], [row], gid="minimum", **STAR, color="white")
    ax.set_title(f"min at {equation(x, cells.columns[column])}, {equation(y, cells.index[row])}")
