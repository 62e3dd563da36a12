"""The search: configurations are proposed (`proposals`), and their points computed or taken from the store.

An interrupted study is proposed again with the results of its table (`records`). So the search goes on as if it
had not been interrupted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fracbench.errors import InputError
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.studies.protocol_search.proposals import Proposals, proposals
from fracbench.studies.protocol_search.records import FAILED, NUMBERS, Trial, TrialTable, rms, rounded
from fracbench.studies.protocol_search.space import Settings, Stage, Values

Compute = Callable[[Mapping[str, Point]], Mapping[str, Row]]
Printed = Mapping[tuple[str, str, str], float]


def run_search(
    settings: Settings,
    table: TrialTable,
    printed: Printed,
    compute: Compute,
    on_trial: Callable[[], object] = lambda: None,
    *,
    budget: int | None = None,
) -> list[Trial]:
    """Search stage by stage, and return all trials; `table` keeps them.

    `compute` returns the rows of points by key. After `budget` new trials the search ends, to be resumed.
    """
    done = _by_study(table.read())
    trials: list[Trial] = []
    for place, stage in enumerate(settings.stages):
        best = best_values(trials)
        for sampler, seeds in stage.seeds.items():
            for seed in seeds:
                name = f"{place + 1}-{stage.name}-{sampler}-{seed}"
                known, proposed = done.get(name, []), proposals(settings, stage, sampler, seed, best)
                study = _Study(settings, stage, name)
                found = study.run(known, proposed, table, printed, compute, on_trial, budget)
                trials += found
                if budget is not None:
                    budget -= len(found) - len(known)
                    if budget <= 0:
                        return trials
    return trials


def take_over(table: TrialTable, other: Path, settings: Settings) -> int:
    """Begin a table with the trials of another file that have the same settings; return their number."""
    wanted = {settings.digest(stage) for stage in settings.stages}
    try:
        found = [trial for trial in TrialTable(other, settings).read() if trial.settings in wanted]
    except InputError:  # a search over other switches
        return 0
    if found:
        table.append(found)
    return len(found)


def _by_study(trials: Sequence[Trial]) -> dict[str, list[Trial]]:
    found: dict[str, list[Trial]] = {}
    for trial in trials:
        found.setdefault(trial.study, []).append(trial)
    return found


def best_values(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Return the values of the whole trials of the last stage: the nearest of each study, then the second nearest.

    Studies from different seeds end in different parts of the space, of which the stages after should know. Of
    trials that agree in all switches of a stage only one is left.
    """
    last = [trial for trial in trials if trial.stage == trials[-1].stage and not trial.stopped]
    last.sort(key=lambda trial: (trial.distance, trial.study, trial.number))
    unique = list({trial.configuration: trial for trial in reversed(last)}.values())[::-1]
    ranks: Counter[str] = Counter()
    ranked: list[tuple[int, float, int, dict[str, Any]]] = []
    for trial in unique:
        ranked.append((ranks[trial.study], trial.distance, len(ranked), trial.values))
        ranks[trial.study] += 1
    return [values for *_, values in sorted(ranked, key=lambda item: item[:3])]


class _Study:
    """The trials of one stage by one sampler with one seed."""

    def __init__(self, settings: Settings, stage: Stage, name: str) -> None:
        self._settings, self._stage, self._name = settings, stage, name

    def run(
        self,
        known: Sequence[Trial],
        proposed: Proposals,
        table: TrialTable,
        printed: Printed,
        compute: Compute,
        on_trial: Callable[[], object],
        budget: int | None,
    ) -> list[Trial]:
        """Try configurations, batch by batch, until there are enough; `known` are those of the table."""
        settings, digest, wanted = self._settings, self._settings.digest(self._stage), self._stage.trials
        if any(trial.settings != digest for trial in known):
            raise InputError(f"{table.path}: {self._name} has other settings; move the table away")
        trials: list[Trial] = []
        if len(known) >= wanted:
            trials = list(known[:wanted])
            for _ in trials:
                on_trial()
        least = float("inf")
        while len(trials) < wanted and (budget is None or len(trials) < len(known) + budget):
            first = len(trials)
            values = proposed.ask(first, min(settings.batch, wanted - first))
            batch = [trial for trial in known if first <= trial.number < first + len(values)]
            if not batch:
                logs = _tried(values, self._stage.methods, settings, least, printed, compute)
                size = len(NUMBERS) * len(settings.order(self._stage.methods))
                batch = [
                    Trial(self._stage.name, self._name, first + i, values[i], found, len(found) < size, digest)
                    for i, found in enumerate(logs)
                ]
                table.append(batch)
            if [trial.values for trial in batch] != values:
                raise InputError(
                    f"{table.path}: {self._name} from trial {first} on is not what this release of Optuna "
                    "proposes; install the release of constraints.txt, or move the table away"
                )
            proposed.tell([trial.logs for trial in batch], [trial.stopped for trial in batch])
            for _ in batch:
                on_trial()
            trials += batch
            least = min([least, *(trial.distance for trial in batch if not trial.stopped)])
        return trials


def _tried(
    configurations: Sequence[Values],
    methods: Sequence[str],
    settings: Settings,
    least: float,
    printed: Printed,
    compute: Compute,
) -> list[dict[tuple[str, str, str], float]]:
    """Return ln(ours / printed) of the numbers of configurations; those that are too far off end early.

    Point by point, all configurations that are left take a step: worker processes have many points at a time.
    """
    logs: list[dict[tuple[str, str, str], float]] = [{} for _ in configurations]
    left, order = list(range(len(configurations))), settings.order(methods)
    for step, (sequence, method) in enumerate(order, 1):
        points = {i: settings.point(method, sequence, configurations[i]) for i in left}
        rows = compute({point.key: point for point in points.values()})
        for i, point in points.items():
            logs[i].update(_logs(method, sequence, rows[point.key], printed))
        limit = settings.limit(least, step / len(order))
        left = [i for i in left if rms(logs[i].values()) <= limit]
        if not left:
            break
    return logs


def _logs(method: str, sequence: str, row: Row, printed: Printed) -> dict[tuple[str, str, str], float]:
    """Return ln(ours / printed) of the numbers of a row."""
    found = {}
    for metric in NUMBERS:
        ours = row.result.get(metric) if row.status == "done" else None
        log = float(np.log(ours / printed[method, sequence, metric])) if ours else FAILED
        found[method, sequence, metric] = rounded(log)
    return found
