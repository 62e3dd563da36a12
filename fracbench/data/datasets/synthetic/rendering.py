"""The parts of rendered scenes: layers with textures, supports and motions, and a builder of scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# The shortest wavelength stays above 4 pixels in both frames, whatever the motion of the scene.
MIN_WAVELENGTH = 4.5
MAX_WAVELENGTH = 64.0
N_WAVES = 16
MID_GRAY = 127.5
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

Plane = NDArray[np.float64]
Vector = tuple[float, float]


class Moving(Protocol):
    """A map from frame 0 to frame 1 with its exact inverse; points are (x, y)."""

    def forward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 0 are in frame 1."""

    def backward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 1 were in frame 0."""


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


@dataclass(frozen=True)
class Swirl:
    """The map ``phi(p) = c + R(p - c) + t``, R turning by ``angle exp(-|p - c|^2 / (2 size^2))``, in radians.

    It keeps ``|p - c|``, on which R depends: the inverse turns back by the same angle.
    """

    translation: Vector
    centre: Vector
    angle: float
    size: float

    def forward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 0 are in frame 1."""
        dx, dy = self._turned(x - self.centre[0], y - self.centre[1], self.angle)
        return self.centre[0] + self.translation[0] + dx, self.centre[1] + self.translation[1] + dy

    def backward(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where the points of frame 1 were in frame 0: the exact inverse of `forward`."""
        dx = x - self.centre[0] - self.translation[0]
        dy = y - self.centre[1] - self.translation[1]
        dx, dy = self._turned(dx, dy, -self.angle)
        return self.centre[0] + dx, self.centre[1] + dy

    def _turned(self, dx: Plane, dy: Plane, angle: float) -> tuple[Plane, Plane]:
        turn = angle * np.exp(-(dx * dx + dy * dy) / (2.0 * self.size**2))
        c, s = np.cos(turn), np.sin(turn)
        return c * dx - s * dy, s * dx + c * dy


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
    motion: Moving
    distance: Callable[[Plane, Plane], Plane] | None = None

    def coverage(self, x: Plane, y: Plane) -> Plane:
        """Return how much of a pixel at (x, y) of frame 0 the layer covers; its edge is 1 pixel wide."""
        if self.distance is None:
            return np.ones(np.shape(x))
        s = np.clip(self.distance(x, y) + 0.5, 0.0, 1.0)
        return s * s * (3.0 - 2.0 * s)


@dataclass(frozen=True)
class SceneBuilder:
    """The parameters of a scene, and the parts drawn from its random numbers; each scene has its own."""

    scene: int
    shape: tuple[int, int]
    seed: int

    def random(self, stream: int) -> np.random.Generator:
        """Return a generator of random numbers; streams are independent of each other."""
        return np.random.default_rng([self.seed, self.scene, stream])

    @property
    def centre(self) -> Vector:
        """The middle of the frame."""
        return (self.shape[1] - 1) / 2.0, (self.shape[0] - 1) / 2.0

    def at(self, right: float, down: float) -> Vector:
        """Return the point at this offset from the centre, in units of the shorter side."""
        side = min(self.shape)
        return self.centre[0] + right * side, self.centre[1] + down * side

    def texture(self, stream: int, peak: float = 90.0, mean: float = MID_GRAY) -> Texture:
        """Draw a texture: wavelengths over all octaves, directions over the half circle, amplitudes ~ 1/f.

        Wavelengths and directions are stratified: no seed gives stripes, or a texture without fine detail.
        """
        rng = self.random(stream)
        octaves = (np.arange(N_WAVES) + rng.random(N_WAVES)) / N_WAVES
        wavelength = MIN_WAVELENGTH * (MAX_WAVELENGTH / MIN_WAVELENGTH) ** octaves
        angle = np.pi * rng.random() + _GOLDEN_ANGLE * np.arange(N_WAVES)
        phase = 2.0 * np.pi * rng.random(N_WAVES)
        amplitude = peak * wavelength / wavelength.sum()
        return Texture(mean, amplitude, np.cos(angle) / wavelength, np.sin(angle) / wavelength, phase)

    def behind(self, motion: Moving) -> Layer:
        """Return a background, a little darker than the objects before it."""
        return Layer(self.texture(0, mean=MID_GRAY - 30.0), motion)

    def before(self, stream: int, motion: Moving, distance: Callable[[Plane, Plane], Plane]) -> Layer:
        """Return an object, a little brighter than the background."""
        return Layer(self.texture(stream, mean=MID_GRAY + 30.0), motion, distance)


def half_plane(point: Vector, degrees: float) -> Callable[[Plane, Plane], Plane]:
    """Return the signed distance to the half plane through `point` on the side that `degrees` points to."""
    nx, ny = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return lambda x, y: nx * (x - point[0]) + ny * (y - point[1])


def disc(centre: Vector, radius: float) -> Callable[[Plane, Plane], Plane]:
    """Return the signed distance to a disc."""
    return lambda x, y: radius - np.hypot(x - centre[0], y - centre[1])


def both(
    one: Callable[[Plane, Plane], Plane], other: Callable[[Plane, Plane], Plane]
) -> Callable[[Plane, Plane], Plane]:
    """Return the signed distance to where two supports overlap."""
    return lambda x, y: np.minimum(one(x, y), other(x, y))


def composite(stack: tuple[Layer, ...], x: Plane, y: Plane, *, in_frame1: bool) -> Plane:
    """Render a frame, the farthest layer first."""
    image = np.zeros(x.shape)
    for layer in stack:
        lx, ly = layer.motion.backward(x, y) if in_frame1 else (x, y)
        cover = layer.coverage(lx, ly)
        image = (1.0 - cover) * image + cover * layer.texture(lx, ly)
    return image


def true_flow(stack: tuple[Layer, ...], x: Plane, y: Plane) -> NDArray[np.float32]:
    """Return the motion of the topmost layer at each pixel, shape (2, H, W)."""
    flow = np.zeros((2, *x.shape))
    for layer in stack:
        fx, fy = layer.motion.forward(x, y)
        on_top = layer.coverage(x, y) >= 0.5
        flow[:, on_top] = np.stack((fx - x, fy - y))[:, on_top]
    return flow.astype(np.float32)
