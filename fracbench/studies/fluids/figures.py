"""Figures of errors of flows of fluids: tables in, figures out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fracbench.figures.style import (
    BEHIND,
    PALETTE,
    STAR,
    axis_label,
    house_style,
    label_outer,
    new_figure,
    plain_ticks,
)
from fracbench.studies.fluids.tables import ALPHA_1, MEAN, OPENPIV, OURS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Lines of the methods: colour and marker; ours and OpenPIV stand out.
_LOOKS: Mapping[str, tuple[str, str, str]] = {
    OURS: (PALETTE[0], "o", "-"),
    ALPHA_1: (PALETTE[5], "o", "--"),
    OPENPIV: (PALETTE[1], "s", "-"),
    f"{OPENPIV}, windows to 32 px": (PALETTE[1], "s", "--"),
    f"{OPENPIV}, symmetric": (PALETTE[1], "D", ":"),
    "OpenCV DIS": (PALETTE[2], "^", "-"),
    "OpenCV Farneback": (PALETTE[2], "v", "--"),
    "OpenCV DualTVL1": (PALETTE[2], "P", ":"),
    "scikit-image TV-L1": (PALETTE[3], "^", "-"),
    "scikit-image iLK": (PALETTE[3], "v", "--"),
}
_LABELS: Mapping[str, tuple[str, bool]] = {
    "density": ("particles a pixel", True),
    "noise": ("noise [gray levels]", False),
    "lost": ("share of lost pairs", False),
    "displacement": ("largest displacement [px]", True),
    "gradient": ("local gradient [px / px]", False),
}


def order_panels(orders: pd.DataFrame, flows: pd.DataFrame, title: str) -> Figure:
    """Draw AEPE against the order, a panel for each flow, with the interval over seeds.

    The dotted line has the best weight of the data for each order; level lines are OpenPIV and the best of others.
    """
    panels = list(orders.groupby(["dataset", "flow"], sort=False))
    columns = min(4, len(panels))
    n_rows = -(-len(panels) // columns)
    with house_style():
        fig = new_figure(1.75 * n_rows + 1.2)
        fig.suptitle(title)
        grid = fig.subplots(n_rows, columns, sharex=True, squeeze=False)
        for ax, ((dataset, flow), part) in zip(grid.flat, panels, strict=False):
            others = flows[(flows["dataset"] == dataset) & (flows["flow"] == flow)].set_index("method")["aepe"]
            _draw_orders(ax, part.sort_values("alpha"), others)
            ax.set_title(_short(str(flow)) if flow != MEAN else f"{MEAN}, {dataset}", fontsize=8.5)
        label_outer(grid, len(panels), axis_label("alpha"), "AEPE [px]")
        _legend(fig, grid.flat, 2)
    return fig


def _draw_orders(ax: Axes, part: pd.DataFrame, others: pd.Series) -> None:
    ax.fill_between(part["alpha"], part["aepe_low"], part["aepe_high"], color=PALETTE[0], alpha=0.2, linewidth=0)
    ax.plot(
        part["alpha"], part["aepe"], color=PALETTE[0], marker="o", markersize=3, label="one order, protocol fluid"
    )
    words = "one order, best weight of the data for each"
    ax.plot(part["alpha"], part["best_aepe"], color=PALETTE[5], linewidth=1.0, linestyle=":", label=words)
    if part["aepe"].notna().any():
        best = part.loc[part["aepe"].idxmin()]
        ax.plot([best["alpha"]], [best["aepe"]], **{**STAR, "markersize": 9}, color=PALETTE[0])
    rest = others[[not name.startswith((OPENPIV, OURS, ALPHA_1)) for name in others.index]].dropna()
    if OPENPIV in others and others[OPENPIV] == others[OPENPIV]:
        ax.axhline(others[OPENPIV], color=PALETTE[1], linewidth=1.2, label=OPENPIV)
    if len(rest):
        ax.axhline(
            rest.min(), color=BEHIND, linewidth=1.2, linestyle="--", label="best of OpenCV and scikit-image"
        )
    _log_errors(ax, part["aepe"])
    top = np.nanmax([*part["aepe"][part["alpha"] >= 1.0], *others, 0.0])
    if 0.0 < top < part["aepe"].max():
        ax.set_ylim(top=1.5 * top)  # orders below 1 fail: their curve leaves the panel


def setting_panels(settings: pd.DataFrame, gradients: pd.DataFrame, title: str) -> Figure:
    """Draw AEPE against each setting of the images, and against the local gradient; a line for each method."""
    names = list(dict.fromkeys(settings["setting"]))
    tables = [(name, settings[settings["setting"] == name], "value") for name in names]
    tables += [("gradient", gradients, "gradient")] if len(gradients) else []
    columns = min(3, len(tables))
    n_rows = -(-len(tables) // columns)
    with house_style():
        fig = new_figure(2.6 * n_rows + 1.0)
        fig.suptitle(title)
        grid = fig.subplots(n_rows, columns, squeeze=False)
        for ax, (name, table, x) in zip(grid.flat, tables, strict=False):
            label, logarithmic = _LABELS[name]
            for method, part in table.groupby("method", sort=False):
                part = part.sort_values(x)
                color, _, _ = _look(str(method))
                ax.plot(part[x], part["aepe"], label=method, **_line(str(method)))
                if method in (OURS, OPENPIV):
                    ax.fill_between(
                        part[x],
                        part["aepe_low"].clip(lower=1e-4),
                        part["aepe_high"],
                        color=color,
                        alpha=0.2,
                        linewidth=0,
                    )
            if logarithmic:
                ax.set_xscale("log")
                plain_ticks(ax.xaxis, (2.0,) if name == "density" else (1.0, 2.0, 5.0))
            ax.set_xlabel(label)
            _log_errors(ax, table["aepe"])
            if (table["aepe"] > 0).any():  # the lines set the scale: an interval of few seeds may reach down to 0
                ax.set_ylim(0.6 * table["aepe"].min(), 1.6 * table["aepe"].max())
        for ax in grid.flat[len(tables) :]:
            ax.set_axis_off()
        for row in grid:
            row[0].set_ylabel("AEPE [px]")
        _legend(fig, grid.flat, 3)
    return fig


def flow_panels(flows: pd.DataFrame, title: str) -> Figure:
    """Draw AEPE and the RMS error of vorticity on OpenPIV's grid: a line for each flow, a mark for each method."""
    rows = flows.drop_duplicates(["dataset", "flow"])[["dataset", "flow"]].to_records(index=False).tolist()
    heights = {key: -i for i, key in enumerate(rows)}
    scores = {"aepe": "AEPE [px]", "vorticity_grid": "RMS error of vorticity, on the grid of OpenPIV [1 / frame]"}
    with house_style():
        fig = new_figure(0.24 * len(rows) + 1.9)
        fig.suptitle(title)
        axes = fig.subplots(1, len(scores), sharey=True)
        for ax, (score, label) in zip(axes, scores.items(), strict=True):
            for method, part in flows.groupby("method", sort=False):
                places = [heights[key] for key in zip(part["dataset"], part["flow"], strict=True)]
                look = {**_line(str(method)), "linestyle": "none", "markersize": 5}
                ax.plot(part[score], places, label=method, **look)
            _log_errors(ax, flows[score], "x")
            ax.set_xlabel(label, fontsize=8)
        names = [f"{MEAN}, {dataset}" if flow == MEAN else _short(flow) for dataset, flow in rows]
        axes[0].set_yticks(list(heights.values()), names)
        _legend(fig, axes, 3)
    return fig


