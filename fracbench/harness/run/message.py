"""The messages between the parent and a worker: a job there, an outcome or a row back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row


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
