"""Compiled loops are kept on disk, but none outlives a change of what it calls."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba import config

import fracbench

#: `gauss_seidel_natural` calls `right_hand_side_row`, which stands in another file.
SWEEP = """
import numpy as np
from fracbench.model.sweeps import gauss_seidel_natural as sweep
u = np.zeros((1, 1))
sweep(u, np.ones((1, 1)), np.zeros((1, 2, 1, 1)), 0.5, 1.0)
print(u[0, 0], sum(sweep.stats.cache_hits.values()))
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_cached_loop_is_compiled_anew_where_a_called_one_has_changed(tmp_path):
    package = tmp_path / "fracbench"
    shutil.copytree(
        Path(fracbench.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__", "_assets")
    )

    def sweep() -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", SWEEP],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.split()

    assert sweep() == ["1.0", "0"]
    assert sweep() == ["1.0", "1"]
    called = package / "model" / "kernels" / "forward_rows.py"
    text = called.read_text(encoding="utf-8")
    assert text.count("direct * v[i, j]") == 1
    called.write_text(text.replace("direct * v[i, j]", "3.0 * direct * v[i, j]"), encoding="utf-8")
    assert sweep() == ["3.0", "0"]
