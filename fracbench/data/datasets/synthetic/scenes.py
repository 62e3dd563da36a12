"""Rendered scenes with exact flow: eight large ones, six of one structure, and two that mix two kinds of motion.

A scene is a stack of layers. Each has a texture (a sum of cosines, defined at every real point), a support (a
signed distance, in the layer's own coordinates) and an invertible motion phi. Frame 0 shows the layer at p, frame
1 at phi^-1(p): both frames are evaluated, neither is interpolated from the other, and phi(p) - p is the flow
exactly.
"""

from __future__ import annotations

import hashlib
import json
import math
import operator
from collections.abc import Callable

import numpy as np

from fracbench.data.datasets.base import Dataset
from fracbench.data.datasets.synthetic import mixed_structure, single_structure
from fracbench.data.datasets.synthetic.mixed_structure import MIXED_STRUCTURE
from fracbench.data.datasets.synthetic.rendering import (
    Layer,
    Motion,
    SceneBuilder,
    both,
    composite,
    disc,
    half_plane,
    true_flow,
)
from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.data.pair import FramePair
from fracbench.errors import InputError, match_name

GENERATOR_VERSION = 1  # part of every digest: raise it whenever a rendered value may change
SCENES = ("flat", "edge", "corner", "parallax", "rotation", "zoom", "occlusion", "large")
ALL = (*SCENES, *SINGLE_STRUCTURE, *MIXED_STRUCTURE)  # a scene's place is part of its random numbers

#: Height and width of each scene, unless another is asked for.
SHAPES = {
    **dict.fromkeys(SCENES, (128, 160)),
    "corner": (127, 161),
    "zoom": (129, 160),
    **dict.fromkeys(SINGLE_STRUCTURE, (96, 96)),
    **dict.fromkeys(MIXED_STRUCTURE, mixed_structure.SHAPE),
}
_MIN_SIDE = 8


def scene(name: str, *, shape: tuple[int, int] | None = None, noise: float = 0.0, seed: int = 0) -> FramePair:
    """Render a scene with its exact flow.

    Parameters
    ----------
    name : str
        One of `ALL`, without regard to case: ``flat`` (weak texture, slow affine motion), ``edge`` (a straight
        motion edge), ``corner`` (a moving right angle), ``parallax`` (three depths), ``rotation`` (4 degrees),
        ``zoom`` (4 %), ``occlusion`` (a disc crosses), ``large`` (11 pixels, and a small disc); the scenes of one
        structure and of two are described in the modules `single_structure` and `mixed_structure` beside this one.
    shape : (int, int), optional
        Height and width; that of `SHAPES` if not given. Motions stay as they are.
    noise : float, optional
        Standard deviation, in gray levels, of Gaussian noise added to both frames; it is not clipped.
    seed : int, optional
        Seed of the textures' frequencies and phases, the noise and, in a scene of one structure, the motions.

    Returns
    -------
    FramePair
        Frames within 0..255 (before noise); truth known everywhere: the flow of the topmost layer.
    """
    name, shape, noise, seed = _validated(name, shape, noise, seed)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    stack = layers(name, shape=shape, seed=seed)
    frames = [composite(stack, x, y, in_frame1=late) for late in (False, True)]
    if noise > 0:
        rng = _builder(name, shape, seed).random(len(stack))
        frames = [frame + rng.normal(0.0, noise, shape) for frame in frames]
    return FramePair(
        name=name,
        dataset="synthetic",
        frame0=frames[0],
        frame1=frames[1],
        truth=true_flow(stack, x, y),
        digest=digest(name, shape=shape, noise=noise, seed=seed),
    )


def digest(name: str, *, shape: tuple[int, int] | None = None, noise: float = 0.0, seed: int = 0) -> str:
    """Return the digest of `scene` with the same arguments."""
    name, shape, noise, seed = _validated(name, shape, noise, seed)
    what = {"scene": name, "version": GENERATOR_VERSION, "shape": shape, "noise": noise, "seed": seed}
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def layers(name: str, *, shape: tuple[int, int] | None = None, seed: int = 0) -> tuple[Layer, ...]:
    """Return the layers of a scene, the farthest first."""
    name, shape, _, seed = _validated(name, shape, 0.0, seed)
    return _LAYERS[name](_builder(name, shape, seed))


