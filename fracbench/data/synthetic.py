"""Eight rendered scenes with exact flow.

A scene is a stack of layers. Each has a texture (a sum of cosines, defined at every real point), a support (a
signed distance, in the layer's own coordinates) and an affine motion phi. Frame 0 shows the layer at p, frame
1 at phi^-1(p): both frames are evaluated, neither is interpolated from the other, and phi(p) - p is the flow
exactly.
"""

from __future__ import annotations

import hashlib
import json
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fracbench.data.names import match_name
from fracbench.data.sequence import Sequence
from fracbench.errors import InputError

GENERATOR_VERSION = 1  # part of every digest: raise it whenever a rendered value may change
SCENES = ("flat", "edge", "corner", "parallax", "rotation", "zoom", "occlusion", "large")

# The shortest wavelength stays above 4 pixels in both frames, whatever the motion of the scene.
MIN_WAVELENGTH = 4.5
MAX_WAVELENGTH = 64.0
N_WAVES = 16

#: Height and width of each scene, unless another is asked for.
SHAPES = {**dict.fromkeys(SCENES, (128, 160)), "corner": (127, 161), "zoom": (129, 160)}
_MIN_SIDE = 8
_MID_GRAY = 127.5
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

Plane = NDArray[np.float64]
Vector = tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """The affine map ``phi(p) = c + A (p - c) + t`` from frame 0 to frame 1; points are (x, y)."""

    translation: Vector
    centre: Vector = (0.0, 0.0)
    matrix: tuple[Vector, Vector] = ((1.0, 0.0), (0.0, 1.0))

    def forward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 0 are in frame 1."""
        (a, b), (c, d) = self.matrix
        dx, dy = x - self.centre[0], y - self.centre[1]
        ox, oy = self.centre[0] + self.translation[0], self.centre[1] + self.translation[1]
        return ox + a * dx + b * dy, oy + c * dx + d * dy

    def backward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 1 were in frame 0: the exact inverse of `forward`."""
        (a, b), (c, d) = self.matrix
        det = a * d - b * c
        dx = x - self.centre[0] - self.translation[0]
        dy = y - self.centre[1] - self.translation[1]
        return self.centre[0] + (d * dx - b * dy) / det, self.centre[1] + (a * dy - c * dx) / det


@dataclass(frozen=True, eq=False)
class Texture:
    """Gray levels ``mean + sum_k a_k cos(2 pi (fx_k x + fy_k y) + phase_k)``, within mean +- sum a_k."""

    mean: float
    amplitude: NDArray[np.float64]
    fx: NDArray[np.float64]
    fy: NDArray[np.float64]
    phase: NDArray[np.float64]

    def __call__(self, x: Plane, y: Plane) -> Plane:
        """Evaluate at real points."""
        value = np.full(np.shape(x), self.mean)
        for a, fx, fy, phase in zip(self.amplitude, self.fx, self.fy, self.phase, strict=True):
            value += a * np.cos(2.0 * np.pi * (fx * x + fy * y) + phase)
        return value


@dataclass(frozen=True, eq=False)
class Layer:
    """A texture, its motion and its support: a signed distance (positive inside) in frame 0, or None."""

    texture: Texture
    motion: Motion
    distance: Callable[[Plane, Plane], Plane] | None = None

    def coverage(self, x: Plane, y: Plane) -> Plane:
        """Return how much of a pixel at (x, y) of frame 0 the layer covers; its edge is 1 pixel wide."""
        if self.distance is None:
            return np.ones(np.shape(x))
        s = np.clip(self.distance(x, y) + 0.5, 0.0, 1.0)
        return s * s * (3.0 - 2.0 * s)


