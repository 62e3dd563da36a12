"""A point: one computation, the key under which its result is stored, and its way to a worker and back."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from fracbench.data.regions import Region
from fracbench.harness.config.numbers import canonical_number
from fracbench.harness.run.store import Row, canonical_json
from fracbench.methods.method import fields_of
from fracbench.methods.registry import get_method
from fracbench.model import SOLVER_VERSION
from fracbench.model.params import FlowParams

#: Measures, the scores that are not errors of a flow, and the functions that compute them: ``"module:function"``,
#: called as ``function(point, folder)``, which return a row's result. Studies own them; only workers import them.
MEASURES = {
    "spectrum": "fracbench.studies.solvers.spectral_radius:spectrum",
    "confidence": "fracbench.studies.confidence:errors_left",
    "convergence": "fracbench.studies.solvers.linearised_problem:courses",
    "oracle": "fracbench.studies.alpha_map.oracle:bounds",
}
#: Settings of a rendered scene, by name.
Scene = tuple[tuple[str, float], ...]
#: The dataset and the sequence of a point that needs no data.
NO_DATA = "none"


@dataclass(frozen=True)
class Point:
    """One computation: everything its result depends on, and nothing else.

    Parameters that the method does not use, and the region's name, are no part of the key. `params` are
    `FlowParams` or another frozen dataclass; `context` counts pixels around the region that take part in the
    computation; `data_digest` is the data's SHA-256; `noise` (gray levels) and `seed` are of a rendered scene,
    whose other settings are in `scene` where they are unusual. `score` is ``"frame"``, ``"structure"`` for errors
    by class of pixels as well, ``"fluid"`` for errors of derivatives as well, ``"unknown_as_zero"`` for unknown
    true flow counted as 0, or one of `MEASURES`; its `options` are numbers or tuples of numbers. `version` is
    `Method.stamp`; `shape`, that of the frames, tells the cost and is no part of the key.
    """

    method: str
    params: Any
    dataset: str
    sequence: str
    region: Region | None
    context: int
    data_digest: str
    noise: float = 0.0
    seed: int = 0
    scene: Scene = ()
    score: str = "frame"
    options: tuple[tuple[str, Any], ...] = ()
    version: str = ""
    shape: tuple[int, int] | None = field(default=None, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle parameters of a package as plain values: a worker that lacks the package says so in a row."""
        plain = isinstance(self.params, FlowParams | Mapping)
        return {**vars(self), "spec": self.spec, "params": self.params if plain else fields_of(self.params)}

    @cached_property
    def canonical(self) -> dict[str, str]:
        """The parameters that the method uses, sorted by public name: words, and numbers as decimals."""
        return {name: _shared_value(value) for name, value in get_method(self.method).values(self.params).items()}

    @property
    def usual(self) -> dict[str, str]:
        """The usual values of younger parameters, which the key leaves out; see `Method.younger`."""
        return {name: canonical_value(value) for name, value in get_method(self.method).younger.items()}

    @cached_property
    def spec(self) -> dict[str, Any]:
        """The canonical form, without the data's content; younger entries only where they are unusual."""
        usual: dict[str, Any] = {
            "noise": "0", "seed": 0, "scene": {}, "score": "frame", "options": {}, "version": ""
        }  # fmt: skip
        values: dict[str, Any] = {
            "noise": canonical_value(self.noise), "seed": self.seed, "score": self.score, "version": self.version
        }  # fmt: skip
        values["scene"] = {name: canonical_value(value) for name, value in self.scene}
        values["options"] = {name: _canonical_option(value) for name, value in self.options}
        younger, region = self.usual, self.region
        return {
            **{name: value for name, value in values.items() if value != usual[name]},
            "method": self.method,
            "params": {name: value for name, value in self.canonical.items() if younger.get(name) != value},
            "dataset": self.dataset,
            "sequence": self.sequence,
            "box": None if region is None else [*region.rows, *region.cols],
            "context": self.context,
        }

    @property
    def identity(self) -> str:
        """SHA-256 of the canonical form alone, for any version of the method."""
        return _sha256({name: value for name, value in self.spec.items() if name != "version"})

    @cached_property
    def key(self) -> str:
        """SHA-256 of the canonical form, the data and the solver's version: the key in the store."""
        return _sha256(self.hashed(self.spec))

    def hashed(self, spec: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the key is the hash of, for the canonical form of this point or of one of the same data."""
        return {"spec": spec, "data": self.data_digest, "solver_version": SOLVER_VERSION}


def canonical_value(value: Any) -> str:
    """Return the one spelling of a parameter's value: decimals, ``true``, ``none`` or the word itself."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return canonical_number(repr(value)) or repr(value)
    return str(value)


#: One text for all points of a value: a table of many points is made of them.
_shared_value = lru_cache(maxsize=65536, typed=True)(canonical_value)


def _canonical_option(value: Any) -> str | list[str]:
    return [canonical_value(item) for item in value] if isinstance(value, tuple) else canonical_value(value)


def _sha256(value: Any) -> str:
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """The end of a point: seconds of the estimate alone, and the largest resident memory of the process meanwhile.

    A worker says ``done``, ``failed`` or ``diverged``; the process that ends it, ``timeout`` or ``crashed``.
    """

    status: str
    error: str | None
    result: dict[str, Any]
    seconds: float | None
    peak_mib: float | None
    machine: dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A point on its way to a worker, with the key, the solver version and the commit that its parent has.

    `attempt` counts its starts, this one included; `timeout` is in seconds.
    """

    key: str
    point: Point
    attempt: int
    solver_version: int
    commit: Mapping[str, Any]
    folder: Path | None = None
    timeout: float | None = None

    def expired(self, machine: dict[str, Any]) -> Row:
        """Return the row that says that the time is over."""
        message = f"not finished within the {self.timeout:g} s allowed"
        return self.row(Outcome("timeout", message, {}, None, None, machine))

    def row(self, outcome: Outcome) -> Row:
        """Return the row for the store."""
        return Row(
            key=self.key,
            identity=self.point.identity,
            spec=self.point.spec,
            solver_version=self.solver_version,
            status=outcome.status,
            error=outcome.error,
            result=outcome.result,
            seconds=outcome.seconds,
            peak_mib=outcome.peak_mib,
            provenance={**outcome.machine, "threads": 1, **self.commit, "data": self.point.data_digest},
            attempts=self.attempt,
        )
