"""What a search tells of switches, of pairs that trade off, of halves of the sequences, and of single numbers.

A question is a set of methods. A configuration of a question is what its methods see of a trial: their own
switches and the shared ones. Two trials that differ in other switches are one configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.studies.protocol_search.proposals import require_optuna
from fracbench.studies.protocol_search.records import NUMBERS, Trial
from fracbench.studies.protocol_search.space import SHARED, Settings, Switch, part_of

if TYPE_CHECKING:
    import pandas as pd

#: The best configurations: this share of all that were tried.
BEST = 0.01
#: A value cannot be excluded if a run with it is at most this many times as far from the table as the best.
OPEN = 1.1
#: A value is told if all runs with another one are at least this many times as far.
TOLD = 1.25
#: A printed number is met by a run within this share of it.
MET = 0.05


@dataclass(frozen=True)
class Question:
    """The configurations of some methods: places of the switches' values, distances, and logarithms.

    `places` (n, switches) are -1 where a stage did not search the switch; `logs` (n, numbers) are NaN for numbers
    that were not computed. Whole configurations have all of them, and `distances` of the others are those of a
    part.
    """

    methods: tuple[str, ...]
    switches: tuple[Switch, ...]
    numbers: tuple[tuple[str, str, str], ...]
    places: np.ndarray[Any, Any]
    logs: np.ndarray[Any, Any]

    @cached_property
    def whole(self) -> np.ndarray[Any, Any]:
        """True for the configurations that have all numbers."""
        return np.isfinite(self.logs).all(axis=1)

    @cached_property
    def distances(self) -> np.ndarray[Any, Any]:
        """The distances to the printed table."""
        return np.asarray(np.sqrt(np.nanmean(np.square(self.logs), axis=1)))

    @cached_property
    def order(self) -> np.ndarray[Any, Any]:
        """The whole configurations, the nearest first."""
        nearest = np.argsort(np.where(self.whole, self.distances, np.inf), kind="stable")
        return np.asarray(nearest[: int(self.whole.sum())])

    @cached_property
    def best(self) -> np.ndarray[Any, Any]:
        """The best of all configurations that were tried: a share of `BEST`, at least one."""
        return np.asarray(self.order[: max(1, math.ceil(BEST * len(self.places)))])

    @cached_property
    def least(self) -> float:
        """The least distance."""
        return float(self.distances[self.order[0]])

    def value(self, row: int, switch: int) -> Any:
        """Return the value of a switch in a configuration."""
        return self.switches[switch].values[self.places[row, switch]]

    def values(self, row: int) -> dict[str, Any]:
        """Return the values of all switches in a configuration."""
        return {switch.name: self.value(row, i) for i, switch in enumerate(self.switches)}

    def row_of(self, values: Mapping[str, Any]) -> int | None:
        """Return the whole configuration with these values of the switches, None if there is none."""
        wanted = [s.values.index(v) if (v := values[s.name]) in s.values else -2 for s in self.switches]
        rows = np.flatnonzero(self.whole & (self.places == wanted).all(axis=1))
        return int(rows[0]) if len(rows) else None

    def forced(self, switch: int, place: int) -> float:
        """Return the least distance with a switch at a value, infinite if no whole configuration has it."""
        mine = self.distances[self.whole & (self.places[:, switch] == place)]
        return float(mine.min()) if len(mine) else math.inf


def question(trials: Sequence[Trial], settings: Settings, methods: Sequence[str]) -> Question:
    """Return the distinct configurations of methods, those that were computed furthest where trials agree."""
    switches = tuple(s for s in settings.switches if part_of(s.name) in (SHARED, *methods) and len(s.values) > 1)
    places = [{repr(value): i for i, value in enumerate(switch.values)} for switch in switches]
    numbers = tuple((m, name, number) for name, m in settings.order(methods) for number in NUMBERS)
    found: dict[tuple[int, ...], np.ndarray[Any, Any]] = {}
    for trial in trials:
        if not set(methods) <= set(trial.stage.split("+")):
            # The shared switches of a method that was held fixed say nothing new about it.
            continue
        key = tuple(
            at[repr(trial.values[switch.name])] if switch.name in trial.values else -1
            for switch, at in zip(switches, places, strict=True)
        )
        logs = np.array([trial.logs.get(number, np.nan) for number in numbers])
        if np.isnan(logs).all():
            continue
        if key not in found or np.isnan(found[key]).sum() > np.isnan(logs).sum():
            found[key] = logs
    if not found:
        return Question(
            tuple(methods), switches, numbers, np.empty((0, len(switches)), int), np.empty((0, len(numbers)))
        )
    return Question(tuple(methods), switches, numbers, np.array(list(found)), np.array(list(found.values())))


def importances(asked: Question) -> dict[str, float]:
    """Return the importance of each switch for being among the nearest tenth, by Optuna's PED-ANOVA; sum 1."""
    require_optuna()
    import optuna

    if len(asked.places) < 2:
        return {switch.name: math.nan for switch in asked.switches}
    distributions = {
        switch.name: optuna.distributions.CategoricalDistribution(list(range(len(switch.values))))
        for switch in asked.switches
    }
    study = optuna.create_study()
    for row, distance in zip(asked.places.tolist(), asked.distances.tolist(), strict=True):
        params = {switch.name: place for switch, place in zip(asked.switches, row, strict=True) if place >= 0}
        mine: dict[str, Any] = {name: distributions[name] for name in params}
        study.add_trial(optuna.create_trial(params=params, distributions=mine, value=distance))
    evaluator = optuna.importance.PedAnovaImportanceEvaluator(target_quantile=0.1)
    names = [switch.name for i, switch in enumerate(asked.switches) if (asked.places[:, i] >= 0).all()]
    found = optuna.importance.get_param_importances(study, evaluator=evaluator, params=names)
    return {switch.name: float(found.get(switch.name, math.nan)) for switch in asked.switches}


