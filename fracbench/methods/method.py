"""A method: its function, its parameters, and the checks of both."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import time
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from fracbench.entry_points import described
from fracbench.errors import AbsentError, FracbenchError, InputError, unknown_name
from fracbench.model.params import FlowParams, coerce, public_name

if TYPE_CHECKING:
    from fracbench.model.coarse_to_fine import FlowResult

#: Names that a parameter cannot have: keys of the command line, columns of the tables, words of `estimate_flow`.
RESERVED = frozenset({
    "method", "sequence", "region", "protocol", "parallel", "dataset", "context", "shift", "score", "margin",
    "noise", "seed", "density", "diameter", "lost", "background", "displacement", "slope", "paths", "params",
    "part", "aae", "aepe", "sdae", "n_pixels", "n_unknown", "n_nonfinite",
    "iterations", "inner_iterations", "stop", "status", "error", "key", "frame0", "frame1", "trace", "threads",
    "mask", "initial_flow", "color", "confidence",
})  # fmt: skip
#: Further arguments that a method may take.
OPTIONS = frozenset({"mask", "initial_flow", "color"})
_ALL: Any = None
#: Modules that belong to another extra of this project than `peers`.
_EXTRAS = {"openpiv": "piv"}
_NAME = re.compile(r"[A-Za-z]\w{0,79}", re.ASCII)


@dataclass(frozen=True)
class Method:
    """A way to compute flow.

    Attributes
    ----------
    name : str
        Its key in the registry, and the name of its entry point; letters, digits and ``_``.
    label : str
        Its name in tables and legends.
    summary : str
        One line.
    estimate : callable
        Called as ``estimate(frame0, frame1, params)`` with gray frames, (H, W), levels 0..255; returns the flow,
        (2, H, W) in pixels, or a `FlowResult`. A method with `FlowParams` is called with ``trace=True`` as well
        where the energy is asked for.
    params : type
        A frozen dataclass. Each field has a default, and the type bool, int, float, str or Literal, or one of
        them or None. A ``__post_init__`` may raise `ValueError`.
    version : str
        Part of the key of each result: a new version makes all points of the method new.
    uses : frozenset of str
        Parameters in the key of a result, by public name; all of `params` by default.
    defaults : mapping
        Parameters it starts from where they differ from those of `params`.
    younger : mapping
        Parameters that came after results were stored: at the value given here they are no part of a key.
    limits : mapping
        Largest values of `FlowParams` where the method allows less, by public name, each with the reason.
    requires : tuple of str
        Modules of other programs.
    options : frozenset of str
        Further arguments that `estimate` takes by name where they are given: ``mask``, an array of bool, (H, W) or
        (2, H, W), true where a pixel does not count, ``initial_flow``, (2, H, W) in pixels, and ``color``, frame 0
        in colour, (H, W, 3), wherever the data have it.
    frame_dtype : str or None
        Type of the frames that `estimate` gets, which are copies; None: the frames as they are loaded.
    package, release : str
        The distribution that offers the method, and its version; the look-up sets both.
    """

    name: str
    label: str
    summary: str
    estimate: Callable[..., Any]
    params: type[Any] = FlowParams
    version: str = ""
    uses: frozenset[str] = _ALL
    defaults: Mapping[str, Any] = field(default_factory=dict)
    younger: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    requires: tuple[str, ...] = ()
    options: frozenset[str] = frozenset()
    frame_dtype: str | None = "float32"
    package: str = ""
    release: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise InputError(f"a method's name must be letters, digits and _, got {self.name!r}")
        for what in ("label", "summary", "version"):
            text = getattr(self, what)
            if not isinstance(text, str) or not (text.isprintable() and (text or what == "version")):
                raise InputError(f"method {self.name!r}: `{what}` must be one line of text, got {text!r}")
        if not callable(self.estimate):
            raise InputError(f"method {self.name!r}: `estimate` must be a function, got {self.estimate!r}")
        if self.params is not FlowParams:
            _check_params(self.params, f"method {self.name!r}: `params`")
        object.__setattr__(self, "uses", frozenset(self.names if self.uses is _ALL else self.uses))
        object.__setattr__(self, "options", frozenset(self.options))
        for name in self.options - OPTIONS:
            raise unknown_name("option", name, OPTIONS, f"method {self.name!r}")
        for name in self.uses.union(self.younger, self.limits).difference(self.names):
            raise unknown_name("parameter", name, self.names, f"method {self.name!r}")
        if self.limits and self.params is not FlowParams:
            raise InputError(f"method {self.name!r}: `limits` are for the methods with FlowParams")
        self.start()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Its parameters, as configurations and the command line spell them."""
        return tuple(public_name(each.name) for each in dataclasses.fields(self.params))

    @cached_property
    def _used(self) -> list[tuple[str, str]]:
        fields = {public_name(each.name): each.name for each in dataclasses.fields(self.params)}
        return [(name, fields[name]) for name in sorted(self.uses)]

    @property
    def stamp(self) -> str:
        """Package and version, as they enter the key of a result; empty for a method that has neither."""
        return f"{self.package} {self.version}".strip()

    @property
    def origin(self) -> str:
        """The method in a message: with its entry point and package, if it has one."""
        if not self.package:
            return f"method {self.name!r}"
        return f"entry point {self.name!r} of {self.package} {self.release}"

    def start(self) -> Any:
        """Return the parameters that the method starts from."""
        return self.replace(self.params(), self.defaults)

    def restored(self, params: Any) -> Any:
        """Return parameters that came as plain values, by field, as an instance of their class."""
        return self.params(**params) if isinstance(params, Mapping) else params

    def values(self, params: Any) -> dict[str, Any]:
        """Return the values that a result depends on, sorted by public name."""
        return {name: getattr(params, field) for name, field in self._used}

    def replace(self, params: Any, changes: Mapping[str, Any], where: str = "") -> Any:
        """Return a copy of parameters with some values changed.

        Parameters
        ----------
        params : FlowParams or another frozen dataclass
            An instance of the method's `params`.
        changes : mapping
            Values by name; texts are converted to the parameter's type.
        where : str, optional
            The place the values come from, for error messages.

        Raises
        ------
        InputError
            An unknown name, a value of another type, or one that the dataclass refuses.
        """
        if isinstance(params, FlowParams):
            self._check_limits(changes)
            return params.replace(changes, where)
        place = f"{where}: method {self.name!r}" if where else f"method {self.name!r}"
        hints, values = typing.get_type_hints(self.params), {}
        by_name = {public_name(each.name): each.name for each in dataclasses.fields(self.params)}
        for given, value in changes.items():
            name = public_name(given)
            if name not in by_name and not by_name:
                raise InputError(f"{place}: has no parameters, got {given!r}")
            if name not in by_name:
                raise unknown_name("parameter", given, by_name, place)
            try:
                values[by_name[name]] = coerce(name, hints[by_name[name]], value)
            except InputError as exc:
                raise InputError(f"{place}: {exc}") from None
        try:
            return dataclasses.replace(params, **values)
        except Exception as exc:  # of its own __post_init__
            raise InputError(f"{place}: {' '.join(str(exc).split()) or type(exc).__name__}") from exc

    def accepted(self, changes: Mapping[str, str]) -> dict[str, Any]:
        """Return values of `FlowParams` by field, converted and checked as `replace` does."""
        self._check_limits(changes)
        return dict(FlowParams.accepted(name, value) for name, value in changes.items())

    def _check_limits(self, values: Mapping[str, Any]) -> None:
        by_name = {public_name(name): value for name, value in values.items()}
        for name, (high, reason) in self.limits.items():
            value = coerce(name, float | None, by_name.get(name))
            if value is not None and value > high:
                allowed = f"[{FlowParams.info(name).low:g}, {high:g}]"
                raise InputError(f"`{name}` must be in {allowed}, got {value:g}: {reason}")

    def require(self) -> Method:
        """Return the method itself, if all that it needs is installed; else `AbsentError` says how to get it."""
        for module in self.requires:
            if importlib.util.find_spec(module) is None:
                extra = f"pip install 'fracbench[{_EXTRAS.get(module, 'peers')}]'"
                remedy = f"it is not installed ({self.origin})" if self.package else extra
                raise AbsentError(f"method {self.name!r} needs {module}: {remedy}")
        return self

    def compute(self, frame0: Any, frame1: Any, params: Any, *, trace: bool = False, **options: Any) -> FlowResult:
        """Compute the flow between two gray frames, and check it.

        Parameters
        ----------
        frame0, frame1 : ndarray, shape (H, W)
            Gray frames; never changed.
        params : FlowParams, another frozen dataclass, or mapping
            Parameters of the method; a mapping holds the fields of its dataclass.
        trace : bool, optional
            Record the energy after each iteration.
        **options
            Those that the method takes: see `Method`.

        Raises
        ------
        FracbenchError
            An option that the method does not take. The function of a package raises, or returns no flow of the
            frames' size, or one that is not finite.
        """
        import numpy as np

        from fracbench.model.coarse_to_fine import FlowResult

        if trace and self.params is not FlowParams:
            raise InputError(f"method {self.name!r} records no energy: `trace` is for the methods with FlowParams")
        for name in options:
            if name not in self.options:
                raise InputError(f"method {self.name!r} takes no `{name}`")
        params = self.restored(params)
        self._check_limits(fields_of(params))
        if self.frame_dtype is not None:
            frame0, frame1 = np.array(frame0, self.frame_dtype), np.array(frame1, self.frame_dtype)
        shape, started = frame0.shape, time.perf_counter()
        try:
            found = self.estimate(frame0, frame1, params, **options, **({"trace": True} if trace else {}))
        except FracbenchError:
            raise
        except (Exception, SystemExit) as exc:
            if not self.package:
                raise
            raise FracbenchError(f"{self.origin}: raised {described(exc)}") from exc
        if not isinstance(found, FlowResult):
            seconds = {"solving": time.perf_counter() - started}
            return FlowResult(self._checked(found, shape), self.name, params, seconds=seconds)
        if not self.package:
            return found
        return dataclasses.replace(found, flow=self._checked(found.flow, shape), method=self.name, params=params)

    def _checked(self, flow: Any, shape: tuple[int, ...]) -> Any:
        """Return a flow as float32."""
        import numpy as np

        try:
            array = np.asarray(flow)
        except Exception:  # nested lists of unequal lengths, or an array of another library
            array = np.empty(0, object)
        if array.dtype.kind not in "fiu":
            raise FracbenchError(f"{self.origin}: returned {type(flow).__name__}, not an array of numbers")
        if array.shape != (2, *shape):
            raise FracbenchError(f"{self.origin}: returned an array of shape {array.shape}, not {(2, *shape)}")
        with np.errstate(over="ignore"):
            array = np.ascontiguousarray(array, np.float32)
        if n_bad := np.count_nonzero(~np.isfinite(array)):
            raise FracbenchError(f"{self.origin}: {n_bad} of {array.size} values of its flow are NaN or infinite")
        return array


