"""The settings of a search: the values of each switch, the stages, and the points of a configuration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from fracbench.data.regions import Region
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.records import mapping, record
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import Point
from fracbench.methods.registry import get_method
from fracbench.model.params import public_name
from fracbench.studies.options import require_options

#: The part of the space that holds the switches of all methods.
SHARED = "shared"
#: Switches of the scoring: they are no parameters of a method.
SCORING = ("score", "margin")
SAMPLERS = ("tpe", "nsga2", "neighbours")

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Switch:
    """A parameter and its values; `name` is ``n_warps``, or ``tvl1.tau`` for that of one method."""

    name: str
    values: tuple[Any, ...]

    @property
    def ordered(self) -> bool:
        """True if the values are numbers in rising order, so that neighbours are alike."""
        numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)
        return numbers and list(self.values) == sorted(self.values)


@dataclass(frozen=True)
class Stage:
    """One part of a search.

    Attributes
    ----------
    methods : list of str
        The methods whose distance is minimised.
    trials : int
        Configurations by each sampler and seed.
    seeds : dict
        Seeds by sampler: ``tpe`` or ``nsga2``, or ``neighbours``, for which the seed is the rank, from 1, of the
        configuration to begin with.
    given : int
        Take the settings of the other methods from so many of the best of the stages before, and search only the
        switches of `methods`; 0: search all switches, beginning with those best.
    begin : list of dict
        Configurations to begin with; switches that one does not name have the grid's values.
    """

    methods: list[str]
    trials: int
    seeds: dict[str, Any] = field(default_factory=dict)
    given: int = 0
    begin: list[Any] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The methods' names, joined."""
        return "+".join(self.methods)

    @property
    def size(self) -> int:
        """The number of configurations of all samplers and seeds."""
        return self.trials * sum(len(seeds) for seeds in self.seeds.values())

    def __post_init__(self) -> None:
        if self.trials < 1 or self.given < 0 or not self.methods:
            raise InputError("a stage needs `methods`, `trials` of at least 1 and `given` of at least 0")
        for sampler, seeds in self.seeds.items():
            if sampler not in SAMPLERS:
                raise unknown_name("sampler", sampler, SAMPLERS)
            if sampler == "neighbours" and self.given:
                raise InputError("a stage by neighbours has no `given`")
            if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds):
                raise InputError(f"seeds of {sampler} must be a list of whole numbers, got {seeds!r}")


@dataclass(frozen=True)
class Settings:
    """A search: see ``experiments/protocol_search.yaml``.

    Attributes
    ----------
    switches : tuple of Switch
    stages : tuple of Stage
    first : tuple of str
        The sequences that are computed first, in this order.
    stop_above, stop_within : float
        A configuration ends early where its numbers so far are farther from the printed ones than the smaller of
        `stop_above` and `stop_within` times the least distance of its study (`limit`).
    batch : int
        Configurations that a sampler proposes at a time, and that are kept together.
    points : dict
        The points of the grid by method and sequence: those of a configuration differ from them by its values.
    """

    switches: tuple[Switch, ...]
    stages: tuple[Stage, ...]
    first: tuple[str, ...]
    stop_above: float
    stop_within: float
    batch: int
    points: Mapping[tuple[str, str], Point]

    @property
    def sequences(self) -> tuple[str, ...]:
        """All sequences, the first ones first."""
        return tuple(dict.fromkeys([*self.first, *(sequence for _, sequence in self.points)]))

    def order(self, methods: Sequence[str] = ()) -> list[tuple[str, str]]:
        """Return the sequences and methods, all or those of a stage, in the order in which they are computed.

        A method comes after another on all sequences: many configurations differ in the later method alone.
        """
        known = dict.fromkeys(method for method, _ in self.points)
        return [(name, m) for m in known for name in self.sequences if not methods or m in methods]

    def limit(self, least: float, part: float) -> float:
        """Return the distance at which a configuration ends after a part, in (0, 1], of its points.

        `least` is the least distance so far. A distance over a part p of the numbers is at most p^(-1/2) times
        that over all of them; p^(-1/4) is stricter: few configurations have all their errors in one sequence.
        """
        return float(min(self.stop_above, self.stop_within * least) * part**-0.25)

    @cached_property
    def usual(self) -> dict[str, Any]:
        """The grid's value of each switch: that of the first point which has it."""
        found: dict[str, Any] = {"score": "frame", "margin": 0}
        for (method, _), point in self.points.items():
            values = {public_name(name): value for name, value in vars(point.params).items()}
            found |= {f"{method}.{name}": value for name, value in values.items()}
            found = values | found
        return {switch.name: found[switch.name] for switch in self.switches}

    def whole(self, values: Values, where: str) -> dict[str, Any]:
        """Return a configuration with the grid's values of the switches that it does not name."""
        for name, value in values.items():
            if name not in self.usual:
                raise unknown_name("switch", name, list(self.usual), where)
            if value not in next(switch.values for switch in self.switches if switch.name == name):
                raise InputError(f"{where}: {name}={value} is not among the values that are searched")
        return {**self.usual, **values}

    def searched(self, stage: Stage) -> list[Switch]:
        """Return the switches that a stage searches."""
        parts = stage.methods if stage.given else [SHARED, *stage.methods]
        return [switch for switch in self.switches if part_of(switch.name) in parts]

    def digest(self, stage: Stage) -> str:
        """Return the digest of all that a study of a stage depends on, apart from the best of the stage before."""
        asked: list[Any] = [[switch.name, list(switch.values)] for switch in self.searched(stage)]
        asked += [self.order(stage.methods), self.stop_above, self.stop_within, self.batch]
        asked += [stage.given, stage.begin, [point.key for point in self.points.values()]]
        return hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:8]

    def point(self, method: str, sequence: str, values: Values) -> Point:
        """Return the point of a configuration for a method and a sequence."""
        base, known = self.points[method, sequence], get_method(method)
        mine = {_plain(name): value for name, value in values.items() if part_of(name) in (SHARED, method)}
        scoring = {name: mine.pop(name) for name in SCORING if name in mine}
        used = {name: value for name, value in mine.items() if name in known.uses}
        point = replace(base, params=known.replace(base.params, used), score=scoring.get("score", base.score))
        return _with_margin(point, scoring.get("margin", 0))


