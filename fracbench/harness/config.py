"""Typed configuration: Hydra composes the groups under ``conf/``, the records here check them.

Hydra is asked for one composition per choice of groups; the values of a grid are applied to the typed
record in plain Python, because composing costs tens of milliseconds and a grid may have thousands of points.
"""

from __future__ import annotations

import dataclasses
import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from fracbench.data.regions import Region
from fracbench.errors import InputError, unknown_name
from fracbench.harness.assets import asset
from fracbench.methods.registry import Method, get_method
from fracbench.model.params import FlowParams

T = TypeVar("T")

GROUPS = ("method", "sequence", "region", "protocol", "parallel")
BACKENDS = ("loky", "dask")
DATASETS = ("auto", "middlebury", "synthetic")
PARALLEL = ("parallel.jobs", "parallel.timeout", "parallel.address")
#: Keys of the command line that are neither groups nor parameters.
SETTINGS = ("dataset", "context", "shift", "paths.data", "paths.results", *PARALLEL)
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
    """How points are spread over processes.

    Attributes
    ----------
    backend : {"loky", "dask"}
        Processes of joblib on this machine, or the workers of a Dask cluster.
    jobs : int
        Processes on this machine.
    timeout : float or None
        Seconds that the estimate of a point may take.
    address : str or None
        Of the Dask scheduler.
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
            raise InputError(f"parallel.address must be like tcp://HOST:8786, got {self.address!r}")
        if self.backend != "dask":
            raise InputError(f"parallel.address={self.address} needs parallel=dask")

    def override(self, key: str, value: str) -> ParallelConfig:
        """Return a copy with one of `PARALLEL` changed."""
        given: Any = None if value == "null" else value
        if key == "parallel.jobs":
            given = _whole(key, value)
        elif key == "parallel.timeout" and given is not None:
            given = _seconds(key, value)
        return dataclasses.replace(self, **{key.removeprefix("parallel."): given})


@dataclass(frozen=True)
class RunConfig:
    """Everything that one choice of groups and settings determines.

    Raises
    ------
    InputError
        A value that is not allowed.
    """

    method: Method
    protocol: str
    sequence: SequenceConfig
    region: Region | None
    params: FlowParams
    parallel: ParallelConfig
    dataset: str = "auto"
    context: int = 0
    shift: int | None = None
    data: str | None = None
    results: Path = Path("results")

    def __post_init__(self) -> None:
        if self.dataset not in DATASETS:
            raise unknown_name("dataset", self.dataset, DATASETS)
        if self.context < 0:
            raise InputError(f"context must be at least 0 pixels, got {self.context}")
        if self.shift is not None and not 0 <= self.shift < N_SHIFTS:
            raise InputError(f"shift must be in 0..{N_SHIFTS - 1}, got {self.shift}")
        if self.region is None and (self.context > 0 or self.shift is not None):
            given = f"context={self.context}" if self.context else f"shift={self.shift}"
            raise InputError(f"{given} needs a region: without one the whole frame is used")

    def override(self, values: Mapping[str, str]) -> RunConfig:
        """Return a copy with parameters and settings changed.

        Parameters
        ----------
        values : mapping of str to str
            By command-line key; groups are not among them.

        Returns
        -------
        RunConfig
            A new record.

        Raises
        ------
        InputError
            An unknown key or a value that is not allowed.
        """
        changes: dict[str, Any] = {}
        params = {}
        for key, value in values.items():
            if key not in SETTINGS:
                params[key.removeprefix("params.")] = value
            elif key in PARALLEL:
                changes["parallel"] = changes.get("parallel", self.parallel).override(key, value)
            elif key in ("context", "shift"):
                changes[key] = None if key == "shift" and value == "null" else _whole(key, value)
            else:
                changes[key.rpartition(".")[2]] = Path(value) if key == "paths.results" else value
        return dataclasses.replace(self, params=self.params.replace(params), **changes)


def _whole(key: str, value: Any) -> int:
    try:
        return int(str(value))
    except ValueError:
        raise InputError(f"`{key}` must be a whole number, got {value!r}") from None


def _seconds(key: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"`{key}` must be a number of seconds, got {value!r}") from None


def group_options(group: str) -> list[str]:
    """Return the names there are in a configuration group.

    Parameters
    ----------
    group : str
        One of `GROUPS`.

    Returns
    -------
    list of str
        Sorted; regions without ``none``.
    """
    names = sorted(path.stem for path in asset(f"conf/{group}").glob("*.yaml"))
    return [name for name in names if name != "none"]


def known_keys() -> list[str]:
    """Return every key that an override may name."""
    return [*GROUPS, *SETTINGS, *FlowParams.names()]


def load_config(choices: Mapping[str, str]) -> RunConfig:
    """Compose and check the configuration for a choice of groups.

    Parameters
    ----------
    choices : mapping
        Group -> name; groups left out take the default of ``conf/config.yaml``.

    Returns
    -------
    RunConfig
        Typed and validated.

    Raises
    ------
    InputError
        An unknown name (the nearest is offered), an unknown key or a wrong value in a file.
    """
    for group, name in choices.items():
        if name not in (options := group_options(group)) and not (group == "region" and name == "none"):
            raise unknown_name(group, name, options)
    return _typed(_compose(tuple(sorted(choices.items()))))


@lru_cache(maxsize=256)
def _compose(choices: tuple[tuple[str, str], ...]) -> dict[str, Any]:
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    names = dict(choices)
    region = names.pop("region", None)
    sequence = names.pop("sequence", None)
    overrides = [f"{group}={name}" for group, name in names.items()]
    if region not in (None, "none"):
        overrides.append(f"region={region}")  # the region's file chooses its sequence
    elif sequence is not None:
        overrides.append(f"sequence={sequence}")
    folder = asset("conf").resolve()
    try:
        with warnings.catch_warnings(), initialize_config_dir(str(folder), version_base="1.3"):
            warnings.simplefilter("ignore")
            composed = compose("config", overrides=overrides)
        raw: dict[str, Any] = OmegaConf.to_container(composed, resolve=True)  # type: ignore[assignment]
    except (HydraException, OmegaConfBaseException, YAMLError) as exc:
        raise InputError(f"configuration {folder}: {' '.join(str(exc).split())}") from exc
    if region not in (None, "none") and sequence not in (None, raw["region"]["sequence"]):
        raise InputError(f"region={region} belongs to sequence={raw['region']['sequence']}, not to {sequence}")
    raw["sequence"]["key"] = raw["region"]["sequence"] if raw["region"] else (sequence or _default("sequence"))
    return raw


def _default(group: str) -> str:
    from omegaconf import OmegaConf

    defaults: Any = OmegaConf.load(asset("conf/config.yaml"))
    for entry in defaults["defaults"]:
        if not isinstance(entry, str) and group in entry:
            return str(entry[group])
    raise InputError(f"conf/config.yaml: no default for the group {group!r}")


_TOP_LEVEL = {
    "method",
    "protocol",
    "sequence",
    "region",
    "parallel",
    "dataset",
    "context",
    "shift",
    "paths",
    "params",
}


def _typed(raw: Mapping[str, Any]) -> RunConfig:
    where = "configuration"
    for key in raw:
        if key not in _TOP_LEVEL:
            raise unknown_name("key", str(key), _TOP_LEVEL, where)
    for key in raw["paths"]:
        if key not in ("data", "results"):
            raise unknown_name("key", str(key), ("data", "results"), f"{where}, paths")
    method = get_method(raw["method"])
    params = FlowParams().replace(method.defaults).replace(raw["params"], f"{where}, params")
    return RunConfig(
        method=method,
        protocol=str(raw["protocol"]),
        sequence=_record(SequenceConfig, raw["sequence"], f"{where}, sequence"),
        region=None if raw["region"] is None else _record(Region, raw["region"], f"{where}, region"),
        params=params,
        parallel=_record(ParallelConfig, raw["parallel"], f"{where}, parallel"),
        dataset=raw["dataset"],
        context=_whole("context", raw["context"]),
        shift=None if raw["shift"] is None else _whole("shift", raw["shift"]),
        data=raw["paths"]["data"],
        results=Path(raw["paths"]["results"]),
    )


def _record(kind: type[T], raw: Mapping[str, Any], where: str) -> T:
    fields = {f.name for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in raw:
        if key not in fields:
            raise unknown_name("key", str(key), fields, where)
    try:
        return kind(**raw)
    except TypeError as exc:
        raise InputError(f"{where}: {exc}") from exc
