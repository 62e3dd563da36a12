from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fracbench
from fracbench.harness.run import plan, point, provenance, sweep
from fracbench.harness.run.compute_point import run_point
from fracbench.harness.run.store import Store
from fracbench.model import SOLVER_VERSION


@pytest.fixture(autouse=True)
def anew():
    for function in (provenance.commit, provenance.machine):
        function.cache_clear()
    yield
    for function in (provenance.commit, provenance.machine):
        function.cache_clear()


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository with one commit, in the place of the checkout."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    monkeypatch.setattr(provenance, "checkout", lambda: tmp_path)
    (tmp_path / "file").write_text("one")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", "file")
    git(tmp_path, "-c", "user.name=n", "-c", "user.email=e@x", "commit", "--quiet", "-m", "m")
    return tmp_path


def git(folder, *arguments):
    done = subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def test_the_machine_and_its_versions_are_told():
    machine = provenance.machine()
    assert machine["host"] == platform.node()
    assert machine["cores"] == os.cpu_count()
    assert machine["python"] == platform.python_version()
    assert machine["cpu"]
    assert {"fracbench", "numpy", "scipy", "numba"} <= set(machine["versions"])
    assert machine["versions"]["fracbench"] == fracbench.__version__
    assert machine["versions"]["numpy"] == np.__version__


def test_packages_that_are_not_installed_are_no_error(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(provenance.importlib.metadata, "version", missing)
    missing_ones = dict.fromkeys(("numpy", "scipy", "numba"), "not installed")
    assert provenance.versions() == {"fracbench": fracbench.__version__, **missing_ones}


def test_a_peer_that_is_installed_is_told(monkeypatch):
    monkeypatch.setattr(provenance.importlib.metadata, "version", lambda name: f"version of {name}")
    assert provenance.versions()["scikit-image"] == "version of scikit-image"


def test_the_commit_and_changes_of_tracked_files_are_told(repository):
    head = git(repository, "rev-parse", "HEAD")
    assert provenance.commit() == {"commit": head, "dirty": False}
    (repository / "untracked").touch()
    provenance.commit.cache_clear()
    assert provenance.commit() == {"commit": head, "dirty": False}
    (repository / "file").write_text("two")
    provenance.commit.cache_clear()
    assert provenance.commit() == {"commit": head, "dirty": True}


def test_outside_a_repository_there_is_no_commit(tmp_path, monkeypatch):
    unknown = {"commit": None, "dirty": None}
    monkeypatch.setattr(provenance, "checkout", lambda: None)
    assert provenance.commit() == unknown
    provenance.commit.cache_clear()
    monkeypatch.setattr(provenance, "checkout", lambda: tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.commit() == unknown
    provenance.commit.cache_clear()
    monkeypatch.setenv("PATH", "")
    assert provenance.commit() == unknown


def test_every_row_carries_where_it_comes_from(cli, work, tiny):
    assert cli("sweep", *tiny, "alpha=0.5,1", "method=tvl1_sb_alpha").code == 0
    with Store(work / "results" / "runs" / "store.sqlite", readonly=True) as store:
        rows = store.rows()
    assert len(rows) == 2
    for row in rows:
        origin = row.provenance
        assert origin["host"] == platform.node() and origin["cpu"] and origin["cores"] == os.cpu_count()
        assert origin["versions"] == provenance.versions() and origin["python"] == platform.python_version()
        assert origin["threads"] == 1
        assert (origin["commit"], origin["dirty"]) == tuple(provenance.commit().values())
        assert len(origin["data"]) == 64 and row.solver_version == SOLVER_VERSION and row.created


def test_a_point_that_fails_tells_where_as_well(tiny):
    (planned,) = plan.make_plan([*tiny, "method=tvl1"]).points
    outcome = run_point(replace(planned.point, data_digest="of other data"), None)
    assert (outcome.status, outcome.machine) == ("failed", provenance.machine())


def test_why_a_point_is_run_again_is_said(cli, work, tiny, monkeypatch):
    first = cli("sweep", *tiny, "alpha=0.5,1", "method=tvl1_sb_alpha")
    assert "2 points computed (2 new), 0 taken from the store\n" in first.err
    more = cli("sweep", *tiny, "alpha=0.5,1,1.5", "method=tvl1_sb_alpha")
    assert "1 points computed (1 new), 2 taken from the store\n" in more.err
    for module in (point, sweep):
        monkeypatch.setattr(module, "SOLVER_VERSION", 99)
    again = cli("sweep", *tiny, "alpha=0.5,1", "method=tvl1_sb_alpha")
    assert f"2 points computed (2 solver version {SOLVER_VERSION} -> 99)" in again.err


@pytest.mark.skipif(not Path("/proc/cpuinfo").is_file(), reason="this system has no /proc")
def test_the_processor_is_called_as_the_system_calls_it():
    named = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    wanted = named[0].split(":", 1)[1].strip() if named else platform.processor() or platform.machine()
    assert provenance.machine()["cpu"] == wanted
