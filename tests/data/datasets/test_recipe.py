"""The recipe in CONTRIBUTING for a dataset of one's own, word by word, as an installed package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pandas as pd
import pytest

from fracbench.harness.config.paths import checkout

ROOT = checkout()
pytestmark = pytest.mark.skipif(ROOT is None, reason="CONTRIBUTING is part of a checkout")
SMALL = ["n_scales=1", "n_warps=1", "max_iter=2"]


def recipe() -> str:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return text[text.index("## Add a dataset") : text.index("## Add an experiment")]


def block(language: str) -> str:
    return dedent(re.search(rf" *```{language}\n(.*?) *```", recipe(), re.DOTALL)[1])


@pytest.fixture
def environment(tmp_path, work) -> dict[str, str]:
    """Install the recipe's package; return the environment of processes that see it."""
    site = tmp_path / "site"
    info = site / "my_package-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "my_dataset.py").write_text(block("python"))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    group, line = re.search(r'entry-points\."(.+)"\]\n(.+)', block("toml")).groups()
    (info / "entry_points.txt").write_text(f"[{group}]\n{line.replace(chr(34), '')}\n")
    return {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}


def run(environment: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    argv = [sys.executable, "-m", "fracbench", *words]
    return subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=300, check=False)


def sweep(environment: dict[str, str], *words: str) -> None:
    """Run the recipe's sweep, and check its table."""
    command = re.search(r"`python -m fracbench (sweep [^`]+)`", recipe())[1].split()
    done = run(environment, *command, *SMALL, *words)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(next(Path("results/sweeps").glob("*.csv")))
    assert table["sequence"].tolist() == ["right", "right", "down", "down"]
    assert set(table["status"]) == {"done"} and set(table["dataset"]) == {"shifts"}


def test_the_recipe_gives_a_dataset_that_can_be_swept(environment):
    sweep(environment, "--jobs", "2")
    assert run(environment, "data", "dataset=shifts").stdout == "shifts: no files: 2 pairs: right, down\n"
    done = run(environment, "bench", "dataset=shifts", "--only", "tvl1_sb_alpha_ic", "--repeats", "1")
    assert done.returncode == 0 and "mean over 2 sequences, 1 thread(s), shifts" in done.stdout


def test_the_recipe_gives_a_dataset_for_a_cluster(environment):
    pytest.importorskip("distributed", reason="needs the extra `dask`")
    script, pipe = ROOT / "tests" / "helpers" / "dask_cluster.py", subprocess.PIPE
    cluster = subprocess.Popen([sys.executable, script], env=environment, stdin=pipe, stdout=pipe, text=True)
    try:
        address = cluster.stdout.readline().split()[0]
        sweep(environment, "parallel=dask", f"parallel.address={address}")
    finally:
        cluster.kill()
        cluster.communicate(timeout=60)
