"""The preset `fluid`: on particle images, the public ones and rendered ones, for small and large motion."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench import estimate_flow
from fracbench.data.datasets.particles.images import particle_pair
from fracbench.data.datasets.registry import find_folder, list_sequences, load_sequence
from fracbench.errors import DataError

INNER = (slice(None), slice(16, -16), slice(16, -16))


def error(flow, truth):
    return float(np.nanmean(np.hypot(*(flow - truth)[INNER])))


def test_the_public_particle_images():
    try:
        folder = find_folder("piv")
    except DataError as exc:
        pytest.skip(str(exc))
    pairs = [load_sequence(name, "piv", folder) for name in list_sequences("piv", folder)]
    names = {"DNS_turbulence_00001", "JHTDB_isotropic1024_hd_00001", "SQG_00001", "backstep_Re800_00001"}
    if {pair.name for pair in pairs} != names:
        pytest.skip(f"{folder}: not the four pairs whose errors are documented")
    flows = [estimate_flow(pair.frame0, pair.frame1, protocol="fluid").flow for pair in pairs]
    errors = [error(flow, pair.truth) for flow, pair in zip(flows, pairs, strict=True)]
    assert np.mean(errors) == pytest.approx(0.0662, abs=0.001)


@pytest.mark.parametrize("piece", ["gain", "slope", "offset"])
def test_a_light_that_changes_between_the_frames_changes_the_flow_little(piece):
    """Without the normalisation, the errors are 40 px and more, or several times those under equal light."""
    pair = particle_pair("lamb_oseen", shape=(192, 256), displacement=4.0)
    y, x = np.mgrid[:192, :256] / 256.0
    light = {"gain": 1.3, "slope": 0.6 + 0.8 * x * y, "offset": 1.0}[piece]
    lit = light * pair.frame1 + (25.0 if piece == "offset" else 0.0)
    same, changed = (estimate_flow(pair.frame0, frame1, protocol="fluid").flow for frame1 in (pair.frame1, lit))
    plain = estimate_flow(pair.frame0, lit, protocol="fluid", normalisation=0).flow
    assert error(changed, pair.truth) < 1.3 * error(same, pair.truth) < 0.04
    assert error(plain, pair.truth) > 2.0 * error(changed, pair.truth)


@pytest.mark.parametrize(
    ("name", "displacement", "limit"),
    [
        ("jet", 1.0, 0.04),
        ("jet", 5.0, 0.06),
        ("jet", 12.0, 0.10),
        ("lamb_oseen", 1.0, 0.04),
        ("lamb_oseen", 5.0, 0.055),
        ("lamb_oseen", 12.0, 0.12),
    ],
)
def test_small_and_large_motion(name, displacement, limit):
    """Noise of 3 gray levels, 5 % lost pairs: a stated error in pixels, and at most 0.6 of that of order 1."""
    pair = particle_pair(name, shape=(128, 128), displacement=displacement, noise=3.0, lost=0.05)
    first = {f"alpha_{kind}": 1.0 for kind in ("flat", "edge", "corner", "texture")}
    errors = [
        error(estimate_flow(pair.frame0, pair.frame1, protocol="fluid", **orders).flow, pair.truth)
        for orders in ({}, first)
    ]
    assert errors[0] < limit
    assert errors[0] < 0.6 * errors[1]


def particles(x, y, brightness, size):
    """An image of Gaussian particles: a product of two matrices, since a Gaussian is one of its axes'."""
    along_x, along_y = (np.exp(-((np.arange(size) - np.reshape(p, (-1, 1))) ** 2) / 1.5) for p in (x, y))
    return (along_y.T * brightness) @ along_x


def test_a_vortex_of_12_pixels():
    rng, size, angle = np.random.default_rng(0), 160, 0.15
    x, y = rng.uniform(-40, size + 40, (2, 4000)) - size / 2
    brightness = rng.uniform(100, 230, x.size)
    cosine, sine = np.cos(angle), np.sin(angle)
    frame0 = particles(x + size / 2, y + size / 2, brightness, size)
    frame1 = particles(cosine * x - sine * y + size / 2, sine * x + cosine * y + size / 2, brightness, size)
    v, u = np.mgrid[:size, :size] - size / 2
    truth = np.stack([cosine * u - sine * v - u, sine * u + cosine * v - v])
    assert 12.0 < np.hypot(*truth[INNER]).max() < 14.0
    assert error(estimate_flow(frame0, frame1, protocol="fluid").flow, truth) < 0.1
