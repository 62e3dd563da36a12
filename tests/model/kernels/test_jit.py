"""Compiled loops are cached on disk, and compiled anew when a function that they call has changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest
from numba import config

import fracbench
from fracbench.model.kernels import jit as jit_module
from fracbench.model.kernels.cache_stamp import add_to_stamp

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


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_nothing_is_cached_where_numba_has_no_stamp(monkeypatch):
    assert not add_to_stamp(SimpleNamespace(), "digest")
    assert not add_to_stamp(SimpleNamespace(_cache=SimpleNamespace(_cache_file=SimpleNamespace())), "digest")

    def twice(x: float) -> float:
        return 2.0 * x

    assert jit_module.jit(twice).stats.cache_path is not None
    monkeypatch.setattr(jit_module, "_uncached", False)  # restored afterwards
    monkeypatch.setattr(jit_module, "add_to_stamp", lambda compiled, digest: False)
    plain = jit_module.jit(twice)
    assert plain.stats.cache_path is None
    assert plain(1.5) == 3.0
    assert jit_module.cache_folder() is None


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_numba_has_what_jit_needs_of_it():
    def twice(x: float) -> float:
        return 2.0 * x

    compiled = numba.njit(cache=True)(twice)
    assert add_to_stamp(compiled, "digest"), "numba renamed its stamp: caching is off until cache_stamp.py follows"
    assert compiled._cache._cache_file._source_stamp[1] == "digest"
    assert jit_module.cache_folder() is not None


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_loops_run_where_no_cache_can_be_written(tmp_path):
    (tmp_path / "__pycache__").write_text("a file", encoding="utf-8")  # beside the module...
    loop = "from fracbench.model.kernels.jit import jit\n@jit\ndef twice(x):\n    return 2.0 * x\n"
    loop += "again = jit(twice.py_func)\n"
    (tmp_path / "loop.py").write_text(loop, encoding="utf-8")
    below = str(tmp_path / "loop.py" / "cache")  # ...and below a file no folder can be made, not even by root
    homes = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME", "LOCALAPPDATA")
    done = subprocess.run(
        [sys.executable, "-B", "-c", "from loop import twice; print(twice(1.5), twice.stats.cache_path)"],
        env={
            **os.environ,
            **dict.fromkeys(homes, below),
            "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(fracbench.__file__).parent.parent)]),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["3.0", "None"]
    (warning,) = done.stderr.splitlines()
    assert "compiled anew in every process" in warning and "NUMBA_CACHE_DIR" in warning
