"""Typed configuration: Hydra composes the groups under ``conf/``, the records here check them.

Hydra is asked for one composition per choice of groups; the values of a grid are applied to the typed
record in plain Python, because composing costs tens of milliseconds and a grid may have thousands of points.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from fracbench.data.datasets.registry import AUTO, dataset_names, get_dataset, is_fixed, match_sequence, shape_of
from fracbench.data.regions import Region, require_inside
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config import working_folder
from fracbench.harness.config.composition_cache import cached_composition
from fracbench.harness.config.paths import asset
from fracbench.harness.config.records import mapping, read_plain, record, refuse_code, require_name
from fracbench.methods.method import Method
from fracbench.methods.registry import DEFAULT_METHOD, get_method, method_names
from fracbench.model.params import FlowParams

GROUPS = ("method", "sequence", "region", "protocol", "parallel")
BACKENDS = ("loky", "dask")
PARALLEL = ("parallel.jobs", "parallel.timeout", "parallel.address")
#: Numbers of rendered particle images, beside noise and seed.
SCENE = ("density", "diameter", "lost", "background", "displacement", "slope")
#: Keys of the command line that are neither groups nor parameters.
SETTINGS = (
    "dataset", "context", "shift", "score", "margin", "noise", "seed", *SCENE, "paths.data", "paths.results",
    *PARALLEL,
)  # fmt: skip
_WHOLE = ("context", "shift", "margin", "seed")
SCORES = ("frame", "structure", "fluid", "unknown_as_zero")
N_SHIFTS = 25

_ADDRESS = re.compile(r"(tcp|tls|ucx|wss?)://[^\s/]+:\d{1,5}")


@dataclass(frozen=True)
class SequenceConfig:
    """A sequence: its configuration's name, the data's name, and the scene that may stand in for it."""

    key: str
    name: str
    dataset: str
    stand_in: str | None = None


@dataclass(frozen=True)
class ParallelConfig:
    """How points are spread over processes: those of joblib on this machine, or the workers of a Dask cluster.

    `timeout` is the number of seconds that the estimate of a point may take; `address` is that of the scheduler.
    """

    backend: str = "loky"
    jobs: int = 2
    timeout: float | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise unknown_name("parallel backend", self.backend, BACKENDS)
        if self.jobs < 1:
            raise InputError(f"parallel.jobs must be at least 1, got {self.jobs}")
        if self.timeout is not None and not 0.0 < self.timeout < math.inf:
            raise InputError(f"parallel.timeout must be a number of seconds above 0, got {self.timeout:g}")
        if self.address is None:
            return
        if not _ADDRESS.fullmatch(self.address):
            whole = f"tcp://{self.address}"
            hint = f": did you mean {whole}?" if _ADDRESS.fullmatch(whole) else ""
            raise InputError(f"parallel.address must be like tcp://HOST:8786, got {self.address!r}{hint}")
        if self.backend != "dask":
            raise InputError(f"parallel.address={self.address} needs parallel=dask")

    def override(self, key: str, value: str) -> ParallelConfig:
        """Return a copy with one of `PARALLEL` changed."""
        given: Any = None if value == "null" else value
        if key == "parallel.jobs":
            given = _whole(key, value)
        elif key == "parallel.timeout" and given is not None:
            given = _number(key, value, "a number of seconds")
        return dataclasses.replace(self, **{key.removeprefix("parallel."): given})


@dataclass(frozen=True)
class RunConfig:
    """Everything that one choice of groups and settings determines."""

    method: Method
    protocol: str
    sequence: SequenceConfig
    region: Region | None
    params: Any  # FlowParams, or the dataclass of the method
    parallel: ParallelConfig
    dataset: str = AUTO
    context: int = 0
    shift: int | None = None
    score: str = "frame"
    margin: int | None = None
    noise: float | None = None
    seed: int | None = None
    scene: Mapping[str, float] = dataclasses.field(default_factory=dict)  # those of `SCENE` that are set
    data: str | None = None
    results: Path = Path("results")

    def __post_init__(self) -> None:
        if self.dataset != AUTO and self.dataset not in (names := dataset_names()):
            raise unknown_name("dataset", self.dataset, (AUTO, *names))
        if self.context < 0:
            raise InputError(f"context must be at least 0 pixels, got {self.context}")
        if self.shift is not None and not 0 <= self.shift < N_SHIFTS:
            raise InputError(f"shift must be in 0..{N_SHIFTS - 1}, got {self.shift}")
        if self.region is None and (self.context > 0 or self.shift is not None):
            given = f"context={self.context}" if self.context else f"shift={self.shift}"
            raise InputError(f"{given} needs a region: without one the whole frame is used")
        if self.score not in SCORES:
            raise unknown_name("score", self.score, SCORES)
        self._check_scene()

    def _check_scene(self) -> None:
        """Refuse settings that only whole frames, or only rendered scenes, can have."""
        given = {"margin": self.margin, "noise": self.noise, "seed": self.seed, **self.scene}
        for name, value in given.items():
            if value is None:
                continue
            if not 0 <= value < math.inf:
                raise InputError(f"{name} must be finite and at least 0, got {value:g}")
            if name != "margin" and name not in get_dataset(self.sequence.dataset).settings:
                kind = "dataset=particles" if name in SCENE else "a rendered scene"
                raise InputError(f"{name}={value:g} needs {kind}, sequence={self.sequence.key} is none")
        if self.margin is not None and self.region is not None:
            raise InputError(f"margin={self.margin} is of whole frames; a region takes context")

    def override(self, values: Mapping[str, str]) -> RunConfig:
        """Return a copy with parameters and settings changed, by command-line key; groups are not among them."""
        changes: dict[str, Any] = {}
        params = {}
        for key, value in values.items():
            if key not in SETTINGS:
                params[key.removeprefix("params.")] = value
            elif key in PARALLEL:
                changes["parallel"] = changes.get("parallel", self.parallel).override(key, value)
            elif key in _WHOLE:
                changes[key] = None if key != "context" and value == "null" else _whole(key, value)
            elif key == "noise":
                changes[key] = None if value == "null" else _number(key, value)
            elif key in SCENE:
                if value != "null":
                    changes["scene"] = {**changes.get("scene", self.scene), key: _number(key, value)}
            else:
                changes[key.rpartition(".")[2]] = Path(value) if key == "paths.results" else value
        return dataclasses.replace(self, params=self.method.replace(self.params, params), **changes)


def _whole(key: str, value: Any) -> int:
    try:
        return int(str(value))
    except ValueError:
        raise InputError(f"`{key}` must be a whole number, got {value!r}") from None


def _number(key: str, value: Any, what: str = "a number") -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"`{key}` must be {what}, got {value!r}") from None


def group_options(group: str, *, own: bool = True) -> list[str]:
    """Return the names in a configuration group, sorted; regions without ``none``.

    Those of ``conf/`` in the working folder are among them if `own`.
    """
    if group == "method":
        return method_names()
    names = {path.stem for path in asset(f"conf/{group}").glob("*.yaml")}
    if own:
        names |= working_folder.own_names(own_files(), group)
    return sorted(names - {"none"})


def own_files() -> working_folder.Files:
    """Return the files of ``conf/`` in the working folder."""
    return working_folder.own_files(asset("conf"))


def protocol_settings(name: str) -> tuple[str, dict[str, Any]]:
    """Return the method's name and the parameters of a protocol, without those of any sequence."""
    config = load_config({"protocol": name})  # it refuses a file that is no protocol
    return config.method.name, _composed({"protocol": name, "sequence": "none"})["params"]