def _validated(
    name: str, shape: tuple[int, int] | None, noise: float, seed: int
) -> tuple[str, tuple[int, int], float, int]:
    name = match_name(name, ALL, "synthetic sequence")
    try:
        height, width = (operator.index(n) for n in shape or SHAPES[name])
        seed, noise = operator.index(seed), float(noise)
    except (TypeError, ValueError) as exc:
        raise InputError(
            f"scene {name!r}: `shape` must be two integers, `seed` an integer and `noise` a number, "
            f"got {shape!r}, {seed!r}, {noise!r}"
        ) from exc
    if min(height, width) < _MIN_SIDE:
        raise InputError(f"scene {name!r}: `shape` must be at least {_MIN_SIDE} a side, got {height} x {width}")
    if not 0.0 <= noise < math.inf:
        raise InputError(f"scene {name!r}: `noise` must be finite and not negative, got {noise}")
    if seed < 0:
        raise InputError(f"scene {name!r}: `seed` must not be negative, got {seed}")
    return name, (height, width), noise, seed


def _builder(name: str, shape: tuple[int, int], seed: int) -> SceneBuilder:
    return SceneBuilder(ALL.index(name), shape, seed)


def _flat(s: SceneBuilder) -> tuple[Layer, ...]:
    motion = Motion((0.7, -0.4), s.centre, ((1.004, 0.002), (-0.003, 1.002)))
    return (Layer(s.texture(0, peak=15.0), motion),)


def _edge(s: SceneBuilder) -> tuple[Layer, ...]:
    return (
        s.behind(Motion((-1.2, 0.4))),
        s.before(1, Motion((1.5, -0.6)), half_plane(s.centre, 20.0)),
    )


def _corner(s: SceneBuilder) -> tuple[Layer, ...]:
    quadrant = both(half_plane(s.centre, 15.0), half_plane(s.centre, 105.0))
    return s.behind(Motion((-0.8, -0.5))), s.before(1, Motion((1.4, 1.1)), quadrant)


def _parallax(s: SceneBuilder) -> tuple[Layer, ...]:
    side = min(s.shape)
    bar = both(half_plane(s.at(-0.4, 0.0), 10.0), half_plane(s.at(-0.15, 0.0), 190.0))
    return (
        s.behind(Motion((0.8, 0.1))),
        s.before(1, Motion((2.0, 0.25)), bar),
        s.before(2, Motion((4.0, 0.5)), disc(s.at(0.2, 0.1), 0.25 * side)),
    )


def _rotation(s: SceneBuilder) -> tuple[Layer, ...]:
    c, d = math.cos(math.radians(4.0)), math.sin(math.radians(4.0))
    return (Layer(s.texture(0, peak=120.0), Motion((0.0, 0.0), s.centre, ((c, -d), (d, c)))),)


def _zoom(s: SceneBuilder) -> tuple[Layer, ...]:
    return (Layer(s.texture(0, peak=120.0), Motion((0.0, 0.0), s.centre, ((1.04, 0.0), (0.0, 1.04)))),)


def _occlusion(s: SceneBuilder) -> tuple[Layer, ...]:
    round_one = disc(s.at(-0.05, 0.05), 0.28 * min(s.shape))
    return s.behind(Motion((-1.5, 0.5))), s.before(1, Motion((5.5, -2.0)), round_one)


def _large(s: SceneBuilder) -> tuple[Layer, ...]:
    round_one = disc(s.at(0.1, -0.05), 0.18 * min(s.shape))
    return s.behind(Motion((10.0, -5.0))), s.before(1, Motion((4.0, 3.0)), round_one)


_LAYERS: dict[str, Callable[[SceneBuilder], tuple[Layer, ...]]] = {
    "flat": _flat,
    "edge": _edge,
    "corner": _corner,
    "parallax": _parallax,
    "rotation": _rotation,
    "zoom": _zoom,
    "occlusion": _occlusion,
    "large": _large,
    **single_structure.BUILDERS,
    **mixed_structure.BUILDERS,
}

DATASET = Dataset(
    name="synthetic",
    summary=f"{len(ALL)} rendered scenes with exact flow",
    names=lambda folder: ALL,
    shape=lambda name, folder: SHAPES[name],
    load=lambda name, folder, *, noise, seed: scene(name, noise=noise, seed=seed),
    digest=lambda name, folder, *, noise, seed: digest(name, noise=noise, seed=seed),
    outliers=False,  # no column of the paper's tables
    settings={"noise": 0.0, "seed": 0},
)
