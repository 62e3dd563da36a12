from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from fracbench.errors import InputError
from fracbench.figures.pictures import frame_panel
from fracbench.figures.style import PALETTE, render


def texts(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.texts]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: frame_panel([]), "needs frames"),
        (lambda: frame_panel([("a", np.zeros((3, 3)))], columns=0), "in 0 columns"),
        (
            lambda: frame_panel([("a", np.zeros((3, 3)))], boxes=[{"C": (0, 1, 0, 1)}]),
            "unknown letter of a box 'C'",
        ),
    ],
)
def test_unusable_pictures_are_named(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


def test_frames_are_shown_in_reading_order_gray_or_coloured() -> None:
    gray, colour = np.full((6, 8), 100.0), np.zeros((6, 8, 3), dtype=np.uint8)
    fig = frame_panel([("gray", gray), ("colour", colour), ("third", gray)], columns=2, title="frames")
    shown = [ax for ax in fig.axes if ax.images]
    assert [ax.get_title() for ax in shown] == ["gray", "colour", "third"]
    assert shown[0].images[0].get_clim() == (0, 255)
    np.testing.assert_array_equal(shown[1].images[0].get_array(), colour)
    assert fig.get_suptitle() == "frames"
    tops = [ax.get_subplotspec().rowspan.start for ax in shown]  # type: ignore[union-attr]
    assert tops == [0, 0, 1]
    assert not any(ax.axison for ax in fig.axes)


def test_boxes_enclose_their_pixels_in_the_papers_colours() -> None:
    frame = np.zeros((20, 30))
    fig = frame_panel([("a", frame), ("b", frame)], boxes=[{"A": (2, 5, 10, 20), "B": (10, 12, 0, 4)}, {}])
    first, second = fig.axes
    colours = {to_hex(patch.get_edgecolor()): patch for patch in first.patches}
    assert set(colours) == {"#ffffff", PALETTE[1].lower(), PALETTE[0].lower()}
    red = colours[PALETTE[1].lower()]
    assert (red.get_x(), red.get_y(), red.get_width(), red.get_height()) == (9.5, 1.5, 10, 3)
    assert texts(first) == ["A", "B"] and not second.patches


def test_a_panel_of_frames_repeats_to_the_byte() -> None:
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    once, again = (frame_panel([("a", frame)], boxes=[{"A": (1, 9, 2, 8)}]) for _ in range(2))
    assert all(render(once, fmt) == render(again, fmt) for fmt in ("png", "pdf"))
