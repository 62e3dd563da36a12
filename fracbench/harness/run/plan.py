"""From overrides to the points that are to be computed, and their labels."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from fracbench.data.datasets.registry import (
    AUTO,
    dataset_names,
    digest_of,
    find_folder,
    get_dataset,
    is_fixed,
    list_sequences,
    match_sequence,
    shape_of,
)
from fracbench.data.files import refuse_links_out
from fracbench.data.regions import Region, shifted
from fracbench.errors import AbsentError, DataError, InputError, nearest, unknown_name
from fracbench.harness.config.compose import (
    GROUPS,
    PARALLEL,
    SETTINGS,
    RunConfig,
    SequenceConfig,
    group_options,
    known_keys,
    load_config,
    own_files,
)
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.grid import Axis, Grid, expand_names, parse_overrides
from fracbench.harness.config.numbers import MAX_POINTS, canonical_number
from fracbench.harness.config.records import require_name
from fracbench.harness.run.grid_points import Axis as PointAxis
from fracbench.harness.run.grid_points import GridPoints, PlannedPoint, PlannedPoints, UniquePoints
from fracbench.harness.run.point import Point, Scene, canonical_value
from fracbench.methods.method import Method
from fracbench.model.params import FlowParams

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
class Plan:
    """Points in the order of the grid, and the settings that they share.

    Distinct labels may share a point, which is computed once. `config` is that of the first point; `folder` is
    where the Middlebury data are; `stand_in` tells whether synthetic scenes take the place of Middlebury
    sequences, `small` whether the grid was thinned.
    """

    points: PlannedPoints
    varying: tuple[str, ...]
    dataset: str
    folder: Path | None
    config: RunConfig
    notices: tuple[str, ...] = ()
    stand_in: bool = False
    foreign: bool = False
    small: bool = False

    @property
    def mark(self) -> str:
        """An ending for the names of an experiment's files: other data than its own, a thinned grid."""
        data = f"__{self.dataset}" if self.foreign else "_synthetic" if self.stand_in else ""
        return f"{data}_small" if self.small else data

    def unique(self) -> UniquePoints:
        """Return the distinct points by key, in order."""
        indices: dict[str, int] = {}
        for index, key in enumerate(self.points.keys()):
            indices.setdefault(key, index)
        return UniquePoints(self.points, indices)

    def labels(self, name: str) -> set[str]:
        """Return the distinct values of a label."""
        return {planned.labels[name] for planned in self.points.frames}

    def values(self, name: str) -> set[str]:
        """Return the distinct canonical values of a parameter, of the points that depend on it."""
        return self.points.values(name)


