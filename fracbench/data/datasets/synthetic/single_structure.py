"""Scenes of a single structure each, to find the best fractional order for each structure.

The structure is in the middle of the frame. Speeds, directions, textures and, where there is one, the direction of
the edge differ from seed to seed, so that results that hold over seeds are due to the structure.

================= ==========================================================================================
``lone_flat``     weak texture, one motion
``lone_edge``     a straight step of brightness between two weak textures that move apart
``lone_corner``   the same about a right angle
``lone_parallax`` a straight edge between two strong textures of one brightness; the nearer moves twice as fast
``lone_affine``   a slanted plane: strong texture, velocity linear across the frame
``lone_curl``     a smooth swirl in a strong texture
================= ==========================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable

from fracbench.data.datasets.synthetic.rendering import (
    MID_GRAY,
    Layer,
    Motion,
    Plane,
    SceneBuilder,
    Swirl,
    Vector,
    both,
    half_plane,
)

SINGLE_STRUCTURE = ("lone_flat", "lone_edge", "lone_corner", "lone_parallax", "lone_affine", "lone_curl")

#: Largest deviation from the mean of a weak and of a strong texture, and half the step between two surfaces, in
#: gray levels.
WEAK, STRONG, STEP = 15.0, 100.0, 40.0
#: Speeds in pixels a frame: of a surface, the least and the most.
SPEEDS = (0.8, 2.0)
#: Change of velocity across a slanted plane, pixels a pixel.
SLANT = 0.03
#: Turn in the middle of the swirl, radians, and its size as a part of the shorter side.
TURN, SWIRL_SIZE = 0.1, 0.25

_MOTIONS = 100  # stream of random numbers: those of textures count from 0


def _flat(s: SceneBuilder) -> tuple[Layer, ...]:
    return (Layer(s.texture(0, peak=WEAK), Motion(dice(s)[0])),)


def _edge(s: SceneBuilder) -> tuple[Layer, ...]:
    _, degrees = dice(s)
    return _step(s, half_plane(s.centre, degrees))


def _corner(s: SceneBuilder) -> tuple[Layer, ...]:
    _, degrees = dice(s)
    return _step(s, both(half_plane(s.centre, degrees), half_plane(s.centre, degrees + 90.0)))


def _step(s: SceneBuilder, support: Callable[[Plane, Plane], Plane]) -> tuple[Layer, ...]:
    """Return a bright surface before a dark one that moves against it at half its speed."""
    (right, down), _ = dice(s)
    return (
        Layer(s.texture(0, peak=WEAK, mean=MID_GRAY - STEP), Motion((-0.5 * right, -0.5 * down))),
        Layer(s.texture(1, peak=WEAK, mean=MID_GRAY + STEP), Motion((right, down)), support),
    )


def _parallax(s: SceneBuilder) -> tuple[Layer, ...]:
    (right, down), degrees = dice(s)
    return (
        Layer(s.texture(0, peak=STRONG), Motion((0.75 * right, 0.75 * down))),
        Layer(s.texture(1, peak=STRONG), Motion((1.5 * right, 1.5 * down)), half_plane(s.centre, degrees)),
    )


def _affine(s: SceneBuilder) -> tuple[Layer, ...]:
    (right, down), degrees = dice(s)
    nx, ny = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    speed = math.hypot(right, down)
    wx, wy = SLANT * right / speed, SLANT * down / speed
    slant = ((1.0 + wx * nx, wx * ny), (wy * nx, 1.0 + wy * ny))
    return (Layer(s.texture(0, peak=STRONG), Motion((right, down), s.centre, slant)),)


def _curl(s: SceneBuilder) -> tuple[Layer, ...]:
    velocity, degrees = dice(s)
    turn = TURN if degrees < 180.0 else -TURN
    return (Layer(s.texture(0, peak=STRONG), Swirl(velocity, s.centre, turn, SWIRL_SIZE * min(s.shape))),)


def dice(s: SceneBuilder) -> tuple[Vector, float]:
    """Return a velocity and a direction in degrees, the same at every call."""
    rng = s.random(_MOTIONS)
    speed, heading, degrees = rng.uniform(*SPEEDS), rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, 360.0)
    return (speed * math.cos(heading), speed * math.sin(heading)), degrees


BUILDERS: dict[str, Callable[[SceneBuilder], tuple[Layer, ...]]] = {
    "lone_flat": _flat,
    "lone_edge": _edge,
    "lone_corner": _corner,
    "lone_parallax": _parallax,
    "lone_affine": _affine,
    "lone_curl": _curl,
}
