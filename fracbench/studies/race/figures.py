"""The benchmark's table and its picture of error against time."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def summarise(records: Sequence[Mapping[str, Any]], yardstick: str) -> pd.DataFrame:
    """Return one row a contender: means over the sequences, fastest first.

    Parameters
    ----------
    records : sequence of mapping
        From `fracbench.studies.race.measure.run`.
    yardstick : str
        The contender that times are relative to; the ratio is NaN if it did not run.

    Returns
    -------
    pandas.DataFrame
        ``contender, seconds, ratio, aae, aepe, peak_mib``; `seconds` is the mean over the sequences of the
        median over the rounds, `ratio` the quotient of two such means.
    """
    import pandas as pd

    table = pd.DataFrame.from_records(list(records))
    means = table.groupby("contender", sort=False)[["seconds", "aae", "aepe"]].mean()
    means["peak_mib"] = table.groupby("contender", sort=False)["peak_mib"].max()
    base = means["seconds"].get(yardstick, float("nan"))
    means.insert(1, "ratio", means["seconds"] / base)
    return means.sort_values("seconds").reset_index()


def error_against_time(summary: pd.DataFrame, title: str) -> Figure:
    """Draw each contender's mean AEPE against its mean time, both logarithmic: ours as discs, peers as squares.

    Contenders whose names differ only in alpha share a colour and a line.

    Parameters
    ----------
    summary : pandas.DataFrame
        From `summarise`.
    title : str
        Heading.

    Returns
    -------
    matplotlib.figure.Figure
        One panel, its legend beside it.
    """
    from fracbench.figures.style import PALETTE, house_style, new_figure

    names = summary["contender"].str.partition(" alpha ")
    colors = {"o": itertools.cycle(PALETTE), "s": itertools.cycle(PALETTE)}
    with house_style():
        figure = new_figure(4.6)
        axes = figure.subplots()
        axes.set(xscale="log", yscale="log", xlabel="seconds a sequence", ylabel="mean AEPE [px]", title=title)
        for family, rows in summary.groupby(names[0], sort=False):
            alphas = names[2][rows.index].sort_values()
            marker = "s" if str(family).startswith(("opencv_", "skimage_")) else "o"
            axes.plot(
                rows["seconds"][alphas.index],
                rows["aepe"][alphas.index],
                marker=marker,
                linewidth=1,
                color=next(colors[marker]),
                label=f"{family}, alpha {', '.join(alphas)}" if alphas.any() else family,
            )
        figure.legend(loc="outside right upper")
    return figure