def settings_of(experiment: Experiment, plan: Plan) -> Settings:
    """Return the checked settings of the search that an experiment describes."""
    options, where = require_options(experiment), f"experiment {experiment.name}"
    points = {(p.point.method, p.labels["sequence"]): p.point for p in plan.points}
    if len(points) != len(plan.points):
        raise InputError(f"{where}: the grid of a search has one point for each method and sequence")
    methods = list(dict.fromkeys(method for method, _ in points))
    stages = tuple(record(Stage, raw, f"{where}, stages") for raw in options.stages)
    if not stages:
        raise InputError(f"{where}: a search needs `stages`")
    for stage in stages:
        for method in stage.methods:
            if method not in methods:
                raise unknown_name("method", method, methods, f"{where}, stages")
    if stages[0].given:
        raise InputError(f"{where}: the first stage has nothing that could be `given`")
    if any(stage.given and stage.begin for stage in stages):
        raise InputError(f"{where}: a stage has `given` or `begin`, not both")
    found = {sequence for _, sequence in points}
    first = tuple(sequence for sequence in options.first if sequence in found)
    if plan.small:
        stages = tuple(replace(stage, trials=min(stage.trials, options.batch)) for stage in stages)
    switches = tuple(_switches(options.space, methods, where))
    limits = options.stop_above, options.stop_within
    settings = Settings(switches, stages, first, *limits, options.batch, points)
    for stage in stages:
        for values in stage.begin:
            settings.whole(mapping(values, f"{where}, begin"), f"{where}, begin")
    one_each = dict(points.keys())
    for switch in switches:  # a value that is not allowed is refused before anything is computed
        for value in switch.values:
            for method, sequence in one_each.items():
                settings.point(method, sequence, {switch.name: value})
    return settings


def _switches(space: Mapping[str, Any], methods: Sequence[str], where: str) -> list[Switch]:
    found = []
    for part, switches in space.items():
        if part not in (SHARED, *methods):
            raise unknown_name("method", part, (SHARED, *methods), f"{where}, space")
        users = methods if part == SHARED else [part]
        allowed = sorted({name for method in users for name in get_method(method).uses})
        for name, values in switches.items():
            if name not in (*allowed, *(SCORING if part == SHARED else ())):
                raise unknown_name("switch", name, allowed, f"{where}, space of {part}")
            if not isinstance(values, list) or not values or len(set(map(repr, values))) < len(values):
                raise InputError(f"{where}: {name} must have a list of different values, got {values!r}")
            found.append(Switch(name if part == SHARED else f"{part}.{name}", tuple(values)))
    return found


def part_of(name: str) -> str:
    """Return the part of the space to which a switch belongs: `SHARED`, or a method."""
    return name.rpartition(".")[0] or SHARED


def _plain(name: str) -> str:
    return name.rpartition(".")[2]


def _with_margin(point: Point, margin: int) -> Point:
    """Return a point whose flow is that of the whole frame, scored without `margin` pixels at each side."""
    if not margin or point.shape is None:
        return point
    rows, cols = ((margin, n - margin) for n in point.shape)
    return replace(point, region=Region(f"margin {margin}", point.sequence, rows, cols), context=margin)
