"""Proposals of configurations: by samplers of Optuna, and by steps from the best ones to their neighbours."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np

from fracbench.errors import InputError
from fracbench.studies.protocol_search.records import rms
from fracbench.studies.protocol_search.space import Settings, Stage, Switch, Values

_POPULATION = 50
#: Trials at random before TPE has a model.
_RANDOM = 100

Logs = Mapping[tuple[str, str, str], float]


class Proposals(Protocol):
    """Configurations to try; what came of a batch is told before the next one is asked for."""

    def ask(self, first: int, count: int) -> list[dict[str, Any]]:
        """Return the values of `count` configurations, of which the first is trial `first`."""
        ...

    def tell(self, logs: Sequence[Logs], stopped: Sequence[bool]) -> None:
        """Take ln(ours / printed) of the configurations of the batch, and whether they ended early."""
        ...


def proposals(settings: Settings, stage: Stage, sampler: str, seed: int, best: Sequence[Values]) -> Proposals:
    """Return the proposals of a stage by a sampler; `best` are the best values of the stage before."""
    given = [dict(values) for values in best[: stage.given]] if stage.given else []
    if stage.given and not given:
        raise InputError(f"stage {stage.name}: no configuration of the stage before ran to its end")
    begin = [settings.whole(values, f"stage {stage.name}") for values in stage.begin]
    begin = [] if stage.given else [*begin, *(dict(values) for values in best)]
    switches = settings.searched(stage)
    if sampler == "neighbours":
        return _Neighbours(switches, begin, seed)
    return _Sampled(switches, stage.methods, given, begin[: settings.batch], sampler, seed)


class _Sampled:
    """Optuna's proposals. A sampler is made anew for each batch, with a seed of its own."""

    def __init__(
        self,
        switches: Sequence[Switch],
        methods: Sequence[str],
        given: Sequence[Values],
        begin: Sequence[Values],
        sampler: str,
        seed: int,
    ) -> None:
        require_optuna()
        import optuna

        self._switches, self._methods, self._given, self._begin = switches, methods, given, begin
        self._sampler, self._seed = sampler, seed
        self._asked: list[Any] = []
        with _quiet():
            self._study = optuna.create_study(directions=["minimize"] * (2 if sampler == "nsga2" else 1))

    def ask(self, first: int, count: int) -> list[dict[str, Any]]:
        """Return configurations; see `Proposals`."""
        with _quiet():
            self._study.sampler = self._make_sampler(first)
            if first == 0:
                for values in self._begin:
                    self._study.enqueue_trial(self._as_asked(values))
            distributions = self._distributions()
            self._asked = [self._study.ask(distributions) for _ in range(count)]
        return [self._values(trial.params) for trial in self._asked]

    def tell(self, logs: Sequence[Logs], stopped: Sequence[bool]) -> None:
        """Take what came of them; see `Proposals`."""
        for trial, found in zip(self._asked, logs, strict=True):
            self._study.tell(trial, self._objectives(found))

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

    def _objectives(self, logs: Logs) -> list[float]:
        """Return the distance, or two for NSGA-II: of each method, or of angular and end-point errors."""
        whole = rms(logs.values())
        if self._sampler != "nsga2":
            return [whole]
        by_method = len(self._methods) > 1
        parts: list[list[float]] = [[], []]
        for (method, _, metric), log in logs.items():
            second = method != self._methods[0] if by_method else metric == "aepe"
            parts[second].append(log)
        return [rms(part) if part else whole for part in parts]


class _Neighbours:
    """Steps from the best configurations so far: each of its switches, one at a time, is given each other value.

    The study begins at the configuration of rank `seed` among the best, from 1. When all neighbours of one have
    been tried, the nearest to the printed table that has not been left yet is next.
    """

    def __init__(self, switches: Sequence[Switch], begin: Sequence[Values], seed: int) -> None:
        if not begin:
            raise InputError("neighbours need configurations to begin with")
        self._switches = switches
        self._asked: list[dict[str, Any]] = []
        self._whole: list[tuple[float, int, dict[str, Any]]] = []
        self._rng = np.random.default_rng(seed)
        start = _among(switches, begin[min(seed, len(begin)) - 1])
        self._known = {_text(start)}
        self._waiting = [start, *self._around(start)]

    def ask(self, first: int, count: int) -> list[dict[str, Any]]:
        """Return configurations; see `Proposals`. Where no neighbours are left, old ones are repeated."""
        while len(self._waiting) < count and self._whole:
            self._whole.sort(key=lambda item: item[:2])
            self._waiting += self._around(self._whole.pop(0)[2])
        self._asked = self._waiting[:count] or self._asked[:1]
        self._asked += self._asked[:1] * (count - len(self._asked))
        del self._waiting[:count]
        return list(self._asked)

    def tell(self, logs: Sequence[Logs], stopped: Sequence[bool]) -> None:
        """Take what came of them; see `Proposals`."""
        for values, found, ended in zip(self._asked, logs, stopped, strict=True):
            if not ended:
                self._whole.append((rms(found.values()), len(self._known), values))

    def _around(self, values: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the neighbours that have not been asked for, in an order at random."""
        found = []
        for switch in self._switches:
            for value in switch.values:
                near = {**values, switch.name: value}
                if _text(near) not in self._known:
                    self._known.add(_text(near))
                    found.append(near)
        return [found[i] for i in self._rng.permutation(len(found))]


def _among(switches: Sequence[Switch], values: Values) -> dict[str, Any]:
    """Return the values of switches; the first one where the value is not among those that are searched."""
    return {s.name: v if (v := values.get(s.name)) in s.values else s.values[0] for s in switches}


def _text(values: Values) -> str:
    return repr(sorted(values.items()))


def require_optuna() -> None:
    """Refuse to search without Optuna."""
    try:
        import optuna
    except ImportError:
        raise InputError("a search needs Optuna: pip install 'fracbench[search]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)


@contextmanager
def _quiet() -> Any:
    """Keep Optuna's remarks about experimental features to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