def value_table(asked: Question) -> pd.DataFrame:
    """Return a row for each value of each switch: its shares, and the least distance with it."""
    import pandas as pd

    records = []
    for i, switch in enumerate(asked.switches):
        best, tried = asked.places[asked.best, i], asked.places[:, i]
        for place, value in enumerate(switch.values):
            records.append(
                {
                    "switch": switch.name,
                    "value": word(value),
                    "share of best": float((best == place).mean()),
                    "share of tried": float((tried == place).mean()),
                    "tried": int((tried == place).sum()),
                    "least distance": asked.forced(i, place),
                }
            )
    return pd.DataFrame(records)


def switch_table(asked: Question) -> pd.DataFrame:
    """Return a row for each switch: importance, the best value, those that cannot be excluded, and what is told.

    A switch is ``told`` if every run with another value is at least `TOLD` times as far as the best, ``open`` if a
    run with another value is at most `OPEN` times as far, else ``likely``. Of an open switch, the values whose
    runs are farther are excluded.
    """
    import pandas as pd

    weights, records = importances(asked), []
    for i, switch in enumerate(asked.switches):
        at = int(asked.places[asked.order[0], i])
        forced = [asked.forced(i, place) for place in range(len(switch.values))]
        others = [distance for place, distance in enumerate(forced) if place != at]
        nearest = min(others)
        open_values = [word(v) for v, d in zip(switch.values, forced, strict=True) if d <= OPEN * asked.least]
        told = "told" if nearest >= TOLD * asked.least else "open" if len(open_values) > 1 else "likely"
        share = float((asked.places[asked.best, i] == at).mean())
        records.append(
            {
                "switch": switch.name,
                "best value": word(switch.values[at]),
                "share of best": share,
                "importance": weights[switch.name],
                "least distance with another": nearest,
                "not excluded": ", ".join(open_values),
                "excluded": len(switch.values) - len(open_values),
                "verdict": told,
            }
        )
    table = pd.DataFrame(records)
    return table.sort_values("importance", ascending=False, kind="stable", ignore_index=True)


