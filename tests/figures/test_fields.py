from __future__ import annotations

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from fracbench.data.field import Field
from fracbench.figures.fields import arrow_figure, arrow_panels, top_speed, top_vorticity, vorticity_figure
from fracbench.figures.style import render

H, W = 24, 36


def field(u=0.0, v=0.0, vorticity=0.0, **changes) -> Field:
    """A field of pixels of 0.5 mm, in mm/s, with a masked corner at the top left."""
    mask = np.zeros((H, W), bool)
    mask[:4, :4] = True
    maps = {name: np.where(mask, np.nan, np.broadcast_to(value, (H, W)))
            for name, value in (("u", u), ("v", v), ("vorticity", vorticity))}  # fmt: skip
    whole = {"x": 0.5 * (np.arange(W) + 0.5), "y": 0.5 * (H - 0.5 - np.arange(H)), "divergence": 0 * maps["u"]}
    return Field(
        **{**whole, **maps, "doubtful": mask & False, "mask": mask, "scaled": True, "timed": True, **changes}
    )


def quiver(fig) -> Quiver:
    return next(child for child in fig.axes[0].get_children() if isinstance(child, Quiver))


def pixels(fig) -> np.ndarray:
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(render(fig, "png"))).convert("RGB")).astype(int)


def test_arrows_point_where_the_field_goes_and_start_at_the_nodes():
    """To the right and half as much up, on axes whose y points up."""
    shown = field(u=2.0, v=1.0)
    fig = arrow_figure(shown, 8)
    arrows = quiver(fig)
    assert sorted(set(arrows.X)) == [2.25, 6.25, 10.25, 14.25]
    assert sorted(set(arrows.Y)) == [1.75, 5.75, 9.75]
    assert set(np.round(arrows.U, 6)) == {2.0} and set(np.round(arrows.V, 6)) == {1.0}
    assert arrows.angles == "xy"
    low, high = fig.axes[0].get_ylim()
    assert (low, high) == (0.0, 12.0) and fig.axes[0].get_xlim() == (0.0, 18.0)
    # the longest arrow is 1.4 steps of 4 mm
    assert np.hypot(2, 1) / arrows.scale == pytest.approx(1.4 * 4)


def test_the_magnitude_is_behind_and_its_bar_has_the_unit():
    u = np.linspace(0, 3, W)
    fig = arrow_figure(field(u=u), 8)
    (image,) = fig.axes[0].images
    np.testing.assert_allclose(image.get_array()[10], u)
    assert np.isnan(np.ma.filled(image.get_array(), np.nan)[:4, :4]).all()
    assert image.get_clim() == (0.0, pytest.approx(3.0))
    assert [ax.get_ylabel() for ax in fig.axes] == ["y [mm]", "speed [mm/s]"]
    assert fig.axes[0].get_xlabel() == "x [mm]"
    plain = arrow_figure(field(u=u, scaled=False, timed=False), 8)
    assert [ax.get_ylabel() for ax in plain.axes] == ["y [px]", "displacement [px]"]


def test_vorticity_has_colours_that_are_symmetric_about_0():
    """Of a field that turns counter-clockwise at the top alone, the top is red and the bottom white."""
    vorticity = np.where(np.arange(H)[:, None] < 12, 4.0, 0.0)
    fig = vorticity_figure(field(vorticity=vorticity))
    (image,) = fig.axes[0].images
    assert image.get_clim() == (-4.0, 4.0)
    assert fig.axes[1].get_ylabel() == "vorticity [1/s], red: counter-clockwise"
    picture = pixels(fig)
    height, width = picture.shape[:2]
    red, _, blue = picture[height // 4, width // 2]
    assert red > blue + 40
    assert (picture[3 * height // 4, width // 2] > 240).all()
    turned = pixels(vorticity_figure(field(vorticity=-vorticity)))
    red, _, blue = turned[height // 4, width // 2]
    assert blue > red + 40


def test_wild_pixels_do_not_set_the_colours_and_the_bar_says_so():
    vorticity = np.ones((H, W))
    shown = field(vorticity=vorticity)
    assert top_vorticity(shown) == 1.0
    vorticity = np.ones((60, 60))
    vorticity[30, 30] = -500.0
    wild = field(x=np.arange(60.0), y=np.arange(60.0)[::-1], u=0, v=0)
    wild = Field(**{**vars(wild), "vorticity": vorticity, "mask": np.zeros((60, 60), bool)})
    assert top_vorticity(wild) == 1.0
    fig = vorticity_figure(wild)
    assert fig.axes[0].images[0].colorbar.extend == "min"


def test_a_field_at_rest_is_drawn():
    rest = field()
    assert (top_speed(rest), top_vorticity(rest)) == (1.0, 1.0)
    assert render(arrow_figure(rest, 8), "png") and render(vorticity_figure(rest), "pdf")


def test_one_scale_serves_several_fields():
    fig = arrow_figure(field(u=1.0), 8, top=5.0)
    assert fig.axes[0].images[0].get_clim() == (0.0, 5.0)
    assert 1 / quiver(fig).scale == pytest.approx(1.4 * 4 / 5)
    assert vorticity_figure(field(vorticity=1.0), top=3.0).axes[0].images[0].get_clim() == (-3.0, 3.0)


def test_fields_beside_each_other_share_one_scale():
    fig = arrow_panels({"ours": field(u=2.0), "theirs": field(u=-4.0)}, 8, title="agreement")
    panels = fig.axes[:2]
    assert [ax.get_title() for ax in panels] == ["ours", "theirs"] and fig.get_suptitle() == "agreement"
    assert [ax.images[0].get_clim() for ax in panels] == [(0.0, 4.0), (0.0, 4.0)]
    arrows = [next(child for child in ax.get_children() if isinstance(child, Quiver)) for ax in panels]
    assert [set(each.U) for each in arrows] == [{2.0}, {-4.0}]
    assert arrows[0].scale == arrows[1].scale
