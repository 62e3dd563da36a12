"""The recipe in CONTRIBUTING for a dataset of one's own, word by word, as an installed package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from textwrap import dedent

import pandas as pd
import pytest

from fracbench.harness.config.paths import checkout

ROOT = checkout()
pytestmark = pytest.mark.skipif(ROOT is None, reason="CONTRIBUTING is part of a checkout")


def recipe() -> str:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return text[text.index("## Add a dataset") : text.index("## Add an experiment")]


def block(language: str) -> str:
    return dedent(re.search(rf" *```{language}\n(.*?) *```", recipe(), re.DOTALL)[1])


def test_the_recipe_gives_a_dataset_that_can_be_swept(tmp_path):
    site, work = tmp_path / "site", tmp_path / "work"
    info = site / "my_package-1.0.dist-info"
    info.mkdir(parents=True)
    work.mkdir()
    (site / "my_dataset.py").write_text(block("python"))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    group, line = re.search(r'entry-points\."(.+)"\]\n(.+)', block("toml")).groups()
    (info / "entry_points.txt").write_text(f"[{group}]\n{line.replace(chr(34), '')}\n")
    command = re.search(r"`python -m (fracbench sweep [^`]+)`", recipe())[1].split()
    small = ["n_scales=1", "n_warps=1", "max_iter=2", "--jobs", "2"]
    done = subprocess.run(
        [sys.executable, "-m", *command, *small],
        cwd=work,
        env={**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(next((work / "results/sweeps").glob("*.csv")))
    assert table["sequence"].tolist() == ["right", "right", "down", "down"]
    assert set(table["status"]) == {"done"} and set(table["dataset"]) == {"shifts"}
    listed = subprocess.run(
        [sys.executable, "-m", "fracbench", "data", "dataset=shifts"],
        cwd=work,
        env={**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
    )
    assert listed.stdout == "shifts: no files: 2 pairs: right, down\n"
