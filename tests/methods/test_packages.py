"""A method of another package, by its entry point, in every command: the example of docs/methods.md, installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from outside_package import SOURCE, write_package

import fracbench
from fracbench.commands.cli import EXIT_DONE, EXIT_FAILED
from fracbench.data.files import read_flow
from fracbench.harness.config.paths import checkout
from fracbench.harness.run.store import STORE, Store

GRID = ["method=my_flow,tvl1_sb", "strength=0.5:2:0.5", "sequence=synthetic_flat"]
ROOT = Path(fracbench.__file__).parents[1]


class Installed:
    """A package on ``PYTHONPATH``, and the command line in processes that see it."""

    def __init__(self, site: Path, *more: Path) -> None:
        path = os.pathsep.join(map(str, (ROOT, site, *more)))
        self.environment = {**os.environ, "PYTHONPATH": path}

    def __call__(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command in the working folder."""
        argv = [sys.executable, "-m", "fracbench", *words]
        return subprocess.run(argv, env=self.environment, capture_output=True, text=True, timeout=300, check=False)

    def cluster(self) -> subprocess.Popen[str]:
        """Start a Dask cluster whose workers see the package."""
        script = Path(__file__).parents[1] / "helpers" / "dask_cluster.py"
        pipe = subprocess.PIPE
        return subprocess.Popen([sys.executable, script], env=self.environment, stdin=pipe, stdout=pipe, text=True)


