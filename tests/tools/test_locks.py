"""The locks agree with pyproject.toml, constraints.txt, the licences and the Pythons that are tested."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import licenses
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(licenses.__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def pinned(path: Path) -> dict[str, str]:
    """Name and version of each line NAME==VERSION, with or without a marker."""
    found = re.findall(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {canonicalize_name(name): version for name, version in found}


@pytest.mark.parametrize("extra", ["dev", "docs", "tools"])
def test_a_lock_holds_all_requirements_with_their_hashes(extra):
    path = ROOT / "locks" / f"{extra}.txt"
    pins, text = pinned(path), path.read_text(encoding="utf-8")
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras[extra], *(extras["dev"] if extra == "tools" else [])]
    for requirement in (Requirement(line) for line in wanted if not line.startswith("fracbench")):
        version = pins.get(canonicalize_name(requirement.name))
        assert version and requirement.specifier.contains(version), f"{requirement}: run `make locks`"
    blocks = re.split(r"\n(?=[A-Za-z0-9])", text)[1:]
    assert len(blocks) == len(pins) and all("--hash=sha256:" in block for block in blocks)
    assert "://" not in text  # no host of a registry


@pytest.mark.parametrize("extra", ["dev", "docs", "tools"])
def test_the_locks_are_made_from_the_constraints(extra):
    known = pinned(ROOT / "constraints.txt")
    for name, version in pinned(ROOT / "locks" / f"{extra}.txt").items():
        assert known.get(name, version) == version, f"{name}: run `make locks`"


def test_the_licence_of_every_package_is_listed():
    text = (ROOT / "docs" / "licenses.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\S+) \| (\S+) \| (.+) \|$", text, re.MULTILINE)
    listed = {name: version for name, version, _ in rows if name not in ("package", "---")}
    assert listed == licenses.pins(), "run `python tools/licenses.py > docs/licenses.md`"
    assert not [licence for _, _, licence in rows if not licence.strip() or licence == "not stated"]
    copyleft = [name for name, _, licence in rows if re.search(r"\b(A?GPL|LGPL|GNU)", licence)]
    assert copyleft == []


def test_the_metadata_names_the_pythons_that_are_tested():
    (pythons,) = (
        ast.literal_eval(node.value)
        for node in ast.parse((ROOT / "noxfile.py").read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PYTHONS"
    )
    named = [name.rpartition(" :: ")[2] for name in PROJECT["classifiers"] if "Python :: 3." in name]
    assert list(pythons) == named and PROJECT["requires-python"] == f">={pythons[0]}"
