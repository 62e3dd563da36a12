"""Velocity fields of fluids, and the displacement of what they carry.

All fields are steady and free of divergence. Points are (x, y), x to the right and y down, in pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float64]
Velocity = Callable[[Plane, Plane], tuple[Plane, Plane]]

#: The exponent of Kolmogorov's energy spectrum, k^-5/3.
KOLMOGOROV = 5.0 / 3.0
#: The wavelengths of the random field, in units of the shorter side.
LONGEST, SHORTEST = 1.0, 1.0 / 8.0
N_WAVES = 32
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, eq=False)
class Flow:
    """A velocity in pixels a frame; `fluid` tells where the fluid is, and is None where it is everywhere."""

    velocity: Velocity
    fluid: Callable[[Plane, Plane], NDArray[np.bool_]] | None = None

    def inside(self, x: Plane, y: Plane) -> NDArray[np.bool_]:
        """Tell which points are in the fluid."""
        return np.ones(np.shape(x), bool) if self.fluid is None else self.fluid(x, y)

    def trace(self, x: Plane, y: Plane) -> tuple[Plane, Plane]:
        """Return where particles at these points are one frame later; those in walls stay.

        Trajectories are integrated in float64 by Dormand and Prince's method of order 8, to 1e-5 pixels.
        """
        from scipy.integrate import solve_ivp

        carried = self.inside(x, y)
        start = np.stack((x[carried], y[carried]))

        def rate(_: float, moved: Plane) -> Plane:
            return np.ravel(self.velocity(*(start + moved.reshape(start.shape))))

        end = solve_ivp(rate, (0.0, 1.0), np.zeros(start.size), "DOP853", first_step=0.5, rtol=1e-8, atol=1e-8)
        x1, y1 = x.copy(), y.copy()
        x1[carried], y1[carried] = start + end.y[:, -1].reshape(start.shape)
        return x1, y1


def make_flow(
    name: str, shape: tuple[int, int], *, displacement: float, slope: float = KOLMOGOROV, seed: int = 0
) -> Flow:
    """Return a flow of `FLOWS` whose fastest pixel has the speed `displacement`, in pixels a frame."""
    flow = _random_field(shape, slope, seed) if name == "solenoidal" else FLOWS[name](shape)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    speed = np.hypot(*flow.velocity(x, y))
    factor = displacement / speed[flow.inside(x, y)].max()

    def velocity(x: Plane, y: Plane) -> tuple[Plane, Plane]:
        u, v = flow.velocity(x, y)
        return factor * u, factor * v

    return replace(flow, velocity=velocity)


def _centre(shape: tuple[int, int]) -> tuple[float, float]:
    return (shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0


def _vortex(shape: tuple[int, int], turning: Callable[[Plane, float], Plane]) -> Flow:
    """Return a vortex about the centre: ``turning(s, core)`` is its angular velocity at ``s = r^2``."""
    (cx, cy), core = _centre(shape), min(shape) / 8.0

    def velocity(x: Plane, y: Plane) -> tuple[Plane, Plane]:
        dx, dy = x - cx, y - cy
        rate = turning(dx * dx + dy * dy, core)
        return -rate * dy, rate * dx

    return Flow(velocity)


def _rankine(shape: tuple[int, int]) -> Flow:
    return _vortex(shape, lambda s, core: core**2 / np.maximum(s, core**2))


def _lamb_oseen(shape: tuple[int, int]) -> Flow:
    def turning(s: Plane, core: float) -> Plane:
        ratio = np.maximum(s / core**2, 1e-12)
        return -np.expm1(-ratio) / ratio

    return _vortex(shape, turning)


def _taylor_green(shape: tuple[int, int]) -> Flow:
    k = 4.0 * math.pi / min(shape)

    def velocity(x: Plane, y: Plane) -> tuple[Plane, Plane]:
        return np.sin(k * x) * np.cos(k * y), -np.cos(k * x) * np.sin(k * y)

    return Flow(velocity)


def _parallel(shape: tuple[int, int], profile: Callable[[Plane], Plane]) -> Flow:
    """Return a flow to the right with the speed ``profile(s)``, s the height below the centre, in sides."""
    cy, side = _centre(shape)[1], min(shape)
    return Flow(lambda x, y: (profile((y - cy) / side), np.zeros(np.shape(y))))


def _stagnation(shape: tuple[int, int]) -> Flow:
    cx, cy = _centre(shape)
    return Flow(lambda x, y: (x - cx, cy - y))


def _backstep(shape: tuple[int, int]) -> Flow:
    """Return a channel whose floor falls: a rounded step, and behind it a zone where the flow runs back.

    With the height ``h(x)`` of the channel and ``s = (floor(x) - y) / h`` the stream function is
    ``psi = -(3 s^2 - 2 s^3 - c(x) s^2 (1 - s)^2)``: all that flows in flows out, and the speed is 0 at the floor
    and at the ceiling. Where ``c > 3`` it is negative at the floor.
    """
    height, width = shape
    ceiling, drop, length = -0.5, 0.3 * height, 0.06 * width

    def floor(x: Plane) -> tuple[Plane, Plane]:
        """Return the height of the floor, and its derivative."""
        ramp = np.tanh((x - 0.25 * width) / length)
        return 0.65 * height + 0.5 * drop * (1.0 + ramp), 0.5 * drop * (1.0 - ramp**2) / length

    def backflow(x: Plane) -> tuple[Plane, Plane]:
        """Return c, and its derivative."""
        t = (x - 0.45 * width) / (0.15 * width)
        c = 6.0 * np.exp(-t * t)
        return c, -2.0 * t * c / (0.15 * width)

    def velocity(x: Plane, y: Plane) -> tuple[Plane, Plane]:
        (bottom, slant), (c, d_c) = floor(x), backflow(x)
        h = bottom - ceiling
        s = (bottom - y) / h
        d_psi = 6.0 * s * (1.0 - s) - 2.0 * c * s * (1.0 - s) * (1.0 - 2.0 * s)
        return d_psi / h, d_psi * slant * (1.0 - s) / h - d_c * (s * (1.0 - s)) ** 2

    return Flow(velocity, lambda x, y: (y < floor(x)[0]) & (y > ceiling))


def _random_field(shape: tuple[int, int], slope: float = KOLMOGOROV, seed: int = 0) -> Flow:
    """Return a sum of waves, each perpendicular to its wave vector k, of the energy spectrum ``|k|^-slope``.

    Wavelengths are spread over the logarithm of their range and directions over the half circle, at random
    within equal parts.
    """
    rng = np.random.default_rng([seed, list(FLOWS).index("solenoidal"), 0])
    octaves = (np.arange(N_WAVES) + rng.random(N_WAVES)) / N_WAVES
    wavelength = min(shape) * SHORTEST * (LONGEST / SHORTEST) ** octaves
    angle = math.pi * rng.random() + _GOLDEN_ANGLE * np.arange(N_WAVES)
    phase = 2.0 * math.pi * rng.random(N_WAVES)
    k = 2.0 * math.pi / wavelength
    amplitude = k ** ((1.0 - slope) / 2.0)  # a part of the logarithm holds the energy k^-slope dk
    across, down = np.cos(angle), np.sin(angle)

    def velocity(x: Plane, y: Plane) -> tuple[Plane, Plane]:
        u, v = np.zeros(np.shape(x)), np.zeros(np.shape(x))
        for a, kx, ky, shift, nx, ny in zip(amplitude, k * across, k * down, phase, down, across, strict=True):
            wave = a * np.cos(kx * x + ky * y + shift)
            u += nx * wave
            v -= ny * wave
        return u, v

    return Flow(velocity)


#: The flows by name. The place of a flow is part of its random numbers: new ones come last.
FLOWS: dict[str, Callable[[tuple[int, int]], Flow]] = {
    "rankine": _rankine,
    "lamb_oseen": _lamb_oseen,
    "taylor_green": _taylor_green,
    "shear": lambda shape: _parallel(shape, lambda s: s),
    "mixing_layer": lambda shape: _parallel(shape, lambda s: np.tanh(s / 0.08)),
    "stagnation": _stagnation,
    "jet": lambda shape: _parallel(shape, lambda s: np.cosh(s / 0.1) ** -2),
    "solenoidal": _random_field,
    "backstep": _backstep,
}
