"""A point: one computation, and the key under which its result is stored."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from fracbench.data.regions import Region
from fracbench.harness.config.numbers import canonical_number
from fracbench.harness.run.store import canonical_json
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
#: The dataset and the sequence of a point that needs no data.
NO_DATA = "none"

#: Parameters younger than stored results, with the values that leave these as they are: no part of a key.
_YOUNGER = {"finest_scale": "0", "texture": "0", "occlusion": "median"}


@dataclass(frozen=True)
class Point:
    """One computation: everything its result depends on, and nothing else.

    Parameters that the method does not use, and the region's name, are no part of the key. `context` counts pixels
    around the region that take part in the computation; `data_digest` is the data's SHA-256; `noise` (gray levels)
    and `seed` are of a rendered scene. `score` is ``"frame"``, ``"structure"`` for errors by class of pixels as
    well, or one of `MEASURES`; its `options` are numbers or tuples of numbers.
    """

    method: str
    params: FlowParams
    dataset: str
    sequence: str
    region: Region | None
    context: int
    data_digest: str
    noise: float = 0.0
    seed: int = 0
    score: str = "frame"
    options: tuple[tuple[str, Any], ...] = ()

    @cached_property
    def canonical(self) -> dict[str, str]:
        """The parameters that the method uses, sorted by public name: words, and numbers as decimals."""
        params = self.params.as_dict()
        return {name: canonical_value(params[name]) for name in sorted(get_method(self.method).uses)}

    @property
    def spec(self) -> dict[str, Any]:
        """The canonical form, without the data's content; noise to options, and `_YOUNGER`, only where unusual."""
        usual: dict[str, Any] = {"noise": "0", "seed": 0, "score": "frame", "options": {}}
        values = {"noise": canonical_value(self.noise), "seed": self.seed, "score": self.score}
        values["options"] = {name: _canonical_option(value) for name, value in self.options}
        region = self.region
        return {
            **{name: value for name, value in values.items() if value != usual[name]},
            "method": self.method,
            "params": {name: value for name, value in self.canonical.items() if _YOUNGER.get(name) != value},
            "dataset": self.dataset,
            "sequence": self.sequence,
            "box": None if region is None else [*region.rows, *region.cols],
            "context": self.context,
        }

    @property
    def identity(self) -> str:
        """SHA-256 of the canonical form alone."""
        return _sha256(self.spec)

    @cached_property
    def key(self) -> str:
        """SHA-256 of the canonical form, the data and the solver's version: the key in the store."""
        return _sha256({"spec": self.spec, "data": self.data_digest, "solver_version": SOLVER_VERSION})


def canonical_value(value: Any) -> str:
    """Return the one spelling of a parameter's value: decimals, ``true``, ``none`` or the word itself."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return canonical_number(repr(value)) or repr(value)
    return str(value)


def _canonical_option(value: Any) -> str | list[str]:
    return [canonical_value(item) for item in value] if isinstance(value, tuple) else canonical_value(value)


def _sha256(value: Any) -> str:
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()