def known_keys(methods: Iterable[Method] = ()) -> list[str]:
    """Return every key that an override may name; parameters are those of our methods and of the given ones."""
    own = [name for method in methods for name in method.names]
    return [*dict.fromkeys([*GROUPS, *SETTINGS, *FlowParams.names(), *own])]


def load_config(choices: Mapping[str, str], pair: SequenceConfig | None = None) -> RunConfig:
    """Compose and check the configuration for a choice of groups.

    Groups left out take the default of ``conf/config.yaml``. A `pair` is a sequence without a
    file there: its parameters are the protocol's.
    """
    for group, name in choices.items():
        if name not in (options := group_options(group)) and not (group == "region" and name == "none"):
            raise unknown_name(group, name, options)
    if pair is not None:
        raw = _composed({**choices, "sequence": "none"})
        return _typed({**raw, "sequence": None}, choices, pair)
    return _typed(_composed(choices), choices)


def _composed(choices: Mapping[str, str]) -> dict[str, Any]:
    return _compose(tuple(sorted(choices.items())), own_files())


@lru_cache(maxsize=256)
def _compose(choices: tuple[tuple[str, str], ...], own: working_folder.Files) -> dict[str, Any]:
    names = dict(choices)
    names.pop("method", None)  # a method is a word of the configuration, not a group: the registry knows it
    region = names.pop("region", "none")
    sequence = names.pop("sequence", None)
    overrides = [f"{group}={name}" for group, name in names.items()]
    if region != "none":
        overrides.append(f"region={region}")  # the region's file chooses its sequence
    elif sequence == "none":
        overrides.append("~sequence")
    elif sequence is not None:
        overrides.append(f"sequence={sequence}")
    folder = asset("conf").resolve()
    working_folder.check(own, folder)
    files = [*sorted(folder.rglob("*.yaml")), *(path for path, *_ in own)]
    raw = cached_composition(files, choices, lambda: _by_hydra(folder, overrides, own))
    return mapping(raw, f"configuration {folder}")


