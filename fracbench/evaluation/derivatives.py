"""First derivatives of a flow: vorticity, divergence and strain rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Derivatives:
    """First derivatives of a flow, per unit of time, on the grid of the flow; see `derivatives`.

    Attributes
    ----------
    vorticity : ndarray of float64, (H, W)
        d u2/dx - d u1/dy. The y axis points down, so a positive value is a rotation from x (right) to y (down):
        clockwise on the picture.
    divergence : ndarray of float64, (H, W)
        d u1/dx + d u2/dy, positive at a source.
    strain : ndarray of float64, (3, H, W)
        The symmetric part of the gradient: e_xx = d u1/dx, e_yy = d u2/dy, e_xy = (d u1/dy + d u2/dx) / 2.
    """

    vorticity: Map
    divergence: Map
    strain: Map


def derivatives(flow: Any, *, spacing: float = 1.0, dt: float = 1.0) -> Derivatives:
    """Return vorticity, divergence and strain rate of a flow, by second-order central differences.

    Parameters
    ----------
    flow : array_like, (2, H, W)
        Displacements: flow[0] = u1 along x (to the right), flow[1] = u2 along y (down). H and W are at least 3.
    spacing : float
        Distance of neighbouring values of the grid, in the unit of the displacements: 1 for a dense flow in
        pixels, 16 for a flow in pixels on a grid of 16 pixels. A scale that multiplies displacements and
        distances alike changes no derivative.
    dt : float
        Time between the frames, e.g. seconds; the derivatives then are in 1/s.

    Returns
    -------
    Derivatives
        Computed in float64: (f(x + h) - f(x - h)) / 2h within the grid, and at its edges the one-sided difference
        of the same order, (-3 f(x) + 4 f(x + h) - f(x + 2h)) / 2h, so that the error falls as h^2 everywhere.
        NaN where one of the values used is NaN.

    Raises
    ------
    InputError
        If the shape is not (2, H, W) with H and W at least 3, or if `spacing` or `dt` is not positive and finite.
    """
    values = np.asarray(flow, dtype=np.float64)
    if values.ndim != 3 or values.shape[0] != 2 or min(values.shape[1:]) < 3:
        raise InputError(f"`flow` must have the shape (2, H, W) with H and W at least 3, not {values.shape}")
    for name, value in (("spacing", spacing), ("dt", dt)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"`{name}` must be a positive, finite number, got {value}")
    (u1_y, u1_x), (u2_y, u2_x) = (np.gradient(part / dt, spacing, edge_order=2) for part in values)
    return Derivatives(u2_x - u1_y, u1_x + u2_y, np.stack([u1_x, u2_y, (u1_y + u2_x) / 2]))