def scene(name: str, *, shape: tuple[int, int] | None = None, noise: float = 0.0, seed: int = 0) -> Sequence:
    """Render a scene with its exact flow.

    Parameters
    ----------
    name : str
        One of `SCENES`, without regard to case: ``flat`` (weak texture, slow affine motion), ``edge`` (a
        straight motion edge), ``corner`` (a moving right angle), ``parallax`` (three depths), ``rotation``
        (4 degrees), ``zoom`` (4 %), ``occlusion`` (a disc crosses), ``large`` (11 pixels, and a small disc).
    shape : (int, int), optional
        Height and width; 128 x 160 or about that if not given. Motions stay as they are.
    noise : float, optional
        Standard deviation, in gray levels, of Gaussian noise added to both frames; it is not clipped.
    seed : int, optional
        Chooses frequencies and phases of the textures, and the noise.

    Returns
    -------
    Sequence
        Frames within 0..255 (before noise); truth known everywhere: the flow of the topmost layer.

    Raises
    ------
    InputError
        If there is no such scene, or a parameter cannot be used.
    """
    name, shape, noise, seed = _validated(name, shape, noise, seed)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    stack = layers(name, shape=shape, seed=seed)
    frames = [_composite(stack, x, y, in_frame1=late) for late in (False, True)]
    if noise > 0:
        rng = _generator(name, seed, len(stack))
        frames = [frame + rng.normal(0.0, noise, shape) for frame in frames]
    return Sequence(
        name=name,
        dataset="synthetic",
        frame0=frames[0],
        frame1=frames[1],
        truth=_truth(stack, x, y),
        digest=digest(name, shape=shape, noise=noise, seed=seed),
    )


def digest(name: str, *, shape: tuple[int, int] | None = None, noise: float = 0.0, seed: int = 0) -> str:
    """Return the digest of `scene` with the same arguments, without rendering it."""
    name, shape, noise, seed = _validated(name, shape, noise, seed)
    what = {"scene": name, "version": GENERATOR_VERSION, "shape": shape, "noise": noise, "seed": seed}
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def layers(name: str, *, shape: tuple[int, int] | None = None, seed: int = 0) -> tuple[Layer, ...]:
    """Return the layers of a scene, the farthest first; see `scene` for the parameters."""
    name, shape, _, seed = _validated(name, shape, 0.0, seed)
    return _LAYERS[name](_Studio(name, shape, seed))


def _validated(
    name: str, shape: tuple[int, int] | None, noise: float, seed: int
) -> tuple[str, tuple[int, int], float, int]:
    name = match_name(name, SCENES, "synthetic sequence")
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


def _composite(stack: tuple[Layer, ...], x: Plane, y: Plane, *, in_frame1: bool) -> Plane:
    image = np.zeros(x.shape)
    for layer in stack:
        lx, ly = layer.motion.backward(x, y) if in_frame1 else (x, y)
        cover = layer.coverage(lx, ly)
        image = (1.0 - cover) * image + cover * layer.texture(lx, ly)
    return image


def _truth(stack: tuple[Layer, ...], x: Plane, y: Plane) -> NDArray[np.float32]:
    flow = np.zeros((2, *x.shape))
    for layer in stack:
        fx, fy = layer.motion.forward(x, y)
        on_top = layer.coverage(x, y) >= 0.5
        flow[:, on_top] = np.stack((fx - x, fy - y))[:, on_top]
    return flow.astype(np.float32)


