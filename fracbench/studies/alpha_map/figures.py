"""Figures of alpha by class of structure: tables and maps of orders in, figures and pictures out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.figures.style import PALETTE, house_style, new_figure
from fracbench.studies.alpha_map.tables import ESTIMATES
from fracbench.studies.structure.figures import CLASS_COLOURS, veiled

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Estimates that are drawn: colour, marker, whether filled.
_DRAWN: dict[str, tuple[str, str, bool]] = {
    "one": ("#808080", "|", True),
    "adaptive": (PALETTE[0], "o", True),
    "adaptive own": (PALETTE[0], "o", False),
    "run window": (PALETTE[1], "s", True),
    "least window": (PALETTE[1], "s", False),
    "run pixel": (PALETTE[2], "D", True),
    "least pixel": (PALETTE[2], "D", False),
}
_SCOPES = {"classes": "classes", "window": "best order about each pixel", "pixel": "best order at each pixel"}


def gain_panels(table: pd.DataFrame, confusion: pd.DataFrame, title: str) -> Figure:
    """Draw the gains against one alpha left out, a row a sequence, and the shares of each class's best orders."""
    names = list(dict.fromkeys(table["sequence"]))
    with house_style():
        fig = new_figure(0.36 * len(names) + 2.4)
        fig.suptitle(title)
        left, right = fig.subplots(1, 2, width_ratios=(3, 2))
        gains = table.pivot(index="sequence", columns="estimate", values="gain").loc[names]
        places = -np.arange(len(names))
        for name, (color, marker, filled) in _DRAWN.items():
            look: dict[str, Any] = {"color": color, "marker": marker, "linestyle": "none", "markersize": 6}
            look["markerfacecolor"] = color if filled else "none"
            left.plot(gains[name], places, label=ESTIMATES[name].replace(", by the truth", "*"), **look)
        left.axvline(0.0, color="black", linewidth=0.8)
        left.set(xlabel="AEPE below that of one alpha, left out [%]", yticks=places)
        left.set_yticklabels(names)
        left.axhline(places[-1] + 0.5, color="black", linewidth=0.5)
        _draw_confusion(right, confusion[confusion["scope"] == "window"] if len(confusion) else confusion)
        fig.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, title="* by the truth")
    return fig


def _draw_confusion(ax: Axes, shares: pd.DataFrame) -> None:
    """Draw the parts of each class's pixels as a table in colours."""
    ax.grid(visible=False)
    if not len(shares):
        ax.set_axis_off()
        return
    orders = [column for column in shares if column not in ("scope", "class", "pixels")]
    values = shares[orders].to_numpy(np.float64)
    ax.imshow(values, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    ax.set(
        xticks=range(len(orders)), yticks=range(len(shares)), xlabel=r"order $\alpha$ best in the neighbourhood"
    )
    ax.set_xticklabels(orders)
    ax.set_yticklabels(shares["class"])
    ax.set_title("% of the pixels of a class")
    for (i, j), value in np.ndenumerate(values):
        ax.text(j, i, f"{value:.0f}", ha="center", va="center", color="white" if value > 60.0 else "black")


def order_pictures(items: Sequence[tuple[Any, ...]]) -> list[tuple[str, NDArray[np.uint8]]]:
    """Paint gray frames, 0..255, under a veil of classes or orders; see `order_title` for the colours.

    Items are ``(sequence, frame, scope, map, alphas)`` with indices of classes or of alphas in the map.
    """
    return [
        (f"{name}\n{_SCOPES[scope]}", veiled(frame, found, _colours(scope, len(alphas))))
        for name, frame, scope, found, alphas in items
    ]


def order_title(alphas: Sequence[float]) -> str:
    """Return the legend of the colours of `order_pictures`."""
    words = ", ".join(f"{word} {name}" for name, (word, _) in CLASS_COLOURS.items())
    return (
        f"Classes of the first frame ({words}),\nand the orders that the truth would choose "
        f"(blue {alphas[0]:g} to yellow {alphas[-1]:g})"
    )


def _colours(scope: str, n: int) -> Sequence[Any]:
    import matplotlib

    if scope == "classes":
        return [colour for _, colour in CLASS_COLOURS.values()]
    return [tuple(colour) for colour in matplotlib.colormaps["cividis"](np.linspace(0.0, 1.0, n))[:, :3]]