@pytest.fixture
def site(tmp_path) -> Path:
    """The example of docs/methods.md, as pip would install it."""
    root = checkout()
    if root is None:
        pytest.skip("the documents are those of a checkout")
    text = (root / "docs" / "methods.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (entries,) = re.findall(r'\[project.entry-points."fracbench.methods"\]\n(.*?)```', text, re.DOTALL)
    return write_package(tmp_path / "site", source, entries=entries.replace('"', ""))


def table() -> pd.DataFrame:
    (path,) = Path("results/sweeps").glob("*.csv")
    return pd.read_csv(path)


def rows() -> dict[str, list]:
    with Store(Path("results") / STORE, readonly=True) as store:
        found = {}
        for row in store.rows():
            found.setdefault(row.spec["method"], []).append(row)
    return found


def test_a_sweep_on_two_processes(work, site):
    run = Installed(site)
    done = run("sweep", *GRID, "--jobs", "2")
    assert done.returncode == EXIT_DONE, done.stderr
    assert "note: tvl1_sb does not know `strength`: one point stands for all its values\n" in done.stderr
    assert "5 points computed (5 new)" in done.stderr
    found = table()
    mine = found[found["method"] == "my_flow"]
    assert list(mine["strength"]) == [0.5, 1.0, 1.5, 2.0]
    assert mine["key"].nunique() == 4 and found[found["method"] == "tvl1_sb"]["key"].nunique() == 1
    assert (found["status"] == "done").all() and (mine["aepe"] < 1).all()
    for row in rows()["my_flow"]:
        assert row.spec["version"] == "my-package 1" and [*row.spec["params"]] == ["strength"]
        assert row.provenance["versions"]["my-package"] == "1.0"
    again = run("sweep", *GRID)
    assert "nothing to compute: all 5 points are in the store" in again.stderr


def test_a_new_version_makes_its_points_new_and_says_so(work, site):
    sweep = ["sweep", "method=my_flow", "strength=1", "sequence=synthetic_flat"]
    assert Installed(site)(*sweep).returncode == EXIT_DONE
    module = site / "my_package.py"
    module.write_text(module.read_text().replace('version="1"', 'version="2"'))
    done = Installed(site)(*sweep)
    assert "1 points computed (1 my_flow: my-package 1 -> my-package 2)" in done.stderr
    assert len(rows()["my_flow"]) == 2


def test_bench_estimate_run_and_experiment(images, site):
    run = Installed(site)
    done = run("bench", "sequence=synthetic_flat", "--only", "my_flow,tvl1_sb", "--repeats", "1")
    assert done.returncode == EXIT_DONE, done.stderr
    (path,) = Path("results/runs/bench").glob("*.csv")
    assert {"my_flow", "tvl1_sb"} <= set(pd.read_csv(path)["contender"])
    done = run("estimate", "a.png", "b.png", "-o", "out.flo", "--method", "my_flow", "strength=2")
    assert done.returncode == EXIT_DONE, done.stderr
    assert done.stdout.startswith("my_flow (its defaults with strength=2): ")
    flow = read_flow("out.flo")
    assert flow.shape == (2, 24, 32) and np.ptp(flow, axis=(1, 2)).max() == 0 and flow.any()
    done = run("run", "method=my_flow", "sequence=synthetic_flat", "strength=2")
    assert done.returncode == EXIT_DONE and len([*Path("results/runs/flows").glob("*my_flow*.flo")]) == 1
    Path("experiments").mkdir()
    grid = f"grid: {GRID}".replace("'", '"')
    Path("experiments/mine.yaml").write_text(f"title: mine\n{grid}\n")
    assert run("experiment", "mine").returncode == EXIT_DONE
    listed = run("methods").stdout
    assert "my_flow: My flow, one motion for the whole frame\n    from my-package 1.0, version 1\n" in listed


def test_a_protocol_of_ones_own_sets_its_parameters(images, site):
    Path("conf/protocol").mkdir(parents=True)
    protocol = "# @package _global_\nprotocol: strong\nmethod: my_flow\nparams: {strength: 4}\n"
    Path("conf/protocol/strong.yaml").write_text(protocol)
    run = Installed(site)
    assert run("sweep", "protocol=strong", "sequence=synthetic_flat").returncode == EXIT_DONE
    assert [row.spec["params"] for row in rows()["my_flow"]] == [{"strength": "4"}]
    done = run("estimate", "a.png", "b.png", "-o", "out.flo", "protocol=strong")
    assert done.stdout.startswith("my_flow (preset strong): ")
    assert run("sweep", "protocol=reference", "method=my_flow", "sequence=grove2", "--dry-run").stderr == ""


def test_a_method_that_fails_leaves_the_others_alone(work, tmp_path):
    bodies = {"still": "flow", "nan": "flow * np.nan", "flat": "flow[0]", "raise": "flow / missing"}
    methods = "".join(
        f"def {name}(frame0, frame1, params):\n    flow = np.zeros((2, *frame0.shape))\n    return {body}\n"
        f"{name.upper()} = Method('{name}_flow', 'l', 's', {name}, params=Params)\n"
        for name, body in bodies.items()
        if name != "raise"
    )
    methods += (
        "def fails(frame0, frame1, params):\n    raise OSError('no\\ndisk')\n"
        "RAISE = Method('raise_flow', 'l', 's', fails, params=Params)\n"
    )
    entries = "\n".join(f"{name}_flow = my_package:{name.upper()}" for name in bodies)
    write_package(tmp_path / "site", SOURCE + methods, entries=f"{entries}\ngone_flow = nothing_of_the_kind:X")
    run = Installed(tmp_path / "site")
    names = ",".join(f"{name}_flow" for name in bodies)
    done = run("sweep", f"method={names},tvl1", "sequence=synthetic_flat")
    assert done.returncode == EXIT_FAILED and "Traceback" not in done.stderr
    found = {method: (row.status, row.error) for method, (row,) in rows().items()}
    place = "entry point '{}_flow' of my-package 1.0: "
    assert found["tvl1"] == found["still_flow"] == ("done", None)
    assert found["nan_flow"] == (
        "failed",
        place.format("nan") + "40960 of 40960 values of its flow are NaN or infinite",
    )
    assert (
        found["flat_flow"][1] == place.format("flat") + "returned an array of shape (128, 160), not (2, 128, 160)"
    )
    assert found["raise_flow"][1].startswith(place.format("raise") + "raised OSError: no disk (my_package.py:")
    done = run("bench", "sequence=synthetic_flat", "--repeats", "1", "--only", f"{names},tvl1")
    assert done.returncode == EXIT_FAILED and "raise_flow is left out: " + place.format("raise") in done.stderr
    (path,) = Path("results/runs/bench").glob("*.csv")
    assert {"still_flow", "tvl1"} <= set(pd.read_csv(path)["contender"])


def test_a_dask_cluster(work, site):
    pytest.importorskip("distributed", reason="needs the extra `dask`")
    run = Installed(site)
    for installed in (True, False):
        cluster = (run if installed else Installed(work)).cluster()
        try:
            address = cluster.stdout.readline().split()[0]
            results = f"paths.results={'with' if installed else 'without'}"
            done = run("sweep", *GRID, results, "parallel=dask", f"parallel.address={address}")
        finally:
            cluster.kill()
            cluster.communicate(timeout=60)
        with Store(Path(results.partition("=")[2]) / STORE, readonly=True) as store:
            found = {row.key: row for row in store.rows() if row.spec["method"] == "my_flow"}
            others = [row.status for row in store.rows() if row.spec["method"] != "my_flow"]
        assert len(found) == 4 and others == ["done"]
        if installed:
            assert done.returncode == EXIT_DONE, done.stderr
            assert {row.status for row in found.values()} == {"done"}
        else:  # the package is missing on the workers
            assert done.returncode == EXIT_FAILED
            assert {row.status for row in found.values()} == {"failed"}
            assert all(row.error.startswith("unknown method 'my_flow'") for row in found.values())