def _generator(name: str, seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([seed, SCENES.index(name), stream])


@dataclass(frozen=True)
class _Studio:
    """What the scenes below are built from."""

    name: str
    shape: tuple[int, int]
    seed: int

    @property
    def centre(self) -> Vector:
        return (self.shape[1] - 1) / 2.0, (self.shape[0] - 1) / 2.0

    def at(self, right: float, down: float) -> Vector:
        """Return the point that many shorter sides away from the centre."""
        side = min(self.shape)
        return self.centre[0] + right * side, self.centre[1] + down * side

    def texture(self, stream: int, peak: float = 90.0, mean: float = _MID_GRAY) -> Texture:
        """Draw a texture: wavelengths over all octaves, directions over the half circle, amplitudes ~ 1/f.

        Wavelengths and directions are stratified: no seed gives stripes, or a texture without fine detail.
        """
        rng = _generator(self.name, self.seed, stream)
        octaves = (np.arange(N_WAVES) + rng.random(N_WAVES)) / N_WAVES
        wavelength = MIN_WAVELENGTH * (MAX_WAVELENGTH / MIN_WAVELENGTH) ** octaves
        angle = np.pi * rng.random() + _GOLDEN_ANGLE * np.arange(N_WAVES)
        phase = 2.0 * np.pi * rng.random(N_WAVES)
        amplitude = peak * wavelength / wavelength.sum()
        return Texture(mean, amplitude, np.cos(angle) / wavelength, np.sin(angle) / wavelength, phase)

    def behind(self, motion: Motion) -> Layer:
        """Return a background, a little darker than what stands before it."""
        return Layer(self.texture(0, mean=_MID_GRAY - 30.0), motion)

    def before(self, stream: int, motion: Motion, distance: Callable[[Plane, Plane], Plane]) -> Layer:
        """Return an object, a little brighter than the background."""
        return Layer(self.texture(stream, mean=_MID_GRAY + 30.0), motion, distance)


def _half_plane(point: Vector, degrees: float) -> Callable[[Plane, Plane], Plane]:
    """Return the signed distance to the half plane through `point` on the side that `degrees` points to."""
    nx, ny = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return lambda x, y: nx * (x - point[0]) + ny * (y - point[1])


def _disc(centre: Vector, radius: float) -> Callable[[Plane, Plane], Plane]:
    return lambda x, y: radius - np.hypot(x - centre[0], y - centre[1])


def _both(
    one: Callable[[Plane, Plane], Plane], other: Callable[[Plane, Plane], Plane]
) -> Callable[[Plane, Plane], Plane]:
    return lambda x, y: np.minimum(one(x, y), other(x, y))


def _flat(s: _Studio) -> tuple[Layer, ...]:
    motion = Motion((0.7, -0.4), s.centre, ((1.004, 0.002), (-0.003, 1.002)))
    return (Layer(s.texture(0, peak=15.0), motion),)


def _edge(s: _Studio) -> tuple[Layer, ...]:
    return (
        s.behind(Motion((-1.2, 0.4))),
        s.before(1, Motion((1.5, -0.6)), _half_plane(s.centre, 20.0)),
    )


def _corner(s: _Studio) -> tuple[Layer, ...]:
    quadrant = _both(_half_plane(s.centre, 15.0), _half_plane(s.centre, 105.0))
    return s.behind(Motion((-0.8, -0.5))), s.before(1, Motion((1.4, 1.1)), quadrant)


def _parallax(s: _Studio) -> tuple[Layer, ...]:
    side = min(s.shape)
    bar = _both(_half_plane(s.at(-0.4, 0.0), 10.0), _half_plane(s.at(-0.15, 0.0), 190.0))
    return (
        s.behind(Motion((0.8, 0.1))),
        s.before(1, Motion((2.0, 0.25)), bar),
        s.before(2, Motion((4.0, 0.5)), _disc(s.at(0.2, 0.1), 0.25 * side)),
    )


def _rotation(s: _Studio) -> tuple[Layer, ...]:
    c, d = math.cos(math.radians(4.0)), math.sin(math.radians(4.0))
    return (Layer(s.texture(0, peak=120.0), Motion((0.0, 0.0), s.centre, ((c, -d), (d, c)))),)


def _zoom(s: _Studio) -> tuple[Layer, ...]:
    return (Layer(s.texture(0, peak=120.0), Motion((0.0, 0.0), s.centre, ((1.04, 0.0), (0.0, 1.04)))),)


def _occlusion(s: _Studio) -> tuple[Layer, ...]:
    disc = _disc(s.at(-0.05, 0.05), 0.28 * min(s.shape))
    return s.behind(Motion((-1.5, 0.5))), s.before(1, Motion((5.5, -2.0)), disc)


def _large(s: _Studio) -> tuple[Layer, ...]:
    disc = _disc(s.at(0.1, -0.05), 0.18 * min(s.shape))
    return s.behind(Motion((10.0, -5.0))), s.before(1, Motion((4.0, 3.0)), disc)


_LAYERS: dict[str, Callable[[_Studio], tuple[Layer, ...]]] = {
    "flat": _flat,
    "edge": _edge,
    "corner": _corner,
    "parallax": _parallax,
    "rotation": _rotation,
    "zoom": _zoom,
    "occlusion": _occlusion,
    "large": _large,
}
