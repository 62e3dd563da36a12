"""The one look of all figures, and the one way to write them: png and pdf whose bytes repeat."""

from __future__ import annotations

import io
import math
import numbers
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import atomic_path
from fracbench.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colours, told apart by the colour-blind; without their yellow, too pale on white."""

WIDTH = 8.0
"""Width of every figure in inches."""

DPI = 160
"""Resolution of png files: `WIDTH` at this resolution is 1280 pixels."""

METRICS: Mapping[str, str] = {"aae": "AAE [rad]", "aepe": "AEPE [px]"}
"""The errors every figure shows, one panel each, and the labels of their axes."""

KEYS: Mapping[str, tuple[str, str]] = {
    "alpha": (r"$\alpha$", r"fractional order $\alpha$"),
    "lambda": (r"$\lambda$", r"data attachment weight $\lambda$"),
    "theta": (r"$\theta$", r"tightness $\theta$"),
    "lambda_sb": (r"$\lambda_{SB}$", r"split Bregman weight $\lambda_{SB}$"),
    "eta": (r"$\eta$", r"zoom factor $\eta$"),
    "epsilon": (r"$\epsilon$", r"stopping threshold $\epsilon$ [px]"),
    "n_scales": ("scales", "number of scales"),
    "n_warps": ("warps", "number of warps"),
    "max_iter": ("iterations", "iterations a warp"),
}
"""Symbol and axis label of the keys; any other key stands under its own name."""

METHODS: Mapping[str, tuple[str, Any]] = {
    "tvl1": ("TV-L1", "--"),
    "tvl1_sb": ("TV-L1-SB", "-"),
    "tvl1_sb_alpha": (r"TV-L1-SB-$\alpha$", "-."),
}
"""Name and line style of the paper's methods; the first two styles are those of its captions."""

_OTHER_LINES: tuple[Any, ...] = (":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 4)))

BEHIND = "#BDBDBD"
"""Colour of lines that are there for comparison only."""

SHADE = "#EDEDED"
"""Colour of a range that is pointed out."""

MISSING = "#9E9E9E"
"""Colour of cells and pixels without a value."""

_LINES = ("--", "-.", ":", "-")

STAR: Mapping[str, Any] = {
    "marker": "*",
    "markersize": 14,
    "markeredgecolor": "black",
    "linestyle": "none",
    "zorder": 4,
}
"""How a minimum is marked."""

RC: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # ships with matplotlib: the same letters on every machine
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.titlesize": 11,
    "figure.dpi": DPI,
    "savefig.dpi": DPI,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.markersize": 5,
    "image.cmap": "cividis",
    "image.interpolation": "nearest",
    "pdf.fonttype": 42,  # text stays text: it can be searched, and edited in a drawing program
    "svg.fonttype": "none",
    "svg.hashsalt": "fracbench",
}
"""matplotlib settings, applied over matplotlib's own defaults; a user's matplotlibrc has no say."""

_SIDE = 1.15  # inches for the legend beside pictures
_TITLE = 0.32  # inches for a title above one

# None leaves an entry out. Dates and versions would make equal figures differ from run to run.
_METADATA: dict[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": "fracbench", "Producer": "fracbench"},
}


@contextmanager
def house_style() -> Iterator[None]:
    """Apply `RC` while a figure is built or drawn, and restore the caller's settings after."""
    import matplotlib.style

    with matplotlib.style.context(["default", RC]):
        yield


def symbol(key: str) -> str:
    """Return the name of a key in texts: the paper's letter where there is one."""
    return KEYS[key][0] if key in KEYS else key


def equation(key: str, value: object) -> str:
    """Return ``key = value`` as text for titles and legends."""
    return f"{symbol(key)} = {float(value):.4g}" if isinstance(value, numbers.Real) else str(value)


def axis_label(key: str) -> str:
    """Return the label of an axis that shows a key."""
    return KEYS[key][1] if key in KEYS else key


def caption_style(style: str) -> tuple[str, str]:
    """Take a line's style in a caption apart; its colour is not the caption's to choose.

    Parameters
    ----------
    style : str
        Line, marker or both, e.g. ``"--*"``.

    Returns
    -------
    line, marker : str
        As matplotlib has them: ``""`` for no line of its own, ``"None"`` for no marker.

    Raises
    ------
    InputError
        There is no such marker, or nothing at all.
    """
    from matplotlib.lines import Line2D

    line = next((line for line in _LINES if style.startswith(line)), "")
    marker = style.removeprefix(line) or "None"
    if not style.strip():
        raise InputError(f"styles: {style!r} names neither a line nor a marker, as --* does")
    known = [name for name in Line2D.markers if isinstance(name, str) and name.strip()]
    if marker not in known:
        shown = " ".join(name for name in known if len(name) == 1)
        raise InputError(
            f"styles: unknown marker {marker!r} in {style!r} (allowed: {' '.join(_LINES)} and then one of {shown})"
        )
    return line, marker


