"""From overrides to points: what is to be computed, and how it is labelled."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from fracbench.data.datasets.registry import get_dataset, list_sequences, shape_of
from fracbench.data.regions import Region, shifted
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.compose import GROUPS, PARALLEL, RunConfig, group_options, known_keys, load_config
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.grid import Axis, Grid, expand_names, parse_overrides
from fracbench.harness.config.numbers import MAX_POINTS
from fracbench.harness.run.point import Point, canonical_value

#: The artefacts that show measures, and the functions that plan these: ``"module:function"``, called as
#: ``function(experiment, plan)``, which return planned points.
_MEASURED = {
    "adaptive_alpha": "fracbench.studies.alpha_map.artefact:oracle_points",
    "confidence": "fracbench.studies.confidence:confidence_points",
    "convergence": "fracbench.studies.solvers.convergence_study:convergence_points",
    "solver_study": "fracbench.studies.solvers.solver_study:spectrum_points",
}
#: Keys that cannot be swept.
_FOR_ALL = ("dataset", "paths.data", "paths.results", "parallel", *PARALLEL)


@dataclass(frozen=True)
class PlannedPoint:
    """A point and the names it goes by in tables: protocol and region are labels, not part of the key."""

    point: Point
    labels: Mapping[str, str]


@dataclass(frozen=True)
class Plan:
    """Points in the order of the grid, and what holds for all of them.

    Distinct labels may share a point, which is computed once. `config` is that of the first point; `folder` is
    where the Middlebury data are; `stand_in` tells whether synthetic scenes take the place of Middlebury
    sequences, `small` whether the grid was thinned.
    """

    points: tuple[PlannedPoint, ...]
    varying: tuple[str, ...]
    dataset: str
    folder: Path | None
    config: RunConfig
    notices: tuple[str, ...] = field(default=())
    stand_in: bool = False
    small: bool = False

    def unique(self) -> dict[str, Point]:
        """Return the distinct points by key, in order."""
        return {planned.point.key: planned.point for planned in self.points}


def make_plan(tokens: Sequence[str], *, allow_download: bool = True, small: bool = False) -> Plan:
    """Expand overrides (see `fracbench.harness.config.grid`) to points; `small` thins the grid."""
    grid = _expand_globs(parse_overrides(tokens))
    if small:
        grid = grid.thinned()
    if grid.size > MAX_POINTS:
        raise InputError(f"{' '.join(tokens)}: {grid.size} points are more than the limit of {MAX_POINTS}")
    _check_keys(grid)
    configs = [_configure(values) for values in grid.points()]
    for method in {config.method.name: config.method for config in configs}.values():
        method.require()
    wanting = next((config for config in configs if config.sequence.dataset == "middlebury"), None)
    resolved = _resolve_data(wanting or configs[0], allow_download)
    points = [_planned(config, resolved.dataset, resolved.folder) for config in configs]
    notices = [resolved.notice] if resolved.notice else []
    notices += _idle_keys([key for axis in grid.axes for key in axis.keys], points)
    stand_in = wanting is not None and resolved.dataset == "synthetic"
    return Plan(
        points=tuple(points),
        varying=grid.varying,
        dataset=resolved.dataset,
        folder=resolved.folder,
        config=configs[0],
        notices=tuple(notices),
        stand_in=stand_in,
        small=small,
    )


def plan_experiment(
    grids: Mapping[str, Sequence[str]],
    settings: Sequence[str] = (),
    *,
    allow_download: bool = True,
    small: bool = False,
) -> Plan:
    """Expand grids to one plan, with `settings` added to each; the label ``part`` names the grid of a point.

    Without any grid the plan has no points, only the data set: for artefacts that show data or parameters.
    """
    if not grids:
        return replace(make_plan(settings, allow_download=allow_download, small=small), points=(), varying=())
    plans = {
        part: make_plan((*tokens, *settings), allow_download=allow_download, small=small)
        for part, tokens in grids.items()
    }
    points = tuple(
        replace(planned, labels={"part": part, **planned.labels})
        for part, plan in plans.items()
        for planned in plan.points
    )
    first = next(iter(plans.values()))
    real = next((plan for plan in plans.values() if plan.dataset == "middlebury"), first)
    varying = tuple(dict.fromkeys(key for plan in plans.values() for key in plan.varying))
    notices = tuple(dict.fromkeys(notice for plan in plans.values() for notice in plan.notices))
    return replace(
        first,
        points=points,
        varying=varying,
        notices=notices,
        dataset=real.dataset,
        folder=real.folder,
        stand_in=any(plan.stand_in for plan in plans.values()),
    )


def plan_artefact(
    experiment: Experiment, settings: Sequence[str] = (), *, allow_download: bool = True, small: bool = False
) -> Plan:
    """Plan all that the artefact of an experiment needs: the points of its grids, and its measures."""
    plan = plan_experiment(experiment.grids, settings, allow_download=allow_download, small=small)
    if experiment.artefact not in _MEASURED:
        return plan
    measured = pkgutil.resolve_name(_MEASURED[experiment.artefact])
    return replace(plan, points=(*plan.points, *measured(experiment, plan)))


def _expand_globs(grid: Grid) -> Grid:
    def expand(axis: Axis) -> Axis:
        key = axis.keys[0]
        if len(axis.keys) > 1 or key not in ("region", "sequence", "method", "protocol"):
            return axis
        names = [value[0] for value in axis.values]
        if key == "region" and names == ["none"]:
            return axis
        options = group_options(key)
        if key == "sequence":
            # `all` means the sequences of the paper, in its order; the scenes have to be named.
            paper = [name.lower() for name in list_sequences("middlebury")]
            options = paper if names == ["all"] else paper + [name for name in options if name not in paper]
        return Axis(axis.keys, tuple((name,) for name in expand_names(names, options, key)))

    return replace(grid, axes=tuple(expand(axis) for axis in grid.axes))


def _check_keys(grid: Grid) -> None:
    allowed = known_keys()
    keys = [key for axis in grid.axes for key in axis.keys]
    for key in keys:
        name = key.removeprefix("params.")
        if name not in allowed:
            raise unknown_name("key", key, allowed)
        if name != key and name in keys:
            raise InputError(f"{name!r} and {key!r} are the same key, given twice")
    for key in grid.varying:
        if key in _FOR_ALL:
            raise InputError(f"{key!r} takes one value, which holds for all points")


def _configure(values: Mapping[str, str]) -> RunConfig:
    choices = tuple((key, value) for key, value in values.items() if key in GROUPS)
    rest = {key: value for key, value in values.items() if key not in GROUPS}
    return _chosen(choices).override(rest)


@lru_cache(maxsize=256)
def _chosen(choices: tuple[tuple[str, str], ...]) -> RunConfig:
    # Thousands of points share a few choices of groups; checking a record takes a millisecond.
    return load_config(dict(choices))


def _resolve_data(config: RunConfig, allow_download: bool) -> Any:
    from fracbench.data.datasets import middlebury

    dataset = config.dataset if config.sequence.dataset == "middlebury" else "synthetic"
    return middlebury.resolve(dataset, config.data, allow_download)


def _planned(config: RunConfig, dataset: str, folder: Path | None) -> PlannedPoint:
    name, region = config.sequence.name, config.region
    if config.sequence.dataset != "middlebury":
        dataset = config.sequence.dataset
    elif dataset == "synthetic":
        if config.sequence.stand_in is None:
            raise InputError(f"sequence {config.sequence.key!r} has no synthetic stand-in")
        name, region = config.sequence.stand_in, None
    noise, seed = config.noise or 0.0, config.seed or 0
    point = Point(
        method=config.method.name,
        params=config.params,
        dataset=dataset,
        sequence=name,
        region=_scored(region, config, name, dataset),
        context=config.context if region else config.margin or 0,
        data_digest=_digest(name, dataset, folder, noise, seed),
        noise=noise,
        seed=seed,
        score=config.score,
    )
    labels = {
        "dataset": dataset,
        "sequence": f"synthetic_{name}" if dataset == "synthetic" else config.sequence.key,
        "region": config.region.name if config.region else "",
        "method": config.method.name,
        "protocol": config.protocol,
        "context": str(config.context),
    }
    for key in ("shift", "margin", "noise", "seed"):
        if (value := getattr(config, key)) is not None:
            labels[key] = canonical_value(value)
    return PlannedPoint(point, labels)


def _scored(region: Region | None, config: RunConfig, sequence: str, dataset: str) -> Region | None:
    """Return the box that is scored: the region, its neighbour, or the frame without a margin."""
    shape = shape_of(sequence, dataset)
    if region is not None:
        return region if config.shift is None else shifted(region, shape)[config.shift]
    if not config.margin:
        return None
    rows, cols = ((config.margin, n - config.margin) for n in shape)
    return Region(f"margin {config.margin}", sequence, rows, cols)


@lru_cache(maxsize=1024)
def _digest(name: str, dataset: str, folder: Path | None, noise: float, seed: int) -> str:
    return get_dataset(dataset).digest(name, folder, noise=noise, seed=seed)


def _idle_keys(keys: Sequence[str], points: Sequence[PlannedPoint]) -> list[str]:
    """Say which of the grid's parameters change nothing, because no method in the plan uses them."""
    from fracbench.methods.registry import get_method
    from fracbench.model.params import FlowParams

    used = set().union(*(get_method(planned.point.method).uses for planned in points))
    names = [key.removeprefix("params.") for key in keys]
    return [
        f"`{name}` does not affect the method" for name in names if name in FlowParams.names() and name not in used
    ]
