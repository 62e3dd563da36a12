"""Experiments: saved grids with the artefact they are drawn as, one YAML file each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.paths import asset
from fracbench.harness.config.records import mapping, read_yaml, require_name

_KEYS = ("title", "artefact", "grid", "grids", "options")
#: Name of the only grid of an experiment that has one.
MAIN = "main"


@dataclass(frozen=True)
class Experiment:
    """Grids of overrides by the part of the artefact that they feed, and the name of its renderer."""

    name: str
    title: str
    artefact: str
    grids: Mapping[str, tuple[str, ...]]
    options: Mapping[str, Any] = field(default_factory=dict)


def list_experiments() -> list[str]:
    """Return the names of the experiments there are: of the project, and of the working folder."""
    folders = {asset("experiments"), Path("experiments")}
    return sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})


def load_experiment(name: str) -> Experiment:
    """Read an experiment from ``experiments/`` of the working folder or of the project, checked."""
    if name not in (known := list_experiments()):
        raise unknown_name("experiment", name, known)
    require_name(name, "an experiment", "experiments")
    own = Path("experiments") / f"{name}.yaml"
    path = own if own.is_file() else asset(f"experiments/{name}.yaml")
    raw = mapping(read_yaml(path)[0], str(path), _KEYS)
    if ("grid" in raw) == ("grids" in raw):
        raise InputError(f"{path}: one of `grid` (overrides) and `grids` (overrides by name) is needed")
    grids, options = raw.get("grids", {MAIN: raw.get("grid")}), raw.get("options") or {}
    if not isinstance(grids, dict) or not all(map(_is_grid, grids.values())):
        raise InputError(f"{path}: a grid must be a list of overrides such as 'alpha=0:2:0.1'")
    for token in (token for tokens in grids.values() for token in tokens):
        if token.startswith(("paths.", "parallel")):
            raise InputError(f"{path}: {token!r}: where and how points are run is said on the command line")
    for key in ("title", "artefact"):
        if not isinstance(raw.get(key, ""), str):
            raise InputError(f"{path}: `{key}` must be a text")
    return Experiment(
        name,
        raw.get("title", name),
        raw.get("artefact", "sweep"),
        _tuples(grids),
        mapping(options, f"{path}: `options`"),
    )


def _is_grid(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(token, str) for token in value)


def _tuples(grids: Mapping[Any, list[str]]) -> dict[str, tuple[str, ...]]:
    return {str(name): tuple(tokens) for name, tokens in grids.items()}
