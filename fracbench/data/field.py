"""A velocity field in physical axes and units, and its files: a table, and NetCDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.files import atomic_path
from fracbench.errors import InputError

#: The columns of a table, in the order of ``openpiv.tools.save``.
COLUMNS = ("x", "y", "u", "v", "flags", "mask")
TABLES, NETCDF = (".csv", ".txt"), (".nc",)

_DIGITS = "%.7g"  # all that a float32 holds


@dataclass(frozen=True)
class Field:
    """A velocity field in the axes of OpenPIV's files: x to the right, y up.

    The origin is the lower left corner of the picture. All rows are the picture's, the top one first.

    Attributes
    ----------
    x, y : ndarray of float64, (W,) and (H,)
        Centres of the pixels in `length`: the first column is at half a pixel, and so is the last row.
    u, v : ndarray of float64, (H, W)
        Velocities to the right and up, in `speed`; NaN where `mask` is true.
    vorticity, divergence : ndarray of float64, (H, W)
        dv/dx - du/dy, positive where the motion turns counter-clockwise, and du/dx + dv/dy, in `rate`.
    doubtful, mask : ndarray of bool, (H, W)
        True where the flow back disagrees with the flow, and where the pixels of the frames do not count.
    scaled, timed : bool
        Whether lengths are in millimetres, else in pixels, and times in seconds, else in intervals of two frames.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    vorticity: NDArray[np.float64]
    divergence: NDArray[np.float64]
    doubtful: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    scaled: bool = False
    timed: bool = False

    @property
    def length(self) -> str:
        """The unit of lengths."""
        return "mm" if self.scaled else "px"

    @property
    def speed(self) -> str:
        """The unit of velocities; without a time it is that of displacements."""
        return f"{self.length}/s" if self.timed else self.length

    @property
    def rate(self) -> str:
        """The unit of vorticity and divergence."""
        return "1/s" if self.timed else "1/frame"

    def nodes(self, grid: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of a grid of every `grid`-th pixel, which begins half a step from the edges."""
        rows, columns = (np.arange(grid // 2, side, grid) for side in self.u.shape)
        return rows, columns


def write_table(path: Path, field: Field, grid: int) -> None:
    """Write the values at every `grid`-th pixel, row by row from the top; flags are 1 where a vector is doubtful.

    ``.txt`` is the file that ``openpiv.tools.save`` writes: tabs, and a line of names that begins with ``# ``;
    ``.csv`` has commas, and the names alone.
    """
    rows, columns = field.nodes(grid)
    at = np.ix_(rows, columns)
    x, y = np.meshgrid(field.x[columns], field.y[rows])
    values = [x, y, *(array[at] for array in (field.u, field.v, field.doubtful, field.mask))]
    delimiter, comments = (",", "") if path.suffix.lower() == ".csv" else ("\t", "# ")
    with atomic_path(path) as temporary:
        np.savetxt(
            temporary,
            np.column_stack([array.ravel() for array in values]),
            fmt=_DIGITS,
            delimiter=delimiter,
            header=delimiter.join(COLUMNS),
            comments=comments,
        )


def require_netcdf(where: Path | str) -> None:
    """Refuse NetCDF where xarray is missing; `where` is what the message names."""
    from importlib.util import find_spec

    if find_spec("xarray") is None:
        raise InputError(f"{where}: NetCDF needs xarray: pip install 'fracbench[piv]'")


def write_netcdf(path: Path, field: Field, source: str) -> None:
    """Write all pixels as NetCDF 3 by the conventions CF-1.8, y ascending; `source` names the method."""
    import xarray

    # UDUNITS, whose units CF takes, knows no pixel and no frame: both are counted.
    length, time = ("mm" if field.scaled else "1"), ("s-1" if field.timed else "1")
    speed = " ".join(unit for unit in (length, time) if unit != "1") or "1"
    kind = "velocity" if field.timed else "displacement"
    maps: dict[str, tuple[NDArray[Any], str, str]] = {
        "u": (field.u, f"{kind} to the right, {field.speed}", speed),
        "v": (field.v, f"{kind} up, {field.speed}", speed),
        "vorticity": (field.vorticity, f"dv/dx - du/dy, {field.rate}, positive: counter-clockwise", time),
        "divergence": (field.divergence, f"du/dx + dv/dy, {field.rate}", time),
    }
    marks = {
        "flags": (field.doubtful, "check by the flow back", "not_doubtful doubtful"),
        "mask": (field.mask, "pixels of the frames that do not count", "valid masked"),
    }
    data: dict[str, Any] = {
        name: (("y", "x"), values.astype(np.float32), {"long_name": words, "units": unit})
        for name, (values, words, unit) in maps.items()
    }
    for name, (values, words, meanings) in marks.items():
        told = {"long_name": words, "flag_values": np.array([0, 1], np.int8), "flag_meanings": meanings}
        data[name] = (("y", "x"), values.astype(np.int8), told)
    coordinates = {
        name: (name, values, {"long_name": f"{words}, {field.length}", "units": length, "axis": name.upper()})
        for name, values, words in (
            ("x", field.x, "distance from the left edge"),
            ("y", field.y, "distance from the lower edge"),
        )
    }
    about = {"Conventions": "CF-1.8", "title": "Velocity field of two images", "source": source}
    dataset = xarray.Dataset(data, coordinates, about).isel(y=slice(None, None, -1))
    for name in coordinates:
        dataset[name].encoding["_FillValue"] = None  # CF: coordinates have no missing values
    with atomic_path(path) as temporary:
        dataset.to_netcdf(temporary, engine="scipy", format="NETCDF3_64BIT")
