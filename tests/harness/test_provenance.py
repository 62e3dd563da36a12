from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess

import numpy as np
import pytest

import fracbench
from fracbench.harness import provenance


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
    assert set(machine["versions"]) == {"fracbench", "numpy", "scipy", "numba"}
    assert machine["versions"]["numpy"] == np.__version__


def test_a_package_that_is_not_installed_is_no_error(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(provenance.importlib.metadata, "version", missing)
    assert set(provenance.versions().values()) == {"not installed"}


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


def test_the_installed_version_is_the_packages_own():
    found = provenance.versions()["fracbench"]
    assert found in (fracbench.__version__, "not installed")
