"""The benchmark's table and its picture of error against time."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def summarise(records: Sequence[Mapping[str, Any]], yardstick: str) -> pd.DataFrame:
    """Return one row per contender, fastest first: the means over the sequences.

    `ratio` divides the mean seconds by those of the contender `yardstick`; it is NaN if that one did not run.
    """
    import pandas as pd

    table = pd.DataFrame.from_records(list(records))
    means = table.groupby("contender", sort=False)[["seconds", "aae", "aepe"]].mean()
    means.insert(1, "ratio", means["seconds"] / means["seconds"].get(yardstick, float("nan")))
    return means.sort_values("seconds").reset_index()


def error_against_time(summary: pd.DataFrame, title: str) -> Figure:
    """Draw each contender's mean AEPE against its mean time, both logarithmic: ours as discs, peers as squares.

    Contenders whose names differ only in alpha share a colour and a line.
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
