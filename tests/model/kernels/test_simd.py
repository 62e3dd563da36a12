"""Without compilation squares are copied alike; without numba's extension interface flows are the same."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest
from numba import config

from fracbench import estimate_flow
from fracbench.data.datasets.synthetic.scenes import scene
from fracbench.model.kernels import simd

RUNS = (
    {"method": "tvl1_sb", "u_solver": "exact", "inner": "warm", "max_iter": 6},
    {"method": "tvl1_sb_alpha", "alpha": 1.2, "boundary": "zero"},
    {"method": "tvl1_sb_alpha", "alpha": 1.2, "boundary": "reflect"},
    {"method": "tvl1_sb_alpha_map", "boundary": "reflect"},
)
#: The extension is one module; None in its place makes its import fail.
WITHOUT = f"""
import sys
sys.modules["fracbench.model.kernels.vector_type"] = None
import numpy as np
from fracbench import estimate_flow
from fracbench.data.datasets.synthetic.scenes import scene
from fracbench.model.kernels import simd
assert not simd.AVAILABLE
pair = scene("parallax", shape=(72, 80))
flows = [estimate_flow(pair.frame0, pair.frame1, n_warps=2, **run).flow for run in {RUNS!r}]
np.save(sys.argv[1], flows)
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_flows_are_the_same_without_the_vector_type(tmp_path):
    assert simd.AVAILABLE
    out = tmp_path / "flows.npy"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}  # the loops are others
    subprocess.run([sys.executable, "-c", WITHOUT, str(out)], check=True, env=environment)
    pair = scene("parallax", shape=(72, 80))
    for run, plain in zip(RUNS, np.load(out), strict=True):
        flow = estimate_flow(pair.frame0, pair.frame1, n_warps=2, **run).flow
        assert float(np.abs(flow - plain).max()) < 1e-4, run


def test_squares_are_copied_and_brought_back_where_nothing_is_compiled(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", True)
    spec = importlib.util.spec_from_file_location("plain_simd", simd.__file__)
    plain = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(plain)
    rng = np.random.default_rng(3)
    image, rows = rng.normal(size=(19, 24)), rng.permutation(24)
    for part in (0, 1):
        work, back = np.zeros((48, 8)), np.zeros((19, 24))
        plain.gather_square(image, 5, 8, rows, work, part)
        assert np.count_nonzero(work) == 64
        for j in range(8, 16):
            np.testing.assert_array_equal(work[2 * rows[j] + part], image[5:13, j])
        plain.scatter_square(work, rows, part, back, 5, 8)
        np.testing.assert_array_equal(back[5:13, 8:16], image[5:13, 8:16])
        assert np.count_nonzero(back) == 64
