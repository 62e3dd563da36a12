"""Pictures of a velocity field: arrows over its magnitude, and its vorticity. No file is read or written here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.field import Field
from fracbench.figures.style import MISSING, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

_BAR, _MARGIN, _TITLE = 1.6, 0.6, 0.3  # inches beside the map, below it, and for the title
_TALLEST = 10.0
_ARROW = 1.4  # steps of the grid: the length of the longest arrow
_TYPICAL = 0.999  # of the pixels have a vorticity within the colours: wild ones shall not make the rest pale


def top_speed(field: Field) -> float:
    """Return the largest speed of a field; 1 where nothing moves."""
    return float(np.nanmax(np.hypot(field.u, field.v), initial=0.0)) or 1.0


def top_vorticity(field: Field) -> float:
    """Return the absolute vorticity that 99.9 % of the pixels do not exceed; 1 where nothing turns."""
    known = np.abs(field.vorticity[np.isfinite(field.vorticity)])
    return (float(np.quantile(known, _TYPICAL)) if known.size else 0.0) or 1.0


def arrow_figure(field: Field, grid: int, top: float | None = None) -> Figure:
    """Draw an arrow at every `grid`-th pixel over the magnitude, whose colours reach up to `top`."""
    return arrow_panels({"": field}, grid, top)


def arrow_panels(fields: Mapping[str, Field], grid: int, top: float | None = None, title: str = "") -> Figure:
    """Draw `arrow_figure` of fields of one size and unit beside each other, by their headings, on one scale."""
    top = top or max(map(top_speed, fields.values()))
    first = next(iter(fields.values()))
    with house_style():
        fig, axes = _panels(first, list(fields), title)
        for ax, field in zip(axes, fields.values(), strict=True):
            image = _show(ax, field, np.hypot(field.u, field.v), "viridis", (0.0, top))
            _draw_arrows(ax, field, grid, top)
        beyond = max(map(top_speed, fields.values())) > top
        label = f"{'speed' if first.timed else 'displacement'} [{first.speed}]"
        fig.colorbar(image, ax=axes, label=label, extend="max" if beyond else "neither")
    return fig


def vorticity_figure(field: Field, top: float | None = None) -> Figure:
    """Draw the vorticity in colours that are symmetric about 0 and reach up to `top`."""
    top = top or top_vorticity(field)
    low, high = np.nanmin(field.vorticity, initial=0.0), np.nanmax(field.vorticity, initial=0.0)
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    with house_style():
        fig, (ax,) = _panels(field, [""])
        image = _show(ax, field, field.vorticity, "RdBu_r", (-top, top))
        label = f"vorticity [{field.rate}], red: counter-clockwise"
        fig.colorbar(image, ax=ax, label=label, extend=ends[bool(low < -top), bool(high > top)])
    return fig


def _panels(field: Field, headings: Sequence[str], title: str = "") -> tuple[Figure, list[Axes]]:
    """Return a figure with an empty panel of the shape of the field for each heading."""
    height, width = field.u.shape
    tall = (WIDTH - _BAR) / len(headings) * height / width + _MARGIN + (_TITLE if title else 0.0)
    fig = new_figure(min(tall, _TALLEST))
    if title:
        fig.suptitle(title)
    axes = list(fig.subplots(1, len(headings), squeeze=False, sharey=True)[0])
    axes[0].set_ylabel(f"y [{field.length}]")
    for ax, heading in zip(axes, headings, strict=True):
        ax.set_title(heading)
        ax.set_xlabel(f"x [{field.length}]")
    return fig, axes


def _show(ax: Axes, field: Field, values: NDArray[Any], colours: str, limits: tuple[float, float]) -> AxesImage:
    """Show values in colours on the axes of the field, y up; pixels without one are gray."""
    from matplotlib import colormaps

    ax.grid(visible=False)
    (height, width), pixel = values.shape, abs(field.x[1] - field.x[0])
    return ax.imshow(
        values,
        cmap=colormaps[colours].with_extremes(bad=MISSING),
        vmin=limits[0],
        vmax=limits[1],
        extent=(0.0, width * pixel, 0.0, height * pixel),
    )


def _draw_arrows(ax: Axes, field: Field, grid: int, top: float) -> None:
    rows, columns = field.nodes(grid)
    at = np.ix_(rows, columns)
    step = grid * abs(field.x[1] - field.x[0])
    ax.quiver(
        field.x[columns],
        field.y[rows],
        field.u[at],
        field.v[at],
        angles="xy",
        scale_units="xy",
        scale=top / (_ARROW * step),
        width=0.1 * step,
        units="xy",
        color="white",
        edgecolor="black",
        linewidth=0.3,
    )
