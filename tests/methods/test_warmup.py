"""After a warm-up nothing is left to compile, and a second process compiles a part of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba import config

from fracbench.methods.warmup import on_compilation, variant, warm_up
from fracbench.model.params import FlowParams

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")

#: Warms up and prints the loops compiled so far, those that a flow compiles then, and those of the second process.
FLOWS = """
import json, sys
import numpy as np
from fracbench.methods.registry import get_method
from fracbench.methods.warmup import on_compilation, warm_up
from fracbench.model.kernels.cosine import _synthesise
from fracbench.model.kernels.line_elimination import solve_lines
from fracbench.model.operators.zero import _solve_small
from fracbench.model.params import FlowParams
method, loops = get_method("tvl1_sb_alpha"), []
frames = np.random.default_rng(1).uniform(0, 255, (2, 90, 100)).astype(np.float32)
for values in json.loads(sys.argv[1]):
    params = FlowParams().replace(values)
    warm_up(method, params, lambda: loops.append("before"), alone=True)
    with on_compilation(lambda: loops.append("after")):
        method.estimate(*frames, params)
missed = [sum(loop.stats.cache_misses.values()) for loop in (_synthesise, solve_lines, _solve_small)]
print(loops.count("before"), loops.count("after"), sum(missed))
"""


def run(folder: Path, *words: str) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


def test_after_a_warm_up_a_flow_compiles_nothing(tmp_path):
    settings = [{"boundary": "reflect", "n_warps": 1}, {"boundary": "zero", "alpha": 1.2, "n_warps": 1}]
    for values in settings:
        params = FlowParams().replace(values)
        run(tmp_path, "-m", "fracbench.methods.warmup", "tvl1_sb_alpha", json.dumps(params.as_dict()))
    before, after, misses = map(int, run(tmp_path, "-c", FLOWS, json.dumps(settings)).split())
    assert before > 10 and after == 0
    assert misses == 0  # the second process left it in the cache


def test_a_second_process_helps_once_and_is_ended(monkeypatch):
    import fracbench.methods.warmup as module

    started: list[list[str]] = []
    ended: list[str] = []

    class Helper:
        def __init__(self, words, **_):
            started.append(words)

        def kill(self):
            ended.append("killed")

        def wait(self):
            ended.append("waited for")

    class Once:
        name, options = "tvl1_sb", frozenset()

        def compute(self, frame0, frame1, params):
            for function in (lambda x: x + 1, lambda x: x + 2):
                numba.njit(function)(1.0)

    monkeypatch.setattr(module.subprocess, "Popen", Helper)
    monkeypatch.setattr(config, "NUMBA_DEFAULT_NUM_THREADS", 2)
    loops: list[int] = []
    warm_up(Once(), FlowParams(), lambda: loops.append(1))
    assert len(loops) == 2 and len(started) == 1 and ended == ["killed", "waited for"]
    assert started[0][1:4] == ["-m", "fracbench.methods.warmup", "tvl1_sb"]
    assert FlowParams().replace(json.loads(started[0][4])) == FlowParams()
    warm_up(Once(), FlowParams(), alone=True)
    monkeypatch.setattr(config, "NUMBA_DEFAULT_NUM_THREADS", 1)
    warm_up(Once(), FlowParams())
    assert len(started) == 1


def test_compilation_is_seen_only_within():
    seen: list[int] = []
    with on_compilation(lambda: seen.append(1)):
        numba.njit(lambda x: x + 3)(1.0)
    numba.njit(lambda x: x + 4)(1.0)
    assert seen == [1]


def test_a_variant_tells_what_is_off():
    same = [variant("tvl1", FlowParams(lambda_=value)) for value in (0.1, 0.2)]
    assert same[0] == same[1] != variant("tvl1_sb", FlowParams())
    assert variant("tvl1", FlowParams(presmoothing=0.0)) != same[0]
