"""Pictures of a velocity field: arrows over its magnitude, and its vorticity. No file is read or written here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.field import Field
from fracbench.figures.style import MISSING, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAR, _MARGIN = 1.6, 0.6  # inches beside and below the map
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
    top = top or top_speed(field)
    kind = "speed" if field.timed else "displacement"
    with house_style():
        fig, ax = _map(field, np.hypot(field.u, field.v), "viridis", (0.0, top), f"{kind} [{field.speed}]")
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
    return fig


def vorticity_figure(field: Field, top: float | None = None) -> Figure:
    """Draw the vorticity in colours that are symmetric about 0 and reach up to `top`."""
    top = top or top_vorticity(field)
    with house_style():
        label = f"vorticity [{field.rate}], red: counter-clockwise"
        return _map(field, field.vorticity, "RdBu_r", (-top, top), label)[0]


def _map(
    field: Field, values: NDArray[Any], colours: str, limits: tuple[float, float], label: str
) -> tuple[Figure, Axes]:
    """Show values in colours on the axes of the field, y up, with a colour bar; pixels without one are gray."""
    from matplotlib import colormaps

    height, width = values.shape
    pixel = abs(field.x[1] - field.x[0])
    fig = new_figure(min((WIDTH - _BAR) * height / width + _MARGIN, _TALLEST))
    ax = fig.subplots()
    ax.grid(visible=False)
    image = ax.imshow(
        values,
        cmap=colormaps[colours].with_extremes(bad=MISSING),
        vmin=limits[0],
        vmax=limits[1],
        extent=(0.0, width * pixel, 0.0, height * pixel),
    )
    ax.set_xlabel(f"x [{field.length}]")
    ax.set_ylabel(f"y [{field.length}]")
    beyond = (np.nanmin(values, initial=0.0) < limits[0], np.nanmax(values, initial=0.0) > limits[1])
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    fig.colorbar(image, ax=ax, label=label, extend=ends[beyond])
    return fig, ax
