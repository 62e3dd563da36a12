"""A flow on axes of matplotlib, and as HTML for a notebook, in Middlebury's colours. No file is written here."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from fracbench.figures.flowcolor import color_wheel, fastest, flow_to_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WHEEL = 0.16  # side of the legend, of the axes' height
_WIDEST = 640  # pixels of a picture in a notebook; the browser shrinks it


def draw_flow(flow: NDArray[Any], ax: Axes | None = None, *, max_motion: float | None = None) -> Axes:
    """Show a flow, (2, H, W) in pixels, on axes, with the colour wheel as its legend; see `flow_to_color`."""
    import matplotlib.pyplot as plt

    if ax is None:
        ax = plt.subplots(layout="constrained")[1]
    reach = fastest(flow) if max_motion is None else max_motion
    ax.imshow(flow_to_color(flow, max_motion))
    ax.set_axis_off()
    height, width = flow.shape[1:]
    legend = ax.inset_axes((0.02, 0.02, _WHEEL * min(1.0, height / width), _WHEEL))
    legend.imshow(color_wheel(101))
    legend.set_axis_off()
    legend.set_aspect("equal", anchor="SW")
    ax.set_title(f"full colour: {reach:.3g} px")
    return ax


def flow_html(flow: NDArray[Any], caption: str) -> str:
    """Return a flow as a picture with a caption, one piece of HTML without further files."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(flow_to_color(flow)).save(buffer, "PNG")
    picture = base64.b64encode(buffer.getvalue()).decode("ascii")
    text = escape(caption)
    width = min(_WIDEST, flow.shape[2])
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{picture}" alt="{text}" width="{width}" '
        f'style="max-width:100%"><figcaption>{text}</figcaption></figure>'
    )
