"""The state of experiments: points done, failed, stale and missing, and the command that resumes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run import sweep
from fracbench.harness.run.plan import plan_artefact
from fracbench.harness.run.store import Store

_COMMANDS = {"table": "table", "fig": "figure"}


@dataclass(frozen=True)
class Standing:
    """The numbers of points of an experiment by state, and the command that resumes; empty if nothing is to do.

    Stale points are stored under other circumstances only: another solver version, other data. `error` says why
    the experiment cannot be planned.
    """

    experiment: str
    dataset: str = ""
    points: int = 0
    done: int = 0
    failed: int = 0
    stale: int = 0
    missing: int = 0
    why: dict[str, int] = field(default_factory=dict)
    command: str = ""
    error: str = ""


def standing(name: str, settings: Sequence[str], store: Store) -> Standing:
    """Compare the plan of an experiment with the store; nothing is computed or downloaded."""
    try:
        plan = plan_artefact(load_experiment(name), settings, allow_download=False)
    except InputError as exc:
        return Standing(name, error=str(exc))
    report, todo = sweep.missing(plan, store)
    missing = report.reasons["new"]
    failed = len(report.failed)
    return Standing(
        experiment=name,
        dataset=plan.dataset,
        points=len(plan.unique()),
        done=len(report.rows) - failed,
        failed=failed,
        stale=len(todo) - missing,
        missing=missing,
        why=dict(sorted(report.reasons.items())),
        command=_command(name, settings, bool(failed)) if failed or todo else "",
    )


def _command(name: str, settings: Sequence[str], failed: bool) -> str:
    numbered = re.fullmatch(rf"({'|'.join(_COMMANDS)})(\d+)", name)
    words = [_COMMANDS[numbered[1]], numbered[2]] if numbered else ["experiment", name]
    return " ".join(["fracbench", *words, *settings, *(["--rerun failed"] if failed else [])])
