"""A point: one computation, and the key under which its result is stored."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from fracbench.harness.config.numbers import canonical_number
from fracbench.harness.run.store import canonical_json
from fracbench.model import SOLVER_VERSION

#: Parameters younger than stored results, with the values that leave these as they are: no part of a key.
_YOUNGER = {"texture": "0", "occlusion": "median"}


@dataclass(frozen=True)
class Point:
    """One computation: everything its result depends on, and nothing else.

    Attributes
    ----------
    method : str
        Name in the registry.
    params : mapping of str to str
        The parameters the method uses; numbers as canonical decimals.
    dataset, sequence : str
        The data.
    box : tuple of int or None
        ``(row0, row1, col0, col1)``, half-open; None for the whole frame.
    context : int
        Pixels around the box that take part in the computation.
    data_digest : str
        SHA-256 of the data.
    noise : str
        Standard deviation of the noise of a rendered scene, a canonical decimal.
    seed : int
        Of a rendered scene.
    score : str
        ``"frame"``, or ``"structure"`` for errors by class of pixels as well.
    """

    method: str
    params: Mapping[str, str]
    dataset: str
    sequence: str
    box: tuple[int, int, int, int] | None
    context: int
    data_digest: str
    noise: str = "0"
    seed: int = 0
    score: str = "frame"

    @property
    def spec(self) -> dict[str, Any]:
        """The canonical form, without the data's content; noise, seed, score and `_YOUNGER` only where unusual."""
        usual = {"noise": "0", "seed": 0, "score": "frame"}
        unusual = {name: getattr(self, name) for name in usual if getattr(self, name) != usual[name]}
        return {
            **unusual,
            "method": self.method,
            "params": {name: value for name, value in self.params.items() if _YOUNGER.get(name) != value},
            "dataset": self.dataset,
            "sequence": self.sequence,
            "box": None if self.box is None else list(self.box),
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


def _sha256(value: Any) -> str:
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()
