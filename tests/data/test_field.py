"""The files of a velocity field: OpenPIV's table, and NetCDF by the CF conventions."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench.commands.field_output import Units, to_field
from fracbench.data import field as fields
from fracbench.data.field import Field, write_netcdf, write_table
from fracbench.errors import InputError

H, W = 20, 30
ROWS, COLUMNS = np.mgrid[0:H, 0:W].astype(float)
#: Pixels, y down: shears and strains that differ in x and y, so that no exchange of axes or signs goes unseen.
FLOW = np.stack([1.0 + 0.05 * COLUMNS + 0.02 * ROWS, -2.0 + 0.03 * COLUMNS - 0.01 * ROWS]).astype(np.float32)


def field(**units) -> Field:
    mask = np.zeros((H, W), bool)
    mask[:6, :5] = True
    doubtful = np.zeros((H, W), bool)
    doubtful[10, 12] = True
    return to_field(FLOW, Units(**units), mask, doubtful)


def test_the_axes_are_physical():
    found = field()
    assert (found.x[0], found.x[-1], found.y[0], found.y[-1]) == (0.5, W - 0.5, H - 0.5, 0.5)
    row, column = 8, 20
    assert found.u[row, column] == pytest.approx(1.0 + 0.05 * column + 0.02 * row)
    assert found.v[row, column] == pytest.approx(2.0 - 0.03 * column + 0.01 * row)
    # dv/dx - du/dy with y up: dv/dx = -0.03, du/dy = -0.02
    assert found.vorticity[row, column] == pytest.approx(-0.03 + 0.02, abs=1e-6)
    assert found.divergence[row, column] == pytest.approx(0.05 - 0.01, abs=1e-6)
    assert np.isnan(found.u[found.mask]).all() and np.isfinite(found.u[~found.mask]).all()


def test_a_counter_clockwise_rotation_has_a_positive_vorticity():
    """On the picture, a point right of the centre goes up."""
    flow = 0.1 * np.stack([ROWS - 10, -(COLUMNS - 15)])
    assert flow[1, 10, 25] < 0
    np.testing.assert_allclose(to_field(flow, Units()).vorticity, 0.2)


@pytest.mark.parametrize(
    ("units", "speed", "rate", "length", "factor", "slope"),
    [
        ({}, "px", "1/frame", "px", 1.0, 1.0),
        ({"scale": 0.02}, "mm", "1/frame", "mm", 0.02, 1.0),
        ({"dt": 0.5}, "px/s", "1/s", "px", 2.0, 2.0),
        ({"scale": 0.02, "dt": 0.5}, "mm/s", "1/s", "mm", 0.04, 2.0),
    ],
)
def test_units(units, speed, rate, length, factor, slope):
    found, plain = field(**units), field()
    assert (found.speed, found.rate, found.length) == (speed, rate, length)
    np.testing.assert_allclose(found.u, factor * plain.u)
    np.testing.assert_allclose(found.v, factor * plain.v)
    np.testing.assert_allclose(found.x, units.get("scale", 1.0) * plain.x)
    np.testing.assert_allclose(found.y, units.get("scale", 1.0) * plain.y)
    np.testing.assert_allclose(found.vorticity, slope * plain.vorticity)
    np.testing.assert_allclose(found.divergence, slope * plain.divergence)


# -- tables --------------------------------------------------------------------------------------


def test_a_csv_has_the_columns_of_openpiv_row_by_row_from_the_top(tmp_path):
    write_table(tmp_path / "field.csv", field(), 8)
    lines = (tmp_path / "field.csv").read_text().splitlines()
    assert lines[0] == "x,y,u,v,flags,mask"
    assert lines[1].split(",") == ["4.5", "15.5", "nan", "nan", "0", "1"]
    table = np.loadtxt(tmp_path / "field.csv", delimiter=",", skiprows=1)
    nodes = [(row, column) for row in (4, 12) for column in (4, 12, 20, 28)]
    assert len(table) == len(nodes)
    for (row, column), (x, y, u, v, _, _) in zip(nodes[1:], table[1:], strict=True):
        assert (x, y) == (column + 0.5, H - row - 0.5)
        assert (u, v) == (pytest.approx(FLOW[0, row, column]), pytest.approx(-FLOW[1, row, column]))


def test_the_flags_are_the_doubtful_vectors(tmp_path):
    write_table(tmp_path / "field.csv", field(), 1)
    table = np.loadtxt(tmp_path / "field.csv", delimiter=",", skiprows=1)
    assert len(table) == H * W
    (where,) = np.flatnonzero(table[:, 4])
    assert tuple(table[where, :2]) == (12.5, H - 10.5)
    assert table[:, 5].sum() == 30


def test_a_txt_is_the_file_of_openpiv(tmp_path):
    tools = pytest.importorskip("openpiv.tools")
    found = field(scale=0.02, dt=0.01)
    write_table(tmp_path / "ours.txt", found, 4)
    at = np.ix_(*found.nodes(4))
    x, y = np.meshgrid(found.x[at[1][0]], found.y[at[0][:, 0]])
    columns = (x, y, found.u[at], found.v[at], found.doubtful[at].astype(int), found.mask[at])
    tools.save(tmp_path / "theirs.txt", *columns, fmt="%.7g")
    assert (tmp_path / "ours.txt").read_bytes() == (tmp_path / "theirs.txt").read_bytes()


def test_positions_and_signs_are_those_of_openpiv():
    """Its windows of 8 pixels that fill the picture, and a picture that moves right and down."""
    pyprocess = pytest.importorskip("openpiv.pyprocess")
    from openpiv.tools import transform_coordinates

    noise = np.random.default_rng(1).uniform(0, 255, (64, 96))
    moved = np.roll(noise, (3, 2), axis=(0, 1))
    u, v, *_ = pyprocess.extended_search_area_piv(noise, moved, window_size=32, overlap=16)
    x, y = pyprocess.get_coordinates(noise.shape, search_area_size=32, overlap=16)
    x, y, u, v = transform_coordinates(x, y, u, v)
    ours = to_field(np.stack([np.full(noise.shape, 2.0), np.full(noise.shape, 3.0)]), Units())
    assert np.median(u) == pytest.approx(2, abs=0.1) and np.median(v) == pytest.approx(-3, abs=0.1)
    assert (ours.u == 2).all() and (ours.v == -3).all()
    # the centre of a window of 32 pixels from pixel 0 on is between its pixels 15 and 16
    assert x[0, 0] == ours.x[15:17].mean() and x[0, -1] == ours.x[-17:-15].mean()
    assert y[0, 0] == ours.y[15:17].mean() and y[-1, 0] == ours.y[-17:-15].mean()


# -- NetCDF --------------------------------------------------------------------------------------


def test_a_netcdf_file_says_its_axes_units_and_missing_values(tmp_path):
    xarray = pytest.importorskip("xarray")
    found = field(scale=0.02, dt=0.5)
    write_netcdf(tmp_path / "field.nc", found, "a method")
    with xarray.open_dataset(tmp_path / "field.nc") as read:
        assert read.attrs["Conventions"] == "CF-1.8" and read.attrs["source"] == "a method"
        assert dict(read.sizes) == {"y": H, "x": W}
        assert {name: read[name].attrs["units"] for name in ("x", "y", "u", "v", "vorticity", "divergence")} == {
            "x": "mm", "y": "mm", "u": "mm s-1", "v": "mm s-1", "vorticity": "s-1", "divergence": "s-1",
        }  # fmt: skip
        assert (np.diff(read.y) > 0).all() and (read.x.attrs["axis"], read.y.attrs["axis"]) == ("X", "Y")
        np.testing.assert_allclose(read.u, found.u[::-1], rtol=1e-6)
        np.testing.assert_allclose(read.v, found.v[::-1], rtol=1e-6)
        assert list(read.mask.attrs["flag_values"]) == [0, 1]
        assert read.mask.attrs["flag_meanings"].split() == ["valid", "masked"]
        np.testing.assert_array_equal(read.mask, found.mask[::-1])
        np.testing.assert_array_equal(read.flags, found.doubtful[::-1])
        # the file's own axes give its own vorticity: mm/s by mm
        here = {"x": 20, "y": 5}
        for name, slope in (
            ("vorticity", read.v.differentiate("x") - read.u.differentiate("y")),
            ("divergence", read.u.differentiate("x") + read.v.differentiate("y")),
        ):
            assert float(read[name].isel(here)) == pytest.approx(float(slope.isel(here)), rel=1e-3)


def test_pixels_and_frames_are_no_units_of_cf(tmp_path):
    xarray = pytest.importorskip("xarray")
    write_netcdf(tmp_path / "field.nc", field(), "a method")
    with xarray.open_dataset(tmp_path / "field.nc") as read:
        assert {read[name].attrs["units"] for name in ("x", "y", "u", "v", "vorticity")} == {"1"}
        assert read.u.attrs["long_name"] == "displacement to the right, px"
        assert read.x.attrs["long_name"] == "distance from the left edge, px"


def test_equal_fields_give_equal_bytes(tmp_path):
    pytest.importorskip("xarray")
    for name in ("a.nc", "b.nc"):
        write_netcdf(tmp_path / name, field(), "a method")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.nc", "b.nc"}


def test_without_xarray_one_line_names_the_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"f.nc: NetCDF needs xarray: pip install 'fracbench\[piv\]'"):
        fields.require_netcdf("f.nc")
