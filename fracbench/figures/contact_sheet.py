"""The contact sheet of a clip: its flows side by side, in the colours of one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.figures.flowcolor import color_wheel
from fracbench.figures.pictures import frame_panel
from fracbench.figures.style import RC

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 5
MOST_FLOWS = 28  # with the first frame and the wheel they fill six rows
_TILE = 320  # pixels: the longer side of a picture on the sheet is at most about that
_LETTERS = 18  # of a name: so many fit above a tile


def chosen(names: Sequence[str]) -> list[str]:
    """Return the names that a sheet has room for, evenly spaced, the first and the last among them."""
    return [names[i] for i in np.unique(np.linspace(0, len(names) - 1, MOST_FLOWS).round().astype(int))]


def contact_sheet(
    frame: NDArray[Any], flows: Sequence[tuple[str, NDArray[np.uint8]]], scale: float, title: str
) -> Figure:
    """Show a frame, the named colour pictures of flows, (H, W, 3), and the wheel whose rim is `scale` pixels."""
    items = [("first frame", _small(frame))]
    items += [(_short(name), _small(picture)) for name, picture in flows]
    height, width = items[-1][1].shape[:2]
    side = min(height, width) // 2 * 2
    legend = np.full((height, width, 3), 255, np.uint8)
    top, left = (height - side) // 2, (width - side) // 2
    legend[top : top + side, left : left + side] = color_wheel(side)
    items.append((f"rim: {scale:.3g} px", legend))
    return frame_panel(items, columns=COLUMNS, title=title)


def _small(picture: NDArray[Any]) -> NDArray[Any]:
    step = -(-max(picture.shape[:2]) // _TILE)
    eight_bit = picture if picture.dtype == np.uint8 else (picture // 257).astype(np.uint8)
    return eight_bit[::step, ::step]


def _short(name: str) -> str:
    """Return the end of a name, where the number is, for matplotlib; letters that its font lacks become ``?``."""
    from matplotlib.font_manager import findfont, get_font

    shown = name if len(name) <= _LETTERS else f"...{name[3 - _LETTERS :]}"
    known = get_font(findfont(RC["font.family"][0])).get_charmap()
    return "".join(letter if ord(letter) in known else "?" for letter in shown).replace("$", r"\$")
