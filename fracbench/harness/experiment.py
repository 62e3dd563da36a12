"""Experiments: saved grids with the artefact they are drawn as, one YAML file each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fracbench.errors import InputError, unknown_name
from fracbench.harness.assets import asset

_KEYS = {"title", "artefact", "grid", "grids", "options"}
#: Name of the only grid of an experiment that has one.
MAIN = "main"


@dataclass(frozen=True)
class Experiment:
    """What to run and what to draw.

    Attributes
    ----------
    name : str
        The file's name.
    title : str
        Heading of the artefact.
    artefact : str
        Name of the renderer in `fracbench.report.artefacts`.
    grids : mapping of str to tuple of str
        Overrides in the grammar of the command line, by the part of the artefact that they feed.
    options : mapping
        What the renderer wants to know besides.
    """

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
    """Read an experiment.

    Parameters
    ----------
    name : str
        Name of a file in ``experiments/`` of the working folder or of the project.

    Returns
    -------
    Experiment
        Checked.

    Raises
    ------
    InputError
        No such file, not YAML, unknown or missing keys.
    """
    import yaml

    if name not in (known := list_experiments()):
        raise unknown_name("experiment", name, known)
    own = Path("experiments") / f"{name}.yaml"
    path = own if own.is_file() else asset(f"experiments/{name}.yaml")
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as exc:
        raise InputError(f"{path}: cannot be read as YAML: {' '.join(str(exc).split())}") from exc
    if not isinstance(raw, dict):
        raise InputError(f"{path}: must be a mapping with the keys {', '.join(sorted(_KEYS))}")
    for key in raw:
        if key not in _KEYS:
            raise unknown_name("key", str(key), _KEYS, str(path))
    if ("grid" in raw) == ("grids" in raw):
        raise InputError(f"{path}: one of `grid` (overrides) and `grids` (overrides by name) is needed")
    grids, options = raw.get("grids", {MAIN: raw.get("grid")}), raw.get("options") or {}
    if not isinstance(grids, dict) or not all(map(_is_grid, grids.values())):
        raise InputError(f"{path}: a grid must be a list of overrides such as 'alpha=0:2:0.1'")
    if not isinstance(options, dict):
        raise InputError(f"{path}: `options` must be a mapping")
    return Experiment(
        name, str(raw.get("title", name)), str(raw.get("artefact", "sweep")), _tuples(grids), options
    )


def _is_grid(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(token, str) for token in value)


def _tuples(grids: Mapping[Any, list[str]]) -> dict[str, tuple[str, ...]]:
    return {str(name): tuple(tokens) for name, tokens in grids.items()}
