"""The search: samplers of Optuna propose configurations, whose points are computed or taken from the store.

A sampler is made anew for each batch, with a seed of its own, so that a search that was interrupted goes on as if
it had not been. Points that were computed meanwhile are in the store.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fracbench.errors import InputError
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.studies.protocol_search.space import Settings, Stage, Switch, Values

#: |ln(ours / printed)| of a point that failed or diverged.
FAILED = float(np.log(100.0))
#: Numbers of a method and a sequence in Table 2: the angular errors first, for the two objectives of NSGA-II.
NUMBERS = ("aae", "sdae", "aepe")
_POPULATION = 50
#: Trials at random before TPE has a model.
_RANDOM = 100

Compute = Callable[[Mapping[str, Point]], Mapping[str, Row]]
Printed = Mapping[tuple[str, str, str], float]


@dataclass(frozen=True)
class Trial:
    """A configuration that was tried: its values, and ln(ours / printed) by method, sequence and metric.

    `distance` is over the numbers that were computed: all of the stage's, unless it was `stopped` early.
    """

    stage: str
    study: str
    number: int
    values: dict[str, Any]
    logs: dict[tuple[str, str, str], float]
    distance: float
    stopped: bool


def require_optuna() -> None:
    """Refuse to search without Optuna."""
    try:
        import optuna
    except ImportError:
        raise InputError("a search needs Optuna: pip install 'fracbench[search]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)


def run_search(
    settings: Settings,
    folder: Path,
    printed: Printed,
    compute: Compute,
    on_trial: Callable[[], object] = lambda: None,
    *,
    budget: int | None = None,
) -> list[Trial]:
    """Search stage by stage, and return all trials; `folder` holds a journal for each stage, sampler and seed.

    `compute` returns the rows of points by key. After `budget` new trials the search ends, to be resumed.
    """
    require_optuna()
    trials: list[Trial] = []
    for place, stage in enumerate(settings.stages):
        best = best_values(trials, settings)
        for sampler, seeds in stage.seeds.items():
            for seed in seeds:
                study = _Study(
                    settings, stage, sampler, seed, folder / f"{place + 1}-{stage.name}-{sampler}-{seed}"
                )
                study.enqueue(best)
                new = study.run(printed, compute, on_trial, budget)
                trials += study.trials()
                if budget is not None:
                    budget -= new
                    if budget <= 0:
                        return trials
    return trials


def stored_trials(settings: Settings, folder: Path) -> list[Trial]:
    """Return the trials in the journals of a folder."""
    require_optuna()
    return [trial for study in _studies(settings, folder) for trial in study.trials()]


def _studies(settings: Settings, folder: Path) -> list[_Study]:
    return [
        _Study(settings, stage, sampler, seed, path)
        for place, stage in enumerate(settings.stages)
        for sampler, seeds in stage.seeds.items()
        for seed in seeds
        if (path := folder / f"{place + 1}-{stage.name}-{sampler}-{seed}").with_suffix(".jsonl").exists()
    ]


def best_values(trials: Sequence[Trial], settings: Settings) -> list[dict[str, Any]]:
    """Return the values of the whole trials of the last stage, the nearest to the printed table first.

    Of trials that agree in all switches of a stage only one is left.
    """
    if not trials:
        return []
    last = [trial for trial in trials if trial.stage == trials[-1].stage and not trial.stopped]
    found: dict[str, dict[str, Any]] = {}
    for trial in sorted(last, key=lambda trial: (trial.distance, trial.study, trial.number)):
        found.setdefault(repr(sorted(trial.values.items())), trial.values)
    return list(found.values())


class _Study:
    """The trials of one stage by one sampler with one seed."""

    def __init__(self, settings: Settings, stage: Stage, sampler: str, seed: int, path: Path) -> None:
        import optuna

        from fracbench.studies.protocol_search.journal import BatchJournal

        self._settings, self._stage, self._sampler, self._seed = settings, stage, sampler, seed
        self._switches = settings.searched(stage)
        self._name = path.name
        self._journal = BatchJournal(path.with_suffix(".jsonl"))
        with _quiet():
            self._study = optuna.create_study(
                storage=optuna.storages.JournalStorage(self._journal),
                study_name=path.name,
                directions=["minimize"] * (2 if sampler == "nsga2" else 1),
                load_if_exists=True,
            )
        self._given: list[Values] = []
        self._require_same(path)

    def _require_same(self, path: Path) -> None:
        """Refuse to go on with the trials of other settings."""
        settings = self._settings
        asked: list[Any] = [[switch.name, list(switch.values)] for switch in self._switches]
        asked += [settings.first, settings.stop_above, settings.batch, self._stage.given]
        text = json.dumps(asked)
        if self._study.user_attrs.setdefault("settings", text) != text:
            raise InputError(f"{path.with_suffix('.jsonl')}: holds a search with other settings; move it away")
        if not self._finished():
            self._study.set_user_attr("settings", text)

    def enqueue(self, best: Sequence[Values]) -> None:
        """Take the best settings of the stage before: as given, or to begin with."""
        self._given = [dict(values) for values in best[: self._stage.given]] if self._stage.given else []
        begin = [self._settings.whole(values, self._name) for values in self._stage.begin]
        self._beginning = [] if self._stage.given else [*begin, *best][: self._settings.batch]
        if self._stage.given and not self._given:
            raise InputError(f"stage {self._stage.name}: no configuration of the stage before ran to its end")

    def run(self, printed: Printed, compute: Compute, on_trial: Callable[[], object], budget: int | None) -> int:
        """Try configurations, batch by batch, until there are enough; return how many were tried."""
        done = start = len(self._finished())
        while done < self._stage.trials and (budget is None or done - start < budget):
            count = min(self._settings.batch, self._stage.trials - done)
            with _quiet():
                self._batch(done, count, printed, compute, on_trial)
            self._journal.commit()
            done += count
        return done - start

    def _batch(
        self, first: int, count: int, printed: Printed, compute: Compute, on_trial: Callable[[], object]
    ) -> None:
        self._study.sampler = self._make_sampler(first)
        if first == 0:
            for values in self._beginning:
                self._study.enqueue_trial(self._as_asked(values))
        distributions = self._distributions()
        for trial in [self._study.ask(distributions) for _ in range(count)]:
            values = self._values(trial.params)
            logs, stopped = self._try(values, printed, compute)
            trial.set_user_attr("values", values)
            trial.set_user_attr("logs", [[*number, round(log, 6)] for number, log in logs.items()])
            trial.set_user_attr("stopped", stopped)
            self._study.tell(trial, self._objectives(logs))
            on_trial()

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

    def _try(
        self, values: Values, printed: Printed, compute: Compute
    ) -> tuple[dict[tuple[str, str, str], float], bool]:
        """Return ln(ours / printed) of all numbers, or of the first sequences if these are too far off."""
        settings, logs = self._settings, {}
        rest = settings.sequences[len(settings.first) :]
        for sequences in (settings.first, rest):
            for method in self._stage.methods:
                points = {sequence: settings.point(method, sequence, values) for sequence in sequences}
                rows = compute({point.key: point for point in points.values()})
                for sequence, point in points.items():
                    logs.update(_logs(method, sequence, rows[point.key], printed))
                if sequences is settings.first and rest and _distance(logs.values()) > settings.stop_above:
                    return logs, True
        return logs, False

    def _objectives(self, logs: Mapping[tuple[str, str, str], float]) -> list[float]:
        """Return the distance, or two for NSGA-II: of each method, or of angular and end-point errors."""
        whole = _distance(logs.values())
        if self._sampler != "nsga2":
            return [whole]
        by_method = len(self._stage.methods) > 1
        parts: list[list[float]] = [[], []]
        for (method, _, metric), log in logs.items():
            second = method != self._stage.methods[0] if by_method else metric == "aepe"
            parts[second].append(log)
        return [_distance(part) if part else whole for part in parts]

    def _finished(self) -> list[Any]:
        return [trial for trial in self._study.get_trials(deepcopy=False) if trial.state.is_finished()]

    def trials(self) -> list[Trial]:
        """Return the trials that are done."""
        found = []
        for trial in self._finished():
            attributes = trial.user_attrs
            logs = {(method, sequence, metric): log for method, sequence, metric, log in attributes["logs"]}
            found.append(
                Trial(
                    self._stage.name,
                    self._name,
                    trial.number,
                    attributes["values"],
                    logs,
                    _distance(logs.values()),
                    attributes["stopped"],
                )
            )
        return found


def _logs(method: str, sequence: str, row: Row, printed: Printed) -> dict[tuple[str, str, str], float]:
    """Return ln(ours / printed) of the numbers of a row."""
    found = {}
    for metric in NUMBERS:
        ours = row.result.get(metric) if row.status == "done" else None
        log = float(np.log(ours / printed[method, sequence, metric])) if ours else FAILED
        found[method, sequence, metric] = min(max(log, -FAILED), FAILED)
    return found


def _distance(logs: Any) -> float:
    """Return the root mean square: the distance of `table2.distance`."""
    return float(np.sqrt(np.mean(np.square(list(logs)))))


@contextmanager
def _quiet() -> Any:
    """Keep Optuna's remarks about experimental features to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
