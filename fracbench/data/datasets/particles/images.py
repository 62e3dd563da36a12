"""Pairs of particle images: the dataset `particles`."""

from __future__ import annotations

import hashlib
import json
import math
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.datasets.base import Dataset
from fracbench.data.datasets.particles.flows import FLOWS, KOLMOGOROV, Flow, Plane, make_flow
from fracbench.data.pair import FramePair
from fracbench.errors import InputError, match_name, unknown_name

PARTICLES_VERSION = 1  # part of every digest: raise it whenever a rendered value may change
SHAPE = (256, 256)
#: Gray level at the centre of the brightest particle, if its image were not averaged over pixels.
PEAK = 200.0
#: Pixels around the frame that hold particles as well: more than move or shine into it.
AROUND = 40.0

#: The settings beside noise and seed: usual, smallest and largest value.
SETTINGS = {
    "density": (0.05, 0.001, 0.5),
    "diameter": (3.0, 0.5, 10.0),
    "lost": (0.0, 0.0, 0.9),
    "background": (0.0, 0.0, 255.0),
    "displacement": (5.0, 0.5, 12.0),
    "slope": (KOLMOGOROV, 0.0, 6.0),
}
_MIN_SIDE = 32
_REACH = 6.0  # standard deviations of a particle's image that are rendered: all but 2e-9 of its light


def particle_pair(
    name: str, *, shape: tuple[int, int] = SHAPE, noise: float = 0.0, seed: int = 0, **settings: float
) -> FramePair:
    """Render two images of particles in a flow, with the exact displacement.

    Particles are spread at random over the frame and over the depth of a sheet of light, which has a Gaussian
    profile. Each moves along its trajectory; its image is a Gaussian, integrated over each pixel. Background and
    noise are added last; nothing is clipped.

    Parameters
    ----------
    name : str
        One of `FLOWS`, without regard to case.
    shape : (int, int), optional
        Height and width; the flow's lengths grow with the shorter side.
    noise : float, optional
        Standard deviation, in gray levels, of Gaussian noise added to both frames.
    seed : int, optional
        Seed of the particles, the noise and, for ``solenoidal``, the flow.
    **settings : float
        ``density``, particles a pixel; ``diameter``, pixels between the points of an image at exp(-2) of its
        peak; ``lost``, share of particles that leave the sheet between the frames, replaced by others elsewhere;
        ``background``, gray levels by which the ground rises from left to right; ``displacement``, the largest
        speed, in pixels a frame; ``slope``, for ``solenoidal``: the energy spectrum is ``k^-slope``.

    Returns
    -------
    FramePair
        The truth at a pixel is the displacement of the particle that is at its centre in frame 0; NaN in walls.
    """
    name, shape, values = _validated(name, shape, {"noise": noise, "seed": seed, **settings})
    flow = _flow(name, shape, values)
    frames = [
        render(*spots, values["diameter"], shape) + np.linspace(0.0, values["background"], shape[1])
        for spots in _spots(name, shape, values, flow)
    ]
    if noise > 0:
        rng = _random(name, values, 3)
        frames = [frame + rng.normal(0.0, noise, shape) for frame in frames]
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    x1, y1 = flow.trace(x, y)
    truth = np.where(flow.inside(x, y), (x1 - x, y1 - y), np.nan)
    return FramePair(
        name=name,
        dataset="particles",
        frame0=frames[0],
        frame1=frames[1],
        truth=truth.astype(np.float32),
        digest=_digest(name, shape, values),
    )


def digest(
    name: str, *, shape: tuple[int, int] = SHAPE, noise: float = 0.0, seed: int = 0, **settings: float
) -> str:
    """Return the digest of `particle_pair` with the same arguments."""
    return _digest(*_validated(name, shape, {"noise": noise, "seed": seed, **settings}))


