"""Without numba's extension interface SciPy's transforms and dense products give the same flows."""

from __future__ import annotations

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
