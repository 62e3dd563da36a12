"""OpenPIV as a method: its vectors, their axes and signs, and what it refuses."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from fracbench.data.datasets.particles.images import particle_pair
from fracbench.errors import InputError
from fracbench.methods.registry import get_method

INNER = (slice(None), slice(16, -16), slice(16, -16))
METHOD = get_method("openpiv")


@pytest.fixture
def windef():
    return pytest.importorskip("openpiv.windef", reason="needs the extra `piv`")


def test_dense_flow_passes_through_its_own_vectors(windef):
    pair = particle_pair("lamb_oseen", shape=(160, 192), displacement=3.0)
    x, y, u, v, _ = windef.simple_multipass(pair.frame0, pair.frame1, windef.PIVSettings(backend="scipy"))
    params = METHOD.replace(METHOD.start(), {"deformation": "symmetric"})  # the default of those settings
    flow = METHOD.compute(pair.frame0, pair.frame1, params).flow
    # OpenPIV's y is the distance from the lower edge, and its v points up.
    rows, cols = (pair.frame0.shape[0] - y).astype(int), x.astype(int)
    assert np.abs(flow[:, rows, cols] - (u, -v)).max() < 1e-6
    assert sorted(set(cols.ravel())) == list(range(8, 185, 8))


def test_axes_and_signs_are_those_of_all_flows(windef):
    pair = particle_pair("stagnation", shape=(160, 256), displacement=3.0)
    flow = METHOD.compute(pair.frame0, pair.frame1, METHOD.start()).flow
    assert np.abs(flow - pair.truth)[INNER].mean() < 0.05
    assert np.abs(pair.truth[INNER]).mean(axis=(1, 2)) == pytest.approx([1.2, 0.75], abs=0.2)


def test_the_displacement_of_the_particle_that_is_there_in_frame_0(windef):
    # Within the core the flow is a rotation, where both displacements differ by half the angle of a frame.
    pair = particle_pair("rankine", displacement=6.0)
    errors = [
        np.hypot(
            *(METHOD.compute(pair.frame0, pair.frame1, METHOD.replace(METHOD.start(), change)).flow - pair.truth)
        )
        for change in ({}, {"deformation": "symmetric"})
    ]
    core = np.hypot(*(np.mgrid[:256, :256] - 127.5)) < 20.0
    assert errors[0][core].mean() < 0.6 * errors[1][core].mean()


def test_it_refuses_small_frames_and_other_passes(windef):
    with pytest.raises(InputError, match="method 'openpiv' needs frames of at least 160 x 160, got 159 x 200"):
        METHOD.compute(np.zeros((159, 200)), np.zeros((159, 200)), METHOD.start())
    with pytest.raises(InputError, match=r"`passes` must be within 2\.\.3, got 4"):
        METHOD.replace(METHOD.start(), {"passes": 4})
    pair = particle_pair("shear", shape=(160, 161), displacement=2.0)
    assert np.isfinite(METHOD.compute(pair.frame0, pair.frame1, METHOD.start()).flow).all()


def test_without_openpiv_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"^method 'openpiv' needs openpiv: pip install 'fracbench\[piv\]'$"):
        METHOD.require()
    with pytest.raises(InputError, match=r"needs cv2: pip install 'fracbench\[peers\]'$"):
        get_method("opencv_dis").require()