def method_lines(methods: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Return legend name and line style of each method; others take spare styles in turn."""
    others = [method for method in methods if method not in METHODS]
    spare = {method: (method, _OTHER_LINES[i % len(_OTHER_LINES)]) for i, method in enumerate(others)}
    return {method: METHODS.get(method) or spare[method] for method in methods}


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Return an empty figure on an Agg canvas that pyplot does not know of.

    Parameters
    ----------
    height, width : float
        Size in inches.

    Returns
    -------
    matplotlib.figure.Figure
        With constrained layout, which makes room for legends outside the axes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(fig)
    return fig


def two_panels(title: str = "") -> tuple[Figure, list[Axes]]:
    """Return a figure with two panels side by side, one for each of `METRICS`."""
    fig = new_figure(3.5)
    if title:
        fig.suptitle(title.replace("λ_SB", symbol("lambda_sb")))
    return fig, list(fig.subplots(1, 2))


def plain_ticks(axis: Any, multiples: Sequence[float] = (1.0, 2.0, 3.0, 5.0)) -> None:
    """Write the ticks of a logarithmic axis, these multiples of powers of ten, as plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=multiples))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def write_below(ax: Axes, x: float, y: float, text: str) -> None:
    """Write under a point, inside the panel: under a minimum there is no curve."""
    scale = ax.yaxis.get_transform()
    low, high = scale.transform(ax.get_ylim())
    ax.set_ylim(bottom=float(scale.inverted().transform(low - 0.14 * (high - low))))
    across = ax.transAxes.inverted().transform(ax.transData.transform((x, y)))[0]
    side = "left" if across < 0.2 else "right" if across > 0.8 else "center"
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8}
    ax.annotate(
        text, (x, y), xytext=(0, -9), textcoords="offset points", ha=side, va="top", bbox=paper, fontsize=9
    )


def legend_below(fig: Figure) -> None:
    """Give each panel its legend under its axis, and the figure the height that takes."""
    from matplotlib.transforms import ScaledTranslation

    rows = 0
    for ax in fig.axes:
        handles, labels = ax.get_legend_handles_labels()
        rows = max(rows, len(handles))
        if handles:
            # An offset in inches: one in parts of the axes would move with the figure's height.
            below = ax.transAxes + ScaledTranslation(0, -0.48, fig.dpi_scale_trans)
            ax.legend(
                handles,
                labels,
                loc="upper left",
                bbox_to_anchor=(0, 0),
                bbox_transform=below,
                borderaxespad=0,
            )
    fig.set_figheight(fig.get_figheight() + 0.19 * rows)


def picture_grid(shapes: Sequence[tuple[int, ...]], columns: int) -> tuple[Figure, list[Axes], Axes]:
    """Return a figure with a bare panel for each picture, and a narrow one for their legend at the right.

    Parameters
    ----------
    shapes : sequence of tuple of int
        ``(H, W)`` of each picture.
    columns : int
        Pictures in a row, at most.

    Returns
    -------
    tuple of (matplotlib.figure.Figure, list of matplotlib.axes.Axes, matplotlib.axes.Axes)
        Figure, one panel a picture in reading order, and the legend's panel.

    Raises
    ------
    InputError
        If there is no picture, or `columns` is not positive.
    """
    if not shapes or columns < 1:
        raise InputError(f"a grid of pictures needs pictures and columns, got {len(shapes)} in {columns} columns")
    columns = min(columns, len(shapes))
    rows = math.ceil(len(shapes) / columns)
    tallest = max(height / width for height, width in shapes)
    cell = (WIDTH - _SIDE) / columns
    fig = new_figure(max(rows * (cell * tallest + _TITLE), _SIDE + 2 * _TITLE))
    grid = fig.add_gridspec(rows, columns + 1, width_ratios=[cell] * columns + [_SIDE])
    axes = [fig.add_subplot(grid[divmod(i, columns)]) for i in range(len(shapes))]
    side = fig.add_subplot(grid[:, -1])
    for ax in (*axes, side):
        ax.set_axis_off()
    return fig, axes, side


def render(fig: Figure, fmt: str) -> bytes:
    """Return the figure as the bytes of a file; equal figures give equal bytes, at the second call too.

    The layout is settled at the first call and then kept: constrained layout starts from where it last
    left the panels, so that each drawing would differ from the one before by fractions of a pixel.

    Parameters
    ----------
    fig : matplotlib.figure.Figure
        The figure.
    fmt : str
        ``"png"`` or ``"pdf"``.

    Returns
    -------
    bytes
        The file's content, with neither date nor version in it.
    """
    buffer = io.BytesIO()
    with house_style():
        if fig.get_layout_engine() is not None:
            fig.draw_without_rendering()
            fig.set_layout_engine(None)  # "none" would leave another, for which each file is drawn twice
        fig.savefig(buffer, format=fmt, metadata=_METADATA[fmt])
    photographs = any(ax.images for ax in fig.axes)
    return _slim(buffer.getvalue()) if fmt == "png" and not photographs else buffer.getvalue()


def _slim(png: bytes) -> bytes:
    """Return a drawing with a palette of 256 colours: a third of the bytes, and nothing that can be seen."""
    from PIL import Image

    buffer = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        few = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    few.save(buffer, "PNG", optimize=True, dpi=(DPI, DPI))
    return buffer.getvalue()


def figure_files(stem: Path) -> list[Path]:
    """Return where `save_figure` writes: the png and the pdf; dots in the stem are kept."""
    return [stem.with_name(f"{stem.name}.{fmt}") for fmt in _METADATA]


def save_figure(fig: Figure, stem: Path) -> list[Path]:
    """Write a figure as png and pdf.

    Parameters
    ----------
    fig : matplotlib.figure.Figure
        The figure.
    stem : pathlib.Path
        Path without suffix; dots in it are kept (``alpha1.2`` gives ``alpha1.2.png``).

    Returns
    -------
    list of pathlib.Path
        The png and the pdf.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    # Both are drawn before either is written: a figure that cannot be drawn replaces nothing.
    contents = {path: render(fig, path.suffix.removeprefix(".")) for path in figure_files(stem)}
    for path, content in contents.items():
        with atomic_path(path) as tmp:
            tmp.write_bytes(content)
    return list(contents)