def make_plan(tokens: Sequence[str], *, allow_download: bool = True, small: bool = False) -> Plan:
    """Expand overrides (see `fracbench.harness.config.grid`) to points; `small` thins the grid."""
    grid = parse_overrides(tokens)
    pairs = _other_pairs(grid)
    grid = _expand_globs(grid if pairs is None else _expand_pairs(grid, pairs), pairs)
    if small:
        grid = grid.thinned()
    if grid.size > MAX_POINTS:
        raise InputError(f"{' '.join(tokens)}: {grid.size} points are more than the limit of {MAX_POINTS}")
    configs, idle, axes = _configure(grid, pairs)
    refuse_links_out(configs[0].results)
    wanting = next((config for config in configs if config.sequence.dataset == "middlebury"), None)
    resolved = _resolve_data(wanting or configs[0], allow_download)

    @cache
    def look(name: str, dataset: str, noise: float, seed: int, scene: Scene) -> tuple[tuple[int, int], str]:
        exact = match_sequence(name, dataset) if is_fixed(dataset) else name
        shape = shape_of(exact, dataset, resolved.folder)
        return shape, digest_of(exact, dataset, resolved.folder, noise=noise, seed=seed, **dict(scene))

    frames = [_planned(config, resolved.dataset, look) for config in configs]
    notices = [resolved.notice] if resolved.notice else []
    notices += idle
    stand_in = wanting is not None and resolved.dataset == "synthetic"
    return Plan(
        points=PlannedPoints(GridPoints(frames, axes)),
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

    A grid that names its dataset keeps it; where its data are not found, and where a program that a grid needs is
    not installed, the grid is left out with a notice, unless none is left. Without any grid the plan has no
    points, only the data set: for artefacts that show data or parameters.
    """
    pairs = _other_pairs(parse_overrides(settings))
    foreign = pairs is not None
    if not grids:
        one = [f"sequence='{pairs.names[0]}'"] if pairs else []  # not all of them: each is hashed
        plan = make_plan((*one, *settings), allow_download=allow_download, small=small)
        return replace(plan, points=PlannedPoints(), varying=(), foreign=foreign)
    plans: dict[str, Plan] = {}
    absent: dict[str, InputError] = {}
    for part, grid in grids.items():
        own = next((token for token in grid if token.startswith("dataset=")), None)
        if own and pairs:
            raise InputError(f"part {part!r} is of {own}, which dataset={pairs.dataset} cannot take the place of")
        tokens = [token for token in grid if not (foreign and token.startswith("sequence="))]
        tokens += [token for token in settings if not (own and token.startswith("dataset="))]
        try:
            plans[part] = make_plan(tokens, allow_download=allow_download, small=small)
        except (AbsentError, DataError) as exc:
            if not (own or isinstance(exc, AbsentError)):
                raise
            absent[part] = exc
    if not plans:
        raise next(iter(absent.values()))
    first = next(iter(plans.values()))
    real = next((plan for plan in plans.values() if plan.dataset == "middlebury"), None)
    real = real or next((plan for plan in plans.values() if plan.folder is not None), first)
    varying = tuple(dict.fromkeys(key for plan in plans.values() for key in plan.varying))
    notices = dict.fromkeys(notice for plan in plans.values() for notice in plan.notices)
    notices |= _left_out(absent)
    return replace(
        first,
        points=PlannedPoints(*(plan.points.labelled({"part": part}) for part, plan in plans.items())),
        varying=varying,
        notices=tuple(notices),
        dataset=real.dataset,
        folder=real.folder,
        stand_in=any(plan.stand_in for plan in plans.values()),
        foreign=foreign,
    )


def _left_out(absent: Mapping[str, InputError]) -> dict[str, None]:
    """Return a notice for each reason, with the parts that are left out for it."""
    reasons = dict.fromkeys(map(str, absent.values()))
    parts = {reason: ", ".join(part for part in absent if str(absent[part]) == reason) for reason in reasons}
    return dict.fromkeys(f"{reason} (left out: {names})" for reason, names in parts.items())


def plan_artefact(
    experiment: Experiment, settings: Sequence[str] = (), *, allow_download: bool = True, small: bool = False
) -> Plan:
    """Plan all that the artefact of an experiment needs: the points of its grids, and its measures."""
    plan = plan_experiment(experiment.grids, settings, allow_download=allow_download, small=small)
    if experiment.artefact not in _MEASURED:
        return plan
    measured = pkgutil.resolve_name(_MEASURED[experiment.artefact])
    return replace(plan, points=PlannedPoints(plan.points, measured(experiment, plan)))


@dataclass(frozen=True)
class _Pairs:
    """The pairs of a dataset that have no files in ``conf/sequence``: their parameters are the protocol's."""

    dataset: str
    folder: Path | None
    names: tuple[str, ...]


def _other_pairs(grid: Grid) -> _Pairs | None:
    """Return the pairs of the dataset that the grid chooses, unless that is one of the paper's."""
    dataset = grid.fixed.get("dataset", AUTO)
    if dataset in (AUTO, "middlebury", "synthetic"):
        return None
    if dataset not in (known := dataset_names()):
        raise unknown_name("dataset", dataset, (AUTO, *known))
    folder = find_folder(dataset, grid.fixed.get("paths.data"))
    names = list_sequences(dataset, folder)
    for name in names:
        require_name(name, "the name of a pair", f"dataset {dataset}" if folder is None else str(folder))
    return _Pairs(dataset, folder, names)


def _expand_pairs(grid: Grid, pairs: _Pairs) -> Grid:
    """Replace ``all`` and globs by the names of pairs; a grid without a sequence is of all of them."""

    def expand(axis: Axis) -> Axis:
        if "region" in axis.keys and (named := [row for row in axis.values if row != ("none",)]):
            raise InputError(
                f"region={named[0][0]}: regions belong to Middlebury; dataset={pairs.dataset} has none"
            )
        if "sequence" not in axis.keys:
            return axis
        i = axis.keys.index("sequence")
        rows = [(*row[:i], name, *row[i + 1 :]) for row in axis.values for name in _named(row[i], pairs)]
        return Axis(axis.keys, tuple(dict.fromkeys(rows)))

    axes = tuple(expand(axis) for axis in grid.axes)
    if not any("sequence" in axis.keys for axis in axes):
        axes = (Axis(("sequence",), tuple((name,) for name in pairs.names)), *axes)
    return Grid(axes)


def _named(pattern: str, pairs: _Pairs) -> list[str]:
    if pattern in (*pairs.names, "all") or any(c in pattern for c in "*?["):
        return expand_names([pattern], pairs.names, "sequence")
    if canonical_number(pattern) == pattern:  # a grid writes the number 0010 as 10, and a pair may be called 0010
        numbered = [name for name in pairs.names if canonical_number(name) == pattern]
        if len(numbered) == 1:
            return numbered
    guess = nearest(pattern, pairs.names)
    hint = f": did you mean {guess!r}?" if guess else ""
    raise InputError(
        f"unknown sequence {pattern!r} of dataset {pairs.dataset}{hint} ({len(pairs.names)} pairs, from "
        f"{pairs.names[0]} to {pairs.names[-1]})"
    )


def _expand_globs(grid: Grid, pairs: _Pairs | None) -> Grid:
    named = ("method", "protocol") if pairs else ("region", "sequence", "method", "protocol")

    def expand(axis: Axis) -> Axis:
        key = axis.keys[0]
        if len(axis.keys) > 1 or key not in named:
            return axis
        names = [value[0] for value in axis.values]
        if key == "region" and names == ["none"]:
            return axis
        # `all` means the regions of the paper; those of the working folder have to be named.
        options = group_options(key, own=not (key == "region" and names == ["all"]))
        if key == "sequence":
            # `all` means the sequences of the paper, in its order; the scenes have to be named.
            paper = [name.lower() for name in list_sequences("middlebury")]
            options = paper if names == ["all"] else paper + [name for name in options if name not in paper]
        return Axis(axis.keys, tuple((name,) for name in expand_names(names, options, key)))

    return replace(grid, axes=tuple(expand(axis) for axis in grid.axes))


def _check_keys(grid: Grid, methods: Iterable[Method]) -> None:
    allowed = known_keys(methods)
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


def _configure(grid: Grid, pairs: _Pairs | None) -> tuple[list[RunConfig], list[str], list[PointAxis]]:
    """Return a configuration for each choice of the axes that are bound, notices, and the axes.

    Axes of parameters alone are free, if all methods have `FlowParams`, whose values do not depend on each other.
    """
    free = [not set(axis.keys).intersection((*GROUPS, *SETTINGS)) for axis in grid.axes]
    ends = zip(grid.axes, free, strict=True)
    thin = Grid(tuple(Axis(axis.keys, axis.values[:1]) if is_free else axis for axis, is_free in ends))
    configs, notices = _configured(thin, pairs)
    methods = {config.method.name: config.method for config in configs}
    names = {key.removeprefix("params.") for axis in grid.axes for key in axis.keys}
    if not all(
        method.params is FlowParams and method.uses - method.younger.keys() - names for method in methods.values()
    ):
        free = [False] * len(free)
        configs, notices = _configured(grid, pairs)
    axes = []
    for axis, is_free in zip(grid.axes, free, strict=True):
        keys = [key.removeprefix("params.") for key in axis.keys]
        rows = [dict(zip(keys, row, strict=True)) for row in axis.values] if is_free else []
        changes = {name: [method.accepted(row) for row in rows] for name, method in methods.items()}
        axes.append(PointAxis(len(axis.values), changes if is_free else None))
    return configs, notices, axes


def _configured(grid: Grid, pairs: _Pairs | None) -> tuple[list[RunConfig], list[str]]:
    """Return the configuration of each point, and notices of parameters that change nothing."""
    state, parts = own_files(), []
    for values in grid.points():
        choices = tuple((key, value) for key, value in values.items() if key in GROUPS)
        rest = {key: value for key, value in values.items() if key not in GROUPS}
        if pairs is None:
            base = _chosen(choices, state)
        else:
            others = tuple(choice for choice in choices if choice[0] != "sequence")
            pair = SequenceConfig(values["sequence"], values["sequence"], pairs.dataset)
            base = replace(_chosen(others, state, pairs.dataset), sequence=pair)
        parts.append((base, rest))
    methods = {base.method.name: base.method for base, _ in parts}
    _check_keys(grid, methods.values())
    for method in methods.values():
        method.require()
    names = [key.removeprefix("params.") for axis in grid.axes for key in axis.keys if key not in SETTINGS]
    notices = _idle_keys([name for name in names if name not in GROUPS], methods)
    return [base.override(_known(base.method, values)) for base, values in parts], notices


@lru_cache(maxsize=256)
def _chosen(choices: tuple[tuple[str, str], ...], _: object, dataset: str | None = None) -> RunConfig:
    # Thousands of points share a few choices of groups; checking a record takes a millisecond.
    return load_config(dict(choices), None if dataset is None else SequenceConfig("any", "any", dataset))


def _known(method: Method, values: Mapping[str, str]) -> Mapping[str, str]:
    """Leave out the parameters that only other methods of the grid have, or `FlowParams` alone."""
    known: dict[str, str] = {}
    ours: dict[str, str] = {}
    for key, value in values.items():
        name = key.removeprefix("params.")
        if key in SETTINGS or name in method.names:
            known[key] = value
        elif name in FlowParams.names():
            ours[name] = value
    FlowParams().replace(ours)  # a value out of range is refused even where it has no effect
    return known


def _resolve_data(config: RunConfig, allow_download: bool) -> Any:
    from fracbench.data.datasets import middlebury

    own = config.sequence.dataset
    if own not in ("middlebury", "synthetic"):
        return middlebury.Resolved(own, find_folder(own, config.data))
    return middlebury.resolve(config.dataset if own == "middlebury" else own, config.data, allow_download)


_Look = Callable[[str, str, float, int, Scene], tuple[tuple[int, int], str]]


def _planned(config: RunConfig, dataset: str, look: _Look) -> PlannedPoint:
    name, region = config.sequence.name, config.region
    if config.sequence.dataset != "middlebury":
        dataset = config.sequence.dataset
    elif dataset == "synthetic":
        if config.sequence.stand_in is None:
            raise InputError(f"sequence {config.sequence.key!r} has no synthetic stand-in")
        name, region = config.sequence.stand_in, None
    noise, seed = config.noise or 0.0, config.seed or 0
    usual = get_dataset(dataset).settings
    scene = tuple((key, value) for key, value in sorted(config.scene.items()) if value != usual[key])
    shape, digest = look(name, dataset, noise, seed, scene)
    point = Point(
        method=config.method.name,
        params=config.params,
        dataset=dataset,
        sequence=name,
        region=_scored(region, config, name, shape),
        context=config.context if region else config.margin or 0,
        data_digest=digest,
        noise=noise,
        seed=seed,
        scene=scene,
        score=config.score,
        version=config.method.stamp,
        shape=shape,
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
    labels |= {key: canonical_value(value) for key, value in config.scene.items()}
    return PlannedPoint(point, labels)


def _scored(region: Region | None, config: RunConfig, sequence: str, shape: tuple[int, int]) -> Region | None:
    """Return the box that is scored: the region, its neighbour, or the frame without a margin."""
    if region is not None:
        return region if config.shift is None else shifted(region, shape)[config.shift]
    if not config.margin:
        return None
    if 2 * config.margin >= min(shape):
        raise InputError(f"margin={config.margin} leaves nothing of a side of {min(shape)} pixels")
    rows, cols = ((config.margin, n - config.margin) for n in shape)
    return Region(f"margin {config.margin}", sequence, rows, cols)


def _idle_keys(names: Sequence[str], methods: Mapping[str, Method]) -> list[str]:
    """Say which of the grid's parameters change nothing, for all methods or for some that do not have them."""
    notices = []
    for name in names:
        without = [method.name for method in methods.values() if name not in method.names]
        if not any(name in method.uses for method in methods.values()):
            notices.append(f"`{name}` does not affect the method")
        elif without:
            notices.append(f"{', '.join(without)} does not know `{name}`: one point stands for all its values")
    return notices
