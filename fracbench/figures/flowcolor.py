"""The Middlebury colour code of flow (Baker et al., IJCV 2011): hue is direction, saturation is speed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.files import UNKNOWN_ABOVE
from fracbench.errors import InputError

_OUT_OF_RANGE_DIM = 0.75  # brightness of pixels that move faster than the colour scale reaches

# Steps between neighbouring corners of the RGB cube: red-yellow, yellow-green, green-cyan, cyan-blue,
# blue-magenta, magenta-red. They are unequal because the eye tells more hues apart in some than in others.
_ARCS = (15, 6, 4, 11, 13, 6)
_CORNERS = ((255, 0, 0), (255, 255, 0), (0, 255, 0), (0, 255, 255), (0, 0, 255), (255, 0, 255))

# The scale is often taken from a float32 flow: without slack its fastest pixel may round to out of range.
_RADIUS_SLACK = 1e-6


def wheel_colours() -> NDArray[np.float64]:
    """Return the wheel's 55 colours, (55, 3) in 0..255, from rightward motion (red) over downward (yellow) on."""
    corners = np.array(_CORNERS, dtype=np.int64)
    arcs = []
    for start, stop, steps in zip(corners, np.roll(corners, -1, axis=0), _ARCS, strict=True):
        rise = 255 * np.arange(steps)[:, None] // steps
        arcs.append(start + np.sign(stop - start) * rise)
    return np.concatenate(arcs).astype(np.float64)


def flow_to_color(flow: NDArray[Any], max_motion: float | None = None) -> NDArray[np.uint8]:
    """Paint a (2, H, W) flow in the Middlebury colour code: (H, W, 3) uint8, white where nothing moves.

    Unknown pixels, with NaN or more than 1e9 in a component, are black. `max_motion` is the speed in pixels that
    gets the full colour, by default the largest of this flow; faster pixels are dimmed.
    """
    field, known = _known_flow(flow)
    u, v = field
    speed = np.hypot(u, v)
    radius = speed / _scale(speed, max_motion)
    colour = _saturate(_hue(u, v), radius[..., None])
    # Truncated, not rounded, as Middlebury's own code does it.
    return np.where(known[..., None], np.floor(255.0 * colour), 0.0).astype(np.uint8)


def color_wheel(size: int) -> NDArray[np.uint8]:
    """Return the legend, (size, size, 3) uint8: each pixel in the colour of the motion from the centre to it.

    The disc's rim is `max_motion`; outside it is white.
    """
    if size < 2:
        raise InputError(f"color_wheel: `size` must be at least 2 pixels, got {size}")
    axis = np.linspace(-1.0, 1.0, size)
    motion = np.stack(np.meshgrid(axis, axis))
    inside = np.hypot(*motion) <= 1.0
    return flow_to_color(np.where(inside, motion, 0.0), max_motion=1.0)


def _known_flow(flow: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return a (2, H, W) flow with 0 where a component is unknown, and the (H, W) mask of known pixels."""
    field = np.asarray(flow, dtype=np.float64)
    if field.ndim != 3 or field.shape[0] != 2:
        raise InputError(f"`flow` must have shape (2, H, W), got {field.shape}")
    known = np.all(np.abs(field) <= UNKNOWN_ABOVE, axis=0)
    return np.where(known, field, 0.0), known


def fastest(flow: NDArray[Any]) -> float:
    """Return the largest known speed of a (2, H, W) flow in pixels; 0 if no pixel is known."""
    return float(np.hypot(*_known_flow(flow)[0]).max(initial=0.0))


def _scale(speed: NDArray[np.float64], max_motion: float | None) -> float:
    if max_motion is None:
        return float(speed.max(initial=0.0)) or 1.0
    if not (np.isfinite(max_motion) and max_motion > 0):
        raise InputError(f"`max_motion` must be a positive number of pixels, got {max_motion}")
    return float(max_motion)


def _hue(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the fully saturated colour, (H, W, 3) in 0..1, of each direction."""
    wheel = wheel_colours() / 255.0
    # Adding zero turns -0.0 into 0.0: the wheel's seam is at v = 0, where the sign of a zero picks a side.
    angle = np.arctan2(-(v + 0.0), -(u + 0.0))
    position = (angle / np.pi + 1.0) / 2.0 * (len(wheel) - 1)
    lower = np.floor(position).astype(np.intp)
    part = (position - lower)[..., None]
    upper = (lower + 1) % len(wheel)
    return np.asarray((1.0 - part) * wheel[lower] + part * wheel[upper])


def _saturate(hue: NDArray[np.float64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fade a colour to white towards radius 0; dim it beyond radius 1."""
    within = 1.0 - np.minimum(radius, 1.0) * (1.0 - hue)
    return np.where(radius <= 1.0 + _RADIUS_SLACK, within, _OUT_OF_RANGE_DIM * hue)