def _short(flow: str) -> str:
    """Return a flow's name for a title: pairs of Cai et al. have long ones."""
    return flow.removesuffix("_00001").replace("_isotropic1024_hd", "")


def _look(method: str) -> tuple[str, str, str]:
    return _LOOKS.get(method, (PALETTE[6], "x", "-"))


def _line(method: str) -> dict[str, Any]:
    color, marker, style = _look(method)
    wide = method in (OURS, OPENPIV)
    return {
        "color": color, "marker": marker, "linestyle": style, "markersize": 4 if wide else 3,
        "linewidth": 1.8 if wide else 1.0, "zorder": 3 if wide else 2,
        "fillstyle": "none" if style == "--" else "full",
    }  # fmt: skip


def _log_errors(ax: Axes, errors: pd.Series, axis: Literal["x", "y"] = "y") -> None:
    """Make the axis of errors logarithmic; where all points have failed, matplotlib refuses that."""
    if (errors > 0).any():
        ax.set(**{f"{axis}scale": "log"})
        plain_ticks(ax.yaxis if axis == "y" else ax.xaxis, (1.0, 2.0, 5.0))


def _legend(fig: Figure, axes: Iterable[Axes], columns: int) -> None:
    found = [zip(*ax.get_legend_handles_labels(), strict=True) for ax in axes]
    handles = {label: handle for pairs in found for handle, label in pairs}
    fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)
