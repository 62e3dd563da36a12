"""Scenes that mix smooth motion and edges of motion in one frame: no single order suits all of it.

================ ===========================================================================================
``mixed_patch``  a disc that moves by an affine map, over ground that moves as one
``mixed_vortex`` a smooth swirl in the ground, beside a straight edge before which another surface moves
================ ===========================================================================================

Textures are strong and of one mean, so that brightness does not tell the surfaces apart. Speeds, directions and
textures differ from seed to seed.

The frames are larger than those of one structure, since each kind of motion needs its room: in a frame of 96
pixels the patch has 38 pixels across, and three quarters of the error are within 3 pixels of its edge, so that one
order is right for the scene (docs/beyond.md). Here the patch fills half of the middle 96 x 96 pixels, and the
swirl has nearly the size of ``lone_curl``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from fracbench.data.datasets.synthetic.rendering import Layer, Motion, SceneBuilder, Swirl, disc, half_plane
from fracbench.data.datasets.synthetic.single_structure import SLANT, STRONG, TURN, dice

MIXED_STRUCTURE = ("mixed_patch", "mixed_vortex")

#: Height and width of the frames.
SHAPE = (144, 144)
#: Radius of the patch, and size and distance from the centre of the swirl, as parts of the shorter side.
RADIUS, SWIRL_SIZE, ASIDE = 0.28, 0.14, 0.18


def _patch(s: SceneBuilder) -> tuple[Layer, ...]:
    (right, down), degrees = dice(s)
    turned = math.radians(degrees)
    a, b = 2.0 * SLANT * math.cos(turned), 2.0 * SLANT * math.sin(turned)
    affine = Motion((-0.5 * right, -0.5 * down), s.centre, ((1.0 + a, b), (-b, 1.0 + a)))
    return (
        Layer(s.texture(0, peak=STRONG), Motion((right, down))),
        Layer(s.texture(1, peak=STRONG), affine, disc(s.centre, RADIUS * min(s.shape))),
    )


def _vortex(s: SceneBuilder) -> tuple[Layer, ...]:
    (right, down), degrees = dice(s)
    turn = TURN if degrees < 180.0 else -TURN
    swirl = Swirl((-0.5 * right, -0.5 * down), s.at(-ASIDE, 0.0), turn, SWIRL_SIZE * min(s.shape))
    side = half_plane(s.at(ASIDE, 0.0), (degrees % 40.0) - 20.0)
    return (
        Layer(s.texture(0, peak=STRONG), swirl),
        Layer(s.texture(1, peak=STRONG), Motion((right, down)), side),
    )


BUILDERS: dict[str, Callable[[SceneBuilder], tuple[Layer, ...]]] = {"mixed_patch": _patch, "mixed_vortex": _vortex}