def pair_table(asked: Question, most: int = 12) -> pd.DataFrame:
    """Return the pairs of switches that trade off: if one is changed, the other has to be as well.

    The best run has the values a and b. With a' and b the least distance is D1, with a and b' it is D2, and with
    a' and b' it is D. A pair trades off where D is at most `TOLD` times the best and min(D1, D2) is larger than D;
    the gain is ln(min(D1, D2) / D). Pairs for which no run has a' and b, or a and b', say nothing.
    """
    import pandas as pd

    columns = ["switch", "value", "other switch", "other value", "first alone", "other alone", "both", "gain"]
    if not len(asked.order):
        return pd.DataFrame(columns=columns)
    places, distances = asked.places[asked.order], asked.distances[asked.order]
    start = places[0]
    records = []
    for i, j in combinations(range(len(asked.switches)), 2):
        grid = np.full((len(asked.switches[i].values), len(asked.switches[j].values)), np.inf)
        known = (places[:, i] >= 0) & (places[:, j] >= 0)
        np.minimum.at(grid, (places[known, i], places[known, j]), distances[known])
        alone = np.minimum(grid[:, [start[j]]], grid[[start[i]], :])
        both = np.isfinite(grid[:, [start[j]]]) & np.isfinite(grid[[start[i]], :])
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.where(both & (grid <= TOLD * asked.least), np.log(alone / grid), -np.inf)
        gain[start[i], :] = gain[:, start[j]] = -np.inf
        x, y = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[x, y] > 0.0:
            one, other = asked.switches[i], asked.switches[j]
            named = [one.name, word(one.values[x]), other.name, word(other.values[y])]
            numbers = [grid[x, start[j]], grid[start[i], y], grid[x, y], gain[x, y]]
            records.append(dict(zip(columns, [*named, *map(float, numbers)], strict=True)))
    table = pd.DataFrame(records, columns=columns).sort_values("gain", ascending=False, kind="stable")
    return table.head(most).reset_index(drop=True)


def half_table(asked: Question, names: Sequence[str], grid: Mapping[str, Any]) -> pd.DataFrame:
    """Return the distance on one half of the sequences of the run that is best on the other, for all halves.

    The first row is the first half of the sequences `names`, the last row the other half. `grid` are the values of
    the search's grid: its run, which no half has chosen, is measured on the same sequences.
    """
    import pandas as pd

    logs, usual = asked.logs[asked.order], asked.row_of(grid)
    of = np.array([names.index(name) for _, name, _ in asked.numbers])
    squares = np.array([np.square(logs[:, of == i]).mean(axis=1) for i in range(len(names))])
    records = []
    for half in combinations(range(len(names)), len(names) // 2) if len(names) > 1 else ():
        rest = [i for i in range(len(names)) if i not in half]
        here, there = (np.sqrt(squares[list(part)].mean(axis=0)) for part in (half, rest))
        chosen = int(here.argmin())
        mine = [] if usual is None else np.square(asked.logs[usual])[np.isin(of, rest)]
        records.append(
            {
                "chosen on": ", ".join(names[i] for i in half),
                "distance there": float(here[chosen]),
                "distance on the others": float(there[chosen]),
                "least on the others": float(there.min()),
                "grid's run on the others": float(np.sqrt(np.mean(mine))) if len(mine) else math.nan,
                "ratio": float(there[chosen] / here[chosen]),
            }
        )
    return pd.DataFrame(records)


def number_table(asked: Question, printed: Any) -> pd.DataFrame:
    """Return a row for each printed number: the best run's, the range in the best runs, and the floor of all runs.

    The floor is the smallest ratio of ours to the printed number, or its inverse, in any whole run. A number is
    explained if one of the best runs meets it within `MET`.
    """
    import pandas as pd

    records = []
    for i, (method, name, number) in enumerate(asked.numbers):
        best, every = asked.logs[asked.best, i], asked.logs[asked.order, i]
        theirs = float(printed[method, name, number])
        records.append(
            {
                "sequence": name,
                "method": method,
                "metric": number,
                "printed": theirs,
                "best run": theirs * math.exp(asked.logs[asked.order[0], i]),
                "ratio": math.exp(asked.logs[asked.order[0], i]),
                "least ratio of best": math.exp(best.min()),
                "largest ratio of best": math.exp(best.max()),
                "floor": math.exp(np.abs(every).min()),
                "explained": bool((np.abs(best) <= math.log(1.0 + MET)).any()),
            }
        )
    return pd.DataFrame(records)


def word(value: Any) -> str:
    """Return a value as in a command."""
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
