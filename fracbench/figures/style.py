"""The one look of all figures, and the one way to write them: png and pdf whose bytes repeat."""

from __future__ import annotations

import io
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

#: Okabe and Ito's colours, told apart by the colour-blind; without their yellow, too pale on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
WIDTH = 8.0  # of every figure, inches
DPI = 160  # of png files, which are 1280 pixels wide
#: The errors that figures show, one panel each, and the labels of their axes.
METRICS: Mapping[str, str] = {"aae": "AAE [rad]", "aepe": "AEPE [px]"}
#: Symbol and axis label of the keys; any other key stands under its own name.
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
#: Name and line style of the paper's methods; the first two styles are those of its captions.
METHODS: Mapping[str, tuple[str, Any]] = {
    "tvl1": ("TV-L1", "--"),
    "tvl1_sb": ("TV-L1-SB", "-"),
    "tvl1_sb_alpha": (r"TV-L1-SB-$\alpha$", "-."),
}
_OTHER_LINES: tuple[Any, ...] = (":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 4)))
_LINES = ("--", "-.", ":", "-")

BEHIND = "#BDBDBD"  # lines for comparison only
SHADE = "#EDEDED"  # a range that is pointed out
MISSING = "#9E9E9E"  # cells and pixels without a value
#: The mark of a minimum.
STAR: Mapping[str, Any] = {
    "marker": "*",
    "markersize": 14,
    "markeredgecolor": "black",
    "linestyle": "none",
    "zorder": 4,
}

#: matplotlib's settings, applied over its own defaults; a user's matplotlibrc has no effect.
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
}
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
    """Split a style of a caption, e.g. ``"--*"``, into line (``""`` for none) and marker (``"None"`` for none)."""
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


def new_figure(height: float) -> Figure:
    """Return an empty figure of a height in inches, on an Agg canvas that pyplot does not know of.

    Its constrained layout makes room for legends outside the axes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(WIDTH, height), layout="constrained")
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


def label_outer(grid: Any, used: int, x: str, y: str) -> None:
    """Label a grid of panels at its left and its bottom, and hide those behind the first `used`."""
    for ax in grid.flat[used:]:
        ax.set_axis_off()
    for column in grid.T:
        last = [ax for ax in column if ax.axison][-1]
        last.set_xlabel(x)
        last.tick_params(labelbottom=True)
    for row in grid:
        row[0].set_ylabel(y)


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
            place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0, 0), "bbox_transform": below}
            ax.legend(handles, labels, borderaxespad=0, **place)
    fig.set_figheight(fig.get_figheight() + 0.19 * rows)


def render(fig: Figure, fmt: str) -> bytes:
    """Return the figure as a png or pdf file; equal figures give equal bytes, at the second call too.

    The layout is settled at the first call and then kept: constrained layout starts from where it last
    left the panels, so that each drawing would differ from the one before by fractions of a pixel.
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
    """Return the png and the pdf of a path without suffix; ``alpha1.2`` gives ``alpha1.2.png``."""
    return [stem.with_name(f"{stem.name}.{fmt}") for fmt in _METADATA]


def save_figure(fig: Figure, stem: Path) -> list[Path]:
    """Write a figure to `figure_files`, both files or neither where it cannot be drawn."""
    contents = {path: render(fig, path.suffix.removeprefix(".")) for path in figure_files(stem)}
    for path, content in contents.items():
        with atomic_path(path) as tmp:
            tmp.write_bytes(content)
    return list(contents)