def render(x: Plane, y: Plane, light: Plane, diameter: float, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the sum of Gaussian spots, each averaged over every pixel; `light` is the integral of a spot."""
    from scipy.sparse import csr_array
    from scipy.special import ndtr

    reach = math.ceil(_REACH * diameter / 4.0) + 1

    def spread(centre: Plane, n: int, light: Any = 1.0) -> Any:
        """Return the light of each spot that falls into each row or column."""
        first = np.floor(centre + 0.5).astype(int)[:, None] + np.arange(-reach, reach + 1)
        cell, edges = first + 2 * reach, np.concatenate((first, first[:, -1:] + 1), axis=1) - 0.5
        share = np.diff(ndtr((edges - centre[:, None]) / (diameter / 4.0)), axis=1)
        share *= np.reshape(light, (-1, 1))
        starts = np.arange(0, share.size + 1, share.shape[1])
        return csr_array((share.ravel(), cell.ravel(), starts), shape=(len(centre), n + 4 * reach))

    near = (np.abs(x - (shape[1] - 1) / 2.0) < shape[1] / 2.0 + reach - 1) & (
        np.abs(y - (shape[0] - 1) / 2.0) < shape[0] / 2.0 + reach - 1
    )
    x, y, light = x[near], y[near], light[near]
    # A sparse product adds in a fixed order: the image does not depend on the number of threads.
    image = (spread(y, shape[0]).T @ spread(x, shape[1], light)).toarray()
    return image[2 * reach : -2 * reach, 2 * reach : -2 * reach]


def _spots(
    name: str, shape: tuple[int, int], values: dict[str, float], flow: Flow
) -> tuple[tuple[Plane, Plane, Plane], ...]:
    """Return the places and the light of the particles in each frame."""
    n = round(values["density"] * (shape[0] + 2 * AROUND) * (shape[1] + 2 * AROUND))

    def scatter(dice: NDArray[np.float64]) -> tuple[Plane, Plane, Plane]:
        x, y = (dice[:, i] * (shape[1 - i] + 2 * AROUND) - AROUND - 0.5 for i in range(2))
        peak = PEAK * np.exp(-8.0 * (dice[:, 2] - 0.5) ** 2)
        return x, y, peak * 2.0 * math.pi * (values["diameter"] / 4.0) ** 2

    x, y, light = scatter(_random(name, values, 1).random((n, 3)))
    dice = _random(name, values, 2).random((n, 4))
    lost = dice[:, 3] < values["lost"]
    first, moved, new = flow.inside(x, y), flow.trace(x, y), scatter(dice)
    kept, entered = first & ~lost, lost & flow.inside(*new[:2])
    later = [np.concatenate((a[kept], b[entered])) for a, b in zip((*moved, light), new, strict=True)]
    return (x[first], y[first], light[first]), (later[0], later[1], later[2])


def _flow(name: str, shape: tuple[int, int], values: dict[str, float]) -> Flow:
    return make_flow(
        name, shape, displacement=values["displacement"], slope=values["slope"], seed=int(values["seed"])
    )


def _random(name: str, values: dict[str, float], stream: int) -> np.random.Generator:
    return np.random.default_rng([int(values["seed"]), list(FLOWS).index(name), stream])


def _digest(name: str, shape: tuple[int, int], values: dict[str, float]) -> str:
    what = {"flow": name, "version": PARTICLES_VERSION, "shape": shape, **values}
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def _validated(
    name: str, shape: tuple[int, int], given: dict[str, Any]
) -> tuple[str, tuple[int, int], dict[str, float]]:
    """Return the exact name, the shape, and all settings, those left out with their usual values."""
    name = match_name(name, FLOWS, "particles sequence")
    for key in given:
        if key not in (known := ("noise", "seed", *SETTINGS)):
            raise unknown_name("setting", key, known, f"particles {name}")
    if "slope" in given and name != "solenoidal":
        raise InputError(f"particles {name}: `slope` is of sequence=solenoidal alone")
    try:
        height, width = (operator.index(n) for n in shape)
        values = {key: usual for key, (usual, _, _) in SETTINGS.items()}
        values |= {key: float(value) for key, value in given.items()}
        values["seed"] = operator.index(given["seed"])
    except (TypeError, ValueError) as exc:
        raise InputError(
            f"particles {name}: `shape` must be two integers, `seed` an integer and all others numbers, got "
            f"{shape!r}, {given!r}"
        ) from exc
    if min(height, width) < _MIN_SIDE:
        raise InputError(f"particles {name}: `shape` must be at least {_MIN_SIDE} a side, got {height} x {width}")
    for key in ("noise", "seed"):
        if not 0.0 <= values[key] < math.inf:
            raise InputError(f"particles {name}: `{key}` must be finite and not negative, got {values[key]:g}")
    for key, (_, least, most) in SETTINGS.items():
        if not least <= values[key] <= most:
            raise InputError(f"particles {name}: `{key}` must be within {least:g}..{most:g}, got {values[key]:g}")
    return name, (height, width), values


DATASET = Dataset(
    name="particles",
    summary=f"rendered particle images of {len(FLOWS)} flows with exact displacement",
    names=lambda folder: tuple(FLOWS),
    shape=lambda name, folder: SHAPE,
    load=lambda name, folder, **settings: particle_pair(name, **settings),
    digest=lambda name, folder, **settings: digest(name, **settings),
    outliers=False,  # of driving scenes
    settings={"noise": 0.0, "seed": 0, **{key: usual for key, (usual, _, _) in SETTINGS.items()}},
)