def fields_of(params: Any) -> dict[str, Any]:
    """Return the values of a dataclass by field."""
    return {each.name: getattr(params, each.name) for each in dataclasses.fields(params)}


def _check_params(params: Any, what: str) -> None:
    """Refuse a class whose parameters could not be read, compared or written."""
    if not (isinstance(params, type) and dataclasses.is_dataclass(params)) or issubclass(params, FlowParams):
        raise InputError(f"{what} must be FlowParams or a frozen dataclass of its own, got {params!r}")
    if not params.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise InputError(f"{what} must be a frozen dataclass: write @dataclass(frozen=True)")
    try:
        hints = typing.get_type_hints(params)
    except Exception as exc:
        raise InputError(f"{what}: its annotations cannot be read: {exc}") from exc
    for each in dataclasses.fields(params):
        name = public_name(each.name)
        if name in RESERVED:
            raise InputError(f"{what}: the name {name!r} is taken by a key or a column; choose another")
        if not each.init or (each.default is dataclasses.MISSING and each.default_factory is dataclasses.MISSING):
            raise InputError(f"{what}: {name!r} needs a default value")
        if not _is_simple(hints[each.name]):
            raise InputError(
                f"{what}: {name!r} must be bool, int, float, str or Literal, or one of them or None; "
                f"got {hints[each.name]}"
            )
    try:
        for name, value in fields_of(params()).items():
            coerce(name, hints[name], value)
    except Exception as exc:
        raise InputError(f"{what}: the defaults are refused: {' '.join(str(exc).split())}") from exc


def _is_simple(hint: Any) -> bool:
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        kinds = [kind for kind in typing.get_args(hint) if kind is not types.NoneType]
        return len(kinds) == 1 and _is_simple(kinds[0])
    if typing.get_origin(hint) is Literal:
        return all(isinstance(word, str) for word in typing.get_args(hint))
    return hint in (bool, int, float, str)
