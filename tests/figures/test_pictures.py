from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from fracbench.errors import InputError
from fracbench.figures.flowcolor import flow_to_color
from fracbench.figures.pictures import error_maps, flow_panel, frame_panel
from fracbench.figures.style import PALETTE, house_style, render


def texts(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.texts]


def flow_of(speed: float) -> np.ndarray:
    flow = np.zeros((2, 6, 8))
    flow[0] = speed
    return flow


def test_flow_panel_puts_all_items_on_one_scale() -> None:
    fig = flow_panel([("slow", flow_of(1.0)), ("fast", flow_of(4.0))])
    slow, fast, wheel = fig.axes
    np.testing.assert_array_equal(slow.images[0].get_array(), flow_to_color(flow_of(1.0), 4.0))
    assert (np.asarray(fast.images[0].get_array()) == (255, 0, 0)).all()
    assert [slow.get_title(), fast.get_title()] == ["slow", "fast"]
    assert texts(wheel) == ["rim: 4 px"] and len(wheel.images) == 1


def test_flow_panel_takes_a_scale_and_tells_of_unknown_pixels() -> None:
    flow = flow_of(1.0)
    flow[:, 0, 0] = np.nan
    fig = flow_panel([("a", flow)], max_motion=2.0)
    assert texts(fig.axes[-1]) == ["rim: 2 px\nblack: unknown"]
    np.testing.assert_array_equal(fig.axes[0].images[0].get_array(), flow_to_color(flow, 2.0))


def test_flow_panel_without_motion_has_a_scale_all_the_same() -> None:
    assert texts(flow_panel([("still", flow_of(0.0))]).axes[-1]) == ["rim: 1 px"]


def test_pictures_break_into_rows() -> None:
    fig = flow_panel([(str(i), flow_of(1.0)) for i in range(5)], columns=2)
    with house_style():
        fig.draw_without_rendering()
    tops = [round(ax.get_position().y1, 3) for ax in fig.axes[:-1]]
    assert len(set(tops)) == 3 and tops[0] == tops[1] > tops[2] == tops[3] > tops[4]


def test_error_maps_share_one_scale_with_a_bar_in_pixels() -> None:
    near, far = np.full((5, 6), 0.5), np.full((5, 6), 2.0)
    near[0, 0] = np.nan
    fig = error_maps([("near", near), ("far", far)], vmax=1.5)
    first, second = fig.axes[:2]
    assert first.images[0].get_clim() == second.images[0].get_clim() == (0.0, 1.5)
    (side,) = (ax for ax in fig.axes if ax.child_axes)
    (bar,) = side.child_axes
    assert bar.get_ylabel() == "endpoint error [px]"
    assert bar._colorbar.extend == "max"  # type: ignore[attr-defined]
    assert np.ma.getmaskarray(first.images[0].get_array())[0, 0]


def test_error_maps_choose_a_scale_that_a_few_outliers_do_not_set() -> None:
    error = np.full((50, 50), 0.5)
    error[0, 0] = 1000.0
    assert error_maps([("a", error)]).axes[0].images[0].get_clim() == (0.0, 0.5)
    assert error_maps([("exact", np.zeros((3, 3)))]).axes[0].images[0].get_clim() == (0.0, 1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: flow_panel([]), "needs pictures"),
        (lambda: frame_panel([]), "needs frames"),
        (lambda: frame_panel([("a", np.zeros((3, 3)))], columns=0), "in 0 columns"),
        (
            lambda: frame_panel([("a", np.zeros((3, 3)))], boxes=[{"C": (0, 1, 0, 1)}]),
            "unknown letter of a box 'C'",
        ),
        (lambda: error_maps([]), "needs pictures"),
        (lambda: flow_panel([("a", flow_of(1.0))], columns=0), "in 0 columns"),
        (lambda: flow_panel([("a", np.zeros((3, 3)))]), r"must have shape \(2, H, W\)"),
        (lambda: error_maps([("map b", np.zeros((2, 3, 3)))]), r"'map b' must have shape \(H, W\)"),
        (lambda: error_maps([("a", np.zeros((3, 3)))], vmax=-1.0), "`vmax` must be a positive number"),
        (lambda: flow_panel([("a", flow_of(1.0))], max_motion=0.0), "`max_motion` must be a positive"),
    ],
)
def test_unusable_pictures_are_named(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


# --- frames ---


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