def _by_hydra(folder: Path, overrides: list[str], own: working_folder.Files) -> Any:
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    refuse_code(folder)
    try:
        with initialize_config_dir(str(folder), version_base="1.3"):
            composed = compose("config", overrides=[*overrides, *working_folder.search_path(own)])
        return OmegaConf.to_container(composed, resolve=True)
    except Exception as exc:  # Hydra lets nearly any exception through on a file it does not expect
        why = " ".join(str(exc).split()) or type(exc).__name__
        raise InputError(f"configuration {folder}: {why}") from exc


def _default_sequence() -> str:
    defaults = read_plain(asset("conf/config.yaml"))["defaults"]
    return next(str(entry["sequence"]) for entry in defaults if "sequence" in entry)


_TOP_LEVEL = (
    "method", "protocol", "sequence", "region", "parallel", "dataset", "context", "shift", "score", "margin",
    "noise", "seed", "paths", "params",
)  # fmt: skip


def _typed(raw: Mapping[str, Any], choices: Mapping[str, str], pair: SequenceConfig | None = None) -> RunConfig:
    chosen = ", ".join(f"{group}={name}" for group, name in choices.items())
    where = f"configuration ({chosen})" if chosen else "configuration"
    raw = {"method": DEFAULT_METHOD, **mapping(raw, where, _TOP_LEVEL)}
    for key in _TOP_LEVEL:
        if key not in raw:
            raise InputError(f"{where}: `{key}` is missing; conf/config.yaml or a file of a group sets it")
    paths = record(_Paths, raw["paths"], f"{where}, paths")
    # a protocol may name a method, but the one that is asked for wins
    method = get_method(require_name(choices.get("method", raw["method"]), "`method`", where))
    region = None if raw["region"] is None else record(Region, raw["region"], f"{where}, region")
    protocol = require_name(raw["protocol"], "`protocol`", where)
    sequence = pair or _sequence(raw["sequence"], region, choices, where)
    for group, name in (("protocol", protocol), ("region", region.name if region else "none")):
        if name != choices.get(group, name):
            raise InputError(f"{where}: the file {choices[group]}.yaml must give the same name, not {name!r}")
    optional = [key for key in ("shift", "margin", "seed") if raw[key] is not None]
    whole: dict[str, Any] = {key: _whole(key, raw[key]) for key in optional}
    return RunConfig(
        method=method,
        protocol=protocol,
        sequence=sequence,
        region=region,
        params=_params(method, raw, choices, f"{where}, params"),
        parallel=record(ParallelConfig, raw["parallel"], f"{where}, parallel"),
        dataset=require_name(raw["dataset"], "`dataset`", where),
        context=_whole("context", raw["context"]),
        score=require_name(raw["score"], "`score`", where),
        noise=None if raw["noise"] is None else _number("noise", raw["noise"]),
        data=paths.data,
        results=Path(paths.results),
        **whole,
    )


def _params(method: Method, raw: Mapping[str, Any], choices: Mapping[str, str], where: str) -> Any:
    """Return a method's parameters: those of the files are `FlowParams`, unless the protocol names the method."""
    given = mapping(raw["params"], where)
    if method.params is not FlowParams:
        named = raw["method"] == method.name
        given = _composed({"protocol": choices["protocol"], "sequence": "none"})["params"] if named else {}
    return method.replace(method.start(), given, where)


@dataclass(frozen=True)
class _Paths:
    results: str
    data: str | None = None

    def __post_init__(self) -> None:
        for name, path in vars(self).items():
            if path is not None and (not path or not path.isprintable()):
                raise InputError(f"paths.{name} must name a folder, got {path!r}")


def _sequence(raw: Any, region: Region | None, choices: Mapping[str, str], where: str) -> SequenceConfig:
    """Return the sequence, and make sure that the region is one of it and lies inside its picture."""
    key = region.sequence if region else choices.get("sequence") or _default_sequence()
    sequence = record(SequenceConfig, {"key": key, **mapping(raw, f"{where}, sequence")}, f"{where}, sequence")
    for what, name in vars(sequence).items():
        if name is not None:
            require_name(name, f"`{what}`", f"{where}, sequence")
    get_dataset(sequence.dataset)
    if is_fixed(sequence.dataset):
        match_sequence(sequence.name, sequence.dataset)
    if sequence.stand_in is not None:
        match_sequence(sequence.stand_in, "synthetic")
    if region is None:
        return sequence
    if not is_fixed(sequence.dataset):
        raise InputError(f"{where}: regions belong to Middlebury; dataset {sequence.dataset} has none")
    shape = shape_of(match_sequence(sequence.name, sequence.dataset), sequence.dataset)
    require_name(region.name, "`name`", f"{where}, region")
    if "sequence" in choices and choices["sequence"] != key:
        raise InputError(f"region={choices['region']} belongs to sequence={key}, not to {choices['sequence']}")
    if key not in (options := group_options("sequence")):
        raise unknown_name("sequence", key, options, f"{where}, region")
    if _composed({"sequence": key})["sequence"] != raw:
        raise InputError(f"{where}: the region is of {key!r}, but its defaults choose {sequence.name!r}")
    require_inside(region, shape)
    return sequence
