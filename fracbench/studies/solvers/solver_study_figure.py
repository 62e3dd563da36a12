"""The figure of the solver study: spectral radii, sweeps needed, and the errors of whole runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.figures.style import METRICS, PALETTE, STAR, axis_label, house_style, new_figure, plain_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour, marker and name of the solvers.
_LINES = {
    "jacobi": (PALETTE[1], "o", "Jacobi (printed)"),
    "gauss_seidel": (PALETTE[2], "s", "Gauss-Seidel"),
    "exact": (PALETTE[0], "D", "exact"),
}
_FAMILY_MARKERS = ("o", "s", "D", "^", "v", "P")
_LIMIT: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": ":"}


def solver_panels(spectra: pd.DataFrame, runs: pd.DataFrame, summary: pd.DataFrame, title: str) -> Figure:
    """Draw the sweeps' radii and counts in three panels, and the AEPE of whole runs in one a region."""
    n_rows = 1 + -(-len(summary) // 3)
    with house_style():
        fig = new_figure(2.6 * n_rows + 0.7)
        fig.suptitle(title)
        grid = fig.add_gridspec(n_rows, 3)
        system = [fig.add_subplot(grid[0, i]) for i in range(3)]
        _draw_spectra(system, spectra)
        for i, (_, row) in enumerate(summary.iterrows()):
            ax = fig.add_subplot(grid[1 + i // 3, i % 3])
            _draw_region(ax, runs[runs["region"] == row["region"]], row)
        handles, labels = ax.get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=3)
    return fig


def _draw_spectra(axes: list[Axes], spectra: pd.DataFrame) -> None:
    columns = ("jacobi radius", "gauss_seidel radius", "sweeps")
    titles = ("Jacobi: spectral radius", "Gauss-Seidel: spectral radius", "sweeps needed (dashed: Jacobi)")
    for ax, column, title in zip(axes, columns, titles, strict=True):
        ax.set(xlabel=axis_label("alpha"), title=title)
        for i, (_, part) in enumerate(spectra.groupby("region", sort=False)):
            theta, mu = part[["theta", "lambda_sb"]].iloc[0]
            look: dict[str, Any] = {"color": PALETTE[i % len(PALETTE)], "marker": _FAMILY_MARKERS[i % 6]}
            look |= {"markersize": 3, "linewidth": 1.1}
            if column == "sweeps":
                _draw_counts(ax, part, look)
            else:
                ax.plot(part["alpha"], part[column], label=rf"$\theta$ {theta:g}, $\lambda_{{SB}}$ {mu:g}", **look)
    axes[0].axhline(1.0, **_LIMIT)
    axes[0].legend(fontsize=7, handlelength=1.2, labelspacing=0.25, borderaxespad=0.1)
    axes[2].set_yscale("log")
    axes[2].yaxis.set_major_formatter("{x:g}")


def _draw_counts(ax: Axes, part: pd.DataFrame, look: dict[str, Any]) -> None:
    """Draw both sweeps' counts, Jacobi's dashed; where it diverges there is nothing to draw."""
    for sweep, style in (("jacobi", "--"), ("gauss_seidel", "-")):
        counts = part[f"{sweep} sweeps"].to_numpy(np.float64, na_value=np.nan)
        ax.plot(part["alpha"], counts, linestyle=style, **look)


def _draw_region(ax: Axes, curves: pd.DataFrame, row: pd.Series) -> None:
    ax.set(xlabel=axis_label("alpha"), ylabel=METRICS["aepe"], title=str(row["region"]))
    for solver, (color, marker, name) in _LINES.items():
        curve = curves[curves["u_solver"] == solver].sort_values("alpha")
        ax.plot(curve["alpha"], curve["aepe"], color=color, marker=marker, markersize=3, linewidth=1.2, label=name)
        best = row[f"aepe {solver}"]
        if np.isfinite(best):
            ax.plot([best], [row[f"aepe {solver} error"]], **{**STAR, "markersize": 9}, color=color)
    ax.axvline(row["limit"], label="u-system alone: Jacobi diverges beyond", **_LIMIT)
    ax.axvline(row["aepe paper"], color="#404040", linewidth=0.9, linestyle="-", label="best in the paper")
    if (curves["aepe"] > 0).any():
        ax.set_yscale("log")
        plain_ticks(ax.yaxis)
