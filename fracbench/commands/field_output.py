"""A flow as a measured velocity field: its units, and its table, NetCDF file and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fracbench.commands import console
from fracbench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fracbench.data.field import Field

GRID = 16  # pixels from one vector of arrows and tables to the next, unless given


class Units(NamedTuple):
    """The size of a pixel in millimetres, the time between the frames in seconds, and the step of the grid."""

    scale: float | None = None
    dt: float | None = None
    grid: int | None = None

    def require(self, wanted: bool) -> None:
        """Refuse values that no field can have, and values without a file that shows them."""
        for name, value, unit in (("scale", self.scale, "mm a pixel"), ("dt", self.dt, "seconds")):
            if value is not None and not 0.0 < value < math.inf:
                raise InputError(f"--{name} must be a positive number of {unit}, got {value:g}")
        if self.grid is not None and self.grid < 1:
            raise InputError(f"--grid must be at least 1 pixel, got {self.grid}")
        for name in () if wanted else self._fields:
            if getattr(self, name) is not None:
                raise InputError(
                    f"--{name} belongs to --arrows, --vorticity, --csv and --netcdf: give one of them"
                )

    def step(self, size: tuple[int, ...]) -> int:
        """Return the step of the grid on frames of (height, width) pixels."""
        grid = self.grid or GRID
        if min(size) <= grid // 2:
            raise InputError(f"--grid {grid}: no vector of it is within frames of {size[1]} x {size[0]} pixels")
        return grid


class FieldFiles(NamedTuple):
    """The files of a field that are to be written."""

    arrows: Path | None = None
    vorticity: Path | None = None
    csv: Path | None = None
    netcdf: Path | None = None

    @property
    def paths(self) -> list[Path]:
        """All of them."""
        return [path for path in self if path is not None]

    def require(self) -> None:
        """Refuse suffixes, and NetCDF without its package."""
        from fracbench.data.field import NETCDF, TABLES, require_netcdf

        drawn = ((".png", ".pdf"), "a picture of a field is written as .png or .pdf")
        table = (TABLES, "a table is written as .csv (commas) or .txt (as OpenPIV writes it)")
        for path, (suffixes, words) in (
            (self.arrows, drawn),
            (self.vorticity, drawn),
            (self.csv, table),
            (self.netcdf, (NETCDF, "NetCDF is written as .nc")),
        ):
            if path is not None and path.suffix.lower() not in suffixes:
                raise InputError(f"{path}: {words}, not as {path.suffix!r}")
        if self.netcdf is not None:
            require_netcdf(self.netcdf)

    def write(
        self,
        field: Field,
        grid: int,
        source: str,
        *,
        top_speed: float | None = None,
        top_vorticity: float | None = None,
    ) -> None:
        """Write the files; the tops are those of the colour scales, by default from this field."""
        from fracbench.data.field import write_netcdf, write_table
        from fracbench.figures.fields import arrow_figure, vorticity_figure

        if self.csv is not None:
            write_table(self.csv, field, grid)
        if self.netcdf is not None:
            write_netcdf(self.netcdf, field, source)
        if self.arrows is not None:
            _draw(arrow_figure(field, grid, top_speed), self.arrows)
        if self.vorticity is not None:
            _draw(vorticity_figure(field, top_vorticity), self.vorticity)


class SequenceFields(NamedTuple):
    """The kinds of files of a field that are written for each flow of a clip, and their units."""

    arrows: bool = False
    vorticity: bool = False
    csv: bool = False
    netcdf: bool = False
    units: Units = Units()

    @property
    def suffixes(self) -> tuple[str, ...]:
        """The ends of the files' names, after that of the first frame."""
        return tuple(suffix for wanted, suffix in zip(self, _SUFFIXES, strict=False) if wanted)

    def require(self) -> None:
        """Refuse units that no field can have, and NetCDF without its package."""
        from fracbench.data.field import require_netcdf

        self.units.require(bool(self.suffixes))
        if self.netcdf:
            require_netcdf("--netcdf")

    def write(self, stem: Path, field: Field, tops: Mapping[str, float | None], source: str) -> list[Path]:
        """Write the files whose suffixes are in `tops`: ends of their colour scales in px and the field's rate."""
        paths = [stem.with_name(f"{stem.name}{suffix}") if suffix in tops else None for suffix in _SUFFIXES]
        files = FieldFiles(*paths)
        top_speed = (tops.get(_SUFFIXES[0]) or 1.0) * (self.units.scale or 1.0) / (self.units.dt or 1.0)
        top_vorticity = tops.get(_SUFFIXES[1])
        grid = self.units.step(field.u.shape)
        files.write(field, grid, source, top_speed=top_speed, top_vorticity=top_vorticity)
        return files.paths


_SUFFIXES = (".arrows.png", ".vorticity.png", ".csv", ".nc")


def _draw(figure: Any, path: Path) -> None:
    from fracbench.data.files import atomic_path
    from fracbench.figures.style import render

    content = render(figure, path.suffix.lower().removeprefix("."))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def to_field(
    flow: NDArray[Any], units: Units, mask: NDArray[Any] | None = None, doubtful: NDArray[Any] | None = None
) -> Field:
    """Return a flow, (2, H, W) in pixels with y down, as a field in physical axes, y up, and units."""
    import numpy as np

    from fracbench.data.field import Field
    from fracbench.evaluation.derivatives import derivatives

    height, width = flow.shape[1:]
    scale, dt = units.scale or 1.0, units.dt or 1.0
    nowhere = np.zeros((height, width), bool)
    mask = nowhere if mask is None else mask
    known = np.where(mask, np.nan, flow.astype(np.float64))
    slopes = derivatives(known, dt=dt)
    u, v = known * np.array([1.0, -1.0])[:, None, None] * (scale / dt)
    return Field(
        x=np.float64(scale) * (np.arange(width) + 0.5),
        y=np.float64(scale) * (height - 0.5 - np.arange(height)),
        u=u,
        v=v,
        vorticity=-slopes.vorticity,  # y points up here
        divergence=slopes.divergence,
        doubtful=nowhere if doubtful is None else doubtful,
        mask=mask,
        scaled=units.scale is not None,
        timed=units.dt is not None,
    )


def say_written(files: FieldFiles) -> None:
    """Print the names of the files."""
    for path in files.paths:
        console.say(f"wrote {path}")
