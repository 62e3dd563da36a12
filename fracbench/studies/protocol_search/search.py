"""The search: samplers of Optuna propose configurations, whose points are computed or taken from the store.

A sampler is made anew for each batch, with a seed of its own, and an interrupted study is proposed again with the
results of its table (`records`). So the search goes on as if it had not been interrupted.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from fracbench.errors import InputError
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.studies.protocol_search.records import FAILED, NUMBERS, Trial, TrialTable, rms, rounded
from fracbench.studies.protocol_search.space import Settings, Stage, Switch, Values

_POPULATION = 50
#: Trials at random before TPE has a model.
_RANDOM = 100

Compute = Callable[[Mapping[str, Point]], Mapping[str, Row]]
Printed = Mapping[tuple[str, str, str], float]


def require_optuna() -> None:
    """Refuse to search without Optuna."""
    try:
        import optuna
    except ImportError:
        raise InputError("a search needs Optuna: pip install 'fracbench[search]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)


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
    require_optuna()
    done = _by_study(table.read())
    trials: list[Trial] = []
    for place, stage in enumerate(settings.stages):
        best = best_values(trials)
        for sampler, seeds in stage.seeds.items():
            for seed in seeds:
                study = _Study(settings, stage, sampler, seed, place, best)
                known = done.get(study.name, [])
                found = study.run(known, table, printed, compute, on_trial, budget)
                trials += found
                if budget is not None:
                    budget -= len(found) - len(known)
                    if budget <= 0:
                        return trials
    return trials


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
    ranked = []
    for trial in unique:
        ranked.append((ranks[trial.study], trial.distance, len(ranked), trial.values))
        ranks[trial.study] += 1
    return [values for *_, values in sorted(ranked, key=lambda item: item[:3])]


class _Study:
    """The trials of one stage by one sampler with one seed, beginning with the best of the stage before."""

    def __init__(
        self, settings: Settings, stage: Stage, sampler: str, seed: int, place: int, best: Sequence[Values]
    ) -> None:
        import optuna

        self._settings, self._stage, self._sampler, self._seed = settings, stage, sampler, seed
        self._switches = settings.searched(stage)
        self.name = f"{place + 1}-{stage.name}-{sampler}-{seed}"
        with _quiet():
            self._study = optuna.create_study(directions=["minimize"] * (2 if sampler == "nsga2" else 1))
        self._given = [dict(values) for values in best[: stage.given]] if stage.given else []
        if stage.given and not self._given:
            raise InputError(f"stage {stage.name}: no configuration of the stage before ran to its end")
        begin = [settings.whole(values, self.name) for values in stage.begin]
        self._beginning = [] if stage.given else [*begin, *best][: settings.batch]

    def _digest(self) -> str:
        """Return the digest of all that a study depends on, apart from the best of the stage before."""
        settings = self._settings
        asked: list[Any] = [[switch.name, list(switch.values)] for switch in self._switches]
        asked += [settings.order(self._stage.methods), settings.stop_above, settings.stop_within, settings.batch]
        asked += [self._stage.given, self._stage.begin, [point.key for point in settings.points.values()]]
        return hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:8]

    def run(
        self,
        known: Sequence[Trial],
        table: TrialTable,
        printed: Printed,
        compute: Compute,
        on_trial: Callable[[], object],
        budget: int | None,
    ) -> list[Trial]:
        """Try configurations, batch by batch, until there are enough; `known` are those of the table."""
        settings, digest, wanted = self._settings, self._digest(), self._stage.trials
        if any(trial.settings != digest for trial in known):
            raise InputError(f"{table.path}: {self.name} has other settings; move the table away")
        trials: list[Trial] = list(known[:wanted]) if len(known) >= wanted else []
        least = float("inf")
        while len(trials) < wanted and (budget is None or len(trials) < len(known) + budget):
            first = len(trials)
            asked = self._ask(first, min(settings.batch, wanted - first))
            values = [self._values(trial.params) for trial in asked]
            batch = [trial for trial in known if first <= trial.number < first + len(asked)]
            if not batch:
                logs = _tried(values, self._stage.methods, settings, least, printed, compute)
                size = len(NUMBERS) * len(settings.order(self._stage.methods))
                batch = [
                    Trial(self._stage.name, self.name, first + i, values[i], found, len(found) < size, digest)
                    for i, found in enumerate(logs)
                ]
                table.append(batch)
            if [trial.values for trial in batch] != values:
                raise InputError(
                    f"{table.path}: {self.name} from trial {first} on is not what this release of Optuna "
                    "proposes; install the release of constraints.txt, or move the table away"
                )
            for trial, found in zip(asked, batch, strict=True):
                self._study.tell(trial, self._objectives(found.logs))
                on_trial()
            trials += batch
            least = min([least, *(trial.distance for trial in batch if not trial.stopped)])
        return trials

    def _ask(self, first: int, count: int) -> list[Any]:
        with _quiet():
            self._study.sampler = self._make_sampler(first)
            if first == 0:
                for values in self._beginning:
                    self._study.enqueue_trial(self._as_asked(values))
            distributions = self._distributions()
            return [self._study.ask(distributions) for _ in range(count)]

    def _make_sampler(self, first: int) -> Any:
        import optuna

        seed = int(np.random.SeedSequence([self._seed, first]).generate_state(1)[0])
        if self._sampler == "nsga2":
            return optuna.samplers.NSGAIISampler(population_size=_POPULATION, seed=seed)
        return optuna.samplers.TPESampler(multivariate=True, n_startup_trials=_RANDOM, seed=seed)

    def _distributions(self) -> dict[str, Any]:
        from optuna.distributions import CategoricalDistribution, IntDistribution

        def distribution(switch: Switch) -> Any:
            places = range(len(switch.values))
            return IntDistribution(0, places[-1]) if switch.ordered else CategoricalDistribution(list(places))

        found = {switch.name: distribution(switch) for switch in self._switches if len(switch.values) > 1}
        if self._given:
            found["given"] = IntDistribution(0, len(self._given) - 1)
        return found

    def _values(self, places: Mapping[str, int]) -> dict[str, Any]:
        given = self._given[places["given"]] if self._given else {}
        return {**given, **{s.name: s.values[places.get(s.name, 0)] for s in self._switches}}

    def _as_asked(self, values: Values) -> dict[str, int]:
        """Return the places of a configuration's values, as far as this stage searches them."""
        found = {switch.name: switch.values for switch in self._switches if len(switch.values) > 1}
        return {
            name: places.index(values[name])
            for name, places in found.items()
            if name in values and values[name] in places
        }

    def _objectives(self, logs: Mapping[tuple[str, str, str], float]) -> list[float]:
        """Return the distance, or two for NSGA-II: of each method, or of angular and end-point errors."""
        whole = rms(logs.values())
        if self._sampler != "nsga2":
            return [whole]
        by_method = len(self._stage.methods) > 1
        parts: list[list[float]] = [[], []]
        for (method, _, metric), log in logs.items():
            second = method != self._stage.methods[0] if by_method else metric == "aepe"
            parts[second].append(log)
        return [rms(part) if part else whole for part in parts]


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


@contextmanager
def _quiet() -> Any:
    """Keep Optuna's remarks about experimental features to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
