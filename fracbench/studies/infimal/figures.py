"""Pictures of both parts of a flow: arrays in, figures out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.figures.flowcolor import fastest, flow_to_color
from fracbench.figures.style import WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLES = ("p: edges of motion", "q: smooth motion", "u = p + q", "share of q in the change")
#: Where the flow changes by less than this, pixels per pixel, neither part is said to carry its change.
_STILL = 1e-3


def share_of_change(parts: NDArray[Any]) -> NDArray[np.float64]:
    """Return ``|grad q| / (|grad p| + |grad q|)`` of both parts, (2, 2, H, W): shape (H, W), NaN where still."""
    steep_p, steep_q = (
        np.sqrt(sum(np.square(slope) for component in part for slope in np.gradient(component.astype(np.float64))))
        for part in parts
    )
    total = steep_p + steep_q
    share = np.full(total.shape, np.nan)
    np.divide(steep_q, total, out=share, where=total > _STILL)
    return share


def parts_panel(items: Sequence[tuple[str, NDArray[Any]]], title: str) -> Figure:
    """Show p, q and u of named parts, (2, 2, H, W), in flow colours of one scale, and the share of q's change."""
    tallest = [parts.shape[2] / parts.shape[3] for _, parts in items]
    with house_style():
        fig = new_figure(sum(0.22 * WIDTH * height + 0.1 for height in tallest) + 0.8)
        fig.suptitle(title)
        grid = fig.subplots(len(items), 4, squeeze=False, height_ratios=tallest)
        for row, (name, parts) in zip(grid, items, strict=True):
            whole = parts.sum(axis=0)
            scale = max(fastest(flow) for flow in (*parts, whole))
            for ax, flow in zip(row, (*parts, whole), strict=False):
                ax.imshow(flow_to_color(flow, scale))
            shown = row[3].imshow(share_of_change(parts), cmap="cividis", vmin=0.0, vmax=1.0)
            row[3].set_facecolor("#808080")
            for ax in row:
                ax.grid(visible=False)
                ax.set(xticks=[], yticks=[])
            row[0].set_ylabel(name)
        for ax, words in zip(grid[0], _TITLES, strict=True):
            ax.set_title(words, fontsize=8)
        fig.colorbar(shown, ax=grid[:, 3], shrink=0.6, location="right")
    return fig
