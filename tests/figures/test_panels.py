"""The grid of panels: the curves of each, their marks, and their names in the legend."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from fracbench.errors import InputError
from fracbench.figures.panels import Curve, Panel, panel_grid
from fracbench.figures.style import PALETTE, house_style, render

ALPHA = np.round(np.arange(0.0, 2.01, 0.25), 10)
LOOK = {"color": PALETTE[0], "marker": "o"}


def valley(best: float, factor: float = 1.0) -> pd.DataFrame:
    error = factor * 10.0 ** ((ALPHA - best) ** 2)
    return pd.DataFrame({"alpha": ALPHA, "aae": 0.1 * error, "aepe": 0.3 * error})


def draw(compose, regions=("a", "b", "c"), note=""):
    return panel_grid(regions, compose, x="alpha", title="A title", note=note)


def marks(ax: Axes, gid: str):
    return [line for line in ax.lines if line.get_gid() == gid]


def lines_of(ax: Axes):
    return [line for line in ax.lines if line.get_gid() is None]


def test_there_is_a_column_a_region_and_a_row_an_error():
    asked = []

    def compose(region, metric):
        asked.append((region, metric))
        return Panel(f"{region} {metric}", [Curve(valley(1.0), "errors", LOOK)])

    fig = draw(compose)
    assert asked == [(region, metric) for metric in ("aae", "aepe") for region in ("a", "b", "c")]
    assert [ax.get_title() for ax in fig.axes] == [f"{region} {metric}" for region, metric in asked]
    assert [ax.get_ylabel() for ax in fig.axes] == ["AAE [rad]", "", "", "AEPE [px]", "", ""]
    assert [bool(ax.get_xlabel()) for ax in fig.axes] == [False] * 3 + [True] * 3
    for ax, (_, metric) in zip(fig.axes, asked, strict=True):
        (line,) = ax.lines
        np.testing.assert_array_equal(line.get_ydata(), valley(1.0)[metric])
        assert ax.get_yscale() == "log"


def test_the_minimum_is_starred_and_named_where_asked_for():
    curves = [Curve(valley(0.5, 2.0), "behind", LOOK), Curve(valley(1.25), "front", LOOK, starred=True)]
    for ax in draw(lambda region, metric: Panel(region, curves)).axes:
        (star,) = marks(ax, "minimum")
        assert star.get_xdata() == [1.25] and star.get_color() == PALETTE[0]
        assert [text.get_text() for text in ax.texts] == [r"$\alpha$ = 1.25"]
        assert ax.get_ylim()[0] > 0


def test_several_minima_are_named_in_a_row_in_the_colours_of_their_curves():
    colours = {0.5: PALETTE[0], 1.25: PALETTE[1], 1.75: PALETTE[2]}
    curves = [Curve(valley(best), str(best), {"color": c}, starred=True) for best, c in colours.items()]
    fig = draw(lambda region, metric: Panel(region, curves))
    with house_style():
        fig.draw_without_rendering()
    for ax in fig.axes:
        said = {text.get_text(): text for text in ax.texts}
        assert {text: entry.get_color() for text, entry in said.items()} == {
            r"$\alpha$ = 0.5": PALETTE[0], "1.25": PALETTE[1], "1.75": PALETTE[2],
        }  # fmt: skip
        boxes = [entry.get_window_extent() for entry in ax.texts][::-1]
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
        tops = [ax.transData.transform(line.get_xydata())[:, 1].max() for line in lines_of(ax)]
        assert max(tops) < min(box.y0 for box in boxes) and max(box.y1 for box in boxes) < ax.bbox.y1
        assert len(marks(ax, "minimum")) == 3


def test_the_papers_best_value_is_marked_on_the_upper_edge_off_the_data():
    fig = draw(lambda region, metric: Panel(region, [Curve(valley(1.0), "errors", LOOK)], published=1.4))
    with house_style():
        fig.draw_without_rendering()
    for ax in fig.axes:
        (mark,) = marks(ax, "published")
        assert mark.get_xdata() == [1.4]
        (text,) = ax.texts
        assert text.get_text() == "paper: 1.4"
        top = ax.get_window_extent().y1
        heading = ax.title.get_window_extent()
        assert top < text.get_window_extent().y0 and text.get_window_extent().y1 < heading.y0


def test_a_panel_without_the_papers_value_has_no_mark():
    fig = draw(lambda region, metric: Panel(region, [Curve(valley(1.0), "errors", LOOK)]))
    assert not any(marks(ax, "published") for ax in fig.axes)
    assert [text.get_text() for text in fig.legends[0].get_texts()] == [
        "errors",
        r"smallest error, and its $\alpha$",
    ]


def test_failed_points_are_gaps_and_a_curve_without_errors_has_no_star():
    failed = valley(1.0)
    failed.loc[failed.alpha == 1.0, ["aae", "aepe"]] = np.nan
    none = valley(1.0).assign(aae=np.nan, aepe=np.inf)
    curves = [Curve(failed, "some", LOOK, starred=True), Curve(none, "none", LOOK, starred=True)]
    for ax in draw(lambda region, metric: Panel(region, curves)).axes:
        (star,) = marks(ax, "minimum")
        assert star.get_xdata()[0] in (0.75, 1.25)
        assert np.isnan(np.asarray(ax.lines[0].get_ydata(), dtype=float)).sum() == 1


def test_one_legend_names_everything_once():
    band = valley(1.0).assign(aae_low=0.05, aae_high=9.0, aepe_low=0.1, aepe_high=20.0)
    curves = [
        *(Curve(valley(0.5, factor), "others", {"color": "gray"}) for factor in (2.0, 3.0)),
        Curve(valley(1.0), "best", LOOK, starred=True, ringed=True),
    ]
    fig = draw(lambda region, metric: Panel(region, curves, band, "the spread", 1.2), note="a note")
    (legend,) = fig.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert sorted(labels) == sorted(
        [
            "the spread",
            "others",
            "best",
            r"smallest error, and its $\alpha$",
            r"best $\alpha$ in the paper",
            "a note",
        ]
    )
    for ax, metric in zip(fig.axes, ["aae"] * 3 + ["aepe"] * 3, strict=True):
        (patch,) = ax.collections
        heights = patch.get_paths()[0].vertices[:, 1]
        assert (heights.min(), heights.max()) == (band[f"{metric}_low"].min(), band[f"{metric}_high"].max())
        assert [ring.get_xdata().tolist() for ring in marks(ax, "zero")] == [[0.0]]
    with house_style():
        fig.draw_without_rendering()
    box = legend.get_window_extent()
    assert box.y1 < min(ax.xaxis.label.get_window_extent().y0 for ax in fig.axes[3:])
    assert fig.bbox.x0 <= box.x0 and box.x1 <= fig.bbox.x1 and fig.bbox.y0 <= box.y0


def test_two_points_of_a_curve_at_one_place_are_refused():
    twice = pd.concat([valley(1.0), valley(1.0)])
    with pytest.raises(InputError, match="several rows share alpha = 0"):
        draw(lambda region, metric: Panel(region, [Curve(twice, "errors", LOOK)]))


def test_equal_panels_give_equal_bytes():
    def compose(region, metric):
        return Panel(region, [Curve(valley(1.0), "errors", LOOK, starred=True)], published=1.2)

    once, again = (draw(compose, regions=("a",)) for _ in range(2))
    assert all(render(once, fmt) == render(again, fmt) for fmt in ("png", "pdf"))
