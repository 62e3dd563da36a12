"""The checks of YAML files: their keys and types are known, and nothing in them could run code.

Hydra reads more out of a configuration than values: ``hydra.searchpath`` may name a Python package, which is
imported, and ``_target_`` names an object that is called. Neither has a place here: the files are data.
"""

from __future__ import annotations

import re
import reprlib
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar

from fracbench.data.files import read_bytes
from fracbench.errors import InputError, unknown_name

T = TypeVar("T")

_NAME = re.compile(r"[A-Za-z0-9]\w*(?:[.+-]\w+)*", re.ASCII)
_LONGEST = 80
_PACKAGE = re.compile(r"^\s*#\s*@package\s+(?!_global_\s*$)(\S.*)", re.MULTILINE)
_LARGEST = 1_000_000
_RESOLVER = re.compile(r"\$\{.*:", re.DOTALL)
_SPECIAL = re.compile(r"hydra|_\w+_")
_WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    types.NoneType: "null",
    tuple: "a list",
    list: "a list",
    dict: "a mapping",
}


def require_name(value: Any, what: str, where: str) -> str:
    """Return a name that may become part of a file's name: it cannot lead out of a folder."""
    if not isinstance(value, str) or not _NAME.fullmatch(value) or len(value) > _LONGEST:
        rule = f"a name of letters, digits, _, -, + and . (at most {_LONGEST})"
        raise InputError(f"{where}: {what} must be {rule}, got {_short(value)}")
    return value


def mapping(raw: Any, where: str, allowed: Collection[str] | None = None) -> dict[str, Any]:
    """Return a section of a file, whose keys are texts and, if `allowed` is given, among those."""
    if not isinstance(raw, Mapping):
        keys = f" with the keys {', '.join(sorted(allowed))}" if allowed else ""
        raise InputError(f"{where}: must be a mapping{keys}, got {_short(raw)}")
    for key in raw:
        if not isinstance(key, str):
            raise InputError(f"{where}: the key {key!r} is no text")
        if allowed is not None and key not in allowed:
            raise unknown_name("key", key, allowed, where)
    return dict(raw)


def record(kind: type[T], raw: Any, where: str) -> T:
    """Make a dataclass, whose annotations say which type each key has, out of a section of a file."""
    hints = typing.get_type_hints(kind)
    values = mapping(raw, where, hints)
    for key, value in values.items():
        options = typing.get_args(hints[key]) if isinstance(hints[key], types.UnionType) else (hints[key],)
        if not any(_is(value, hint) for hint in options):
            wanted = " or ".join(map(_word, options))
            raise InputError(f"{where}: `{key}` must be {wanted}, got {_short(value)}")
    try:
        return kind(**values)
    except TypeError as exc:
        raise InputError(f"{where}: {exc}") from exc


def _is(value: Any, hint: Any) -> bool:
    """Tell whether a value out of YAML is of an annotated type: a list stands for a tuple, 1 for 1.0."""
    kind, items = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind is Any:
        return True
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if kind is list:
        return isinstance(value, list) and all(_is(item, items[0]) for item in value)
    if kind is tuple:
        return isinstance(value, list | tuple)
    return isinstance(value, kind)


def _word(hint: Any) -> str:
    kind, items = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind is list and items[0] is not Any:
        return f"a list, each item {_word(items[0])}"
    return _WORDS[kind]


def refuse_code(folder: Path) -> None:
    """Read every YAML file below a folder as plain data and refuse those on which Hydra would act.

    That is ``hydra`` or a key such as ``_target_`` anywhere in it, and another package than ``_global_``.
    """
    for path in sorted(folder.rglob("*.yaml")):
        read_plain(path)


def read_plain(path: Path) -> Mapping[str, Any]:
    """Return a YAML file as plain data, and refuse one on which Hydra would act."""
    state = path.stat()
    return _read_plain(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1024)
def _read_plain(path: Path, *_: int) -> Mapping[str, Any]:
    raw, text = read_yaml(path)
    package = _PACKAGE.search(text)
    if package:
        raise InputError(f"{path}: the package must be _global_, got {package[1].strip()!r}")
    if raw is None:
        return {}
    _refuse_aliases(raw, str(path), set())
    for word in _words(mapping(raw, str(path))):
        if _SPECIAL.fullmatch(word.strip("/ ").partition("/")[0]) or _RESOLVER.search(word):
            raise InputError(f"{path}: {word!r} is not allowed: a configuration is data and runs no code")
    return raw


def read_yaml(path: Path) -> tuple[Any, str]:
    """Return a YAML file as plain data, and its text."""
    data = read_bytes(path, _LARGEST)
    try:
        text = data.decode("utf-8")
        return _loader()(text).get_single_data(), text
    except Exception as exc:  # PyYAML lets nearly any exception through, e.g. ValueError on 2001-99-99
        why = " ".join(str(exc).split()) or type(exc).__name__
        raise InputError(f"{path}: cannot be read as YAML: {why}") from exc


@cache
def _loader() -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        """PyYAML's safe loader without merge keys, bytes, and whole numbers of thousands of digits."""

        def flatten_mapping(self, node: yaml.MappingNode) -> None:
            """Refuse merge keys: what they name is copied, and nested ones fill the memory."""
            if any(key.tag == "tag:yaml.org,2002:merge" for key, _ in node.value):
                raise yaml.constructor.ConstructorError(problem="merge keys (<<) are not allowed; write them out")

        def construct_short_int(self, node: yaml.ScalarNode) -> int:
            """Refuse a long one, which is too large for a float or a message; in base 60 it takes seconds."""
            if len(node.value) > _LONGEST:
                problem = f"whole numbers have at most {_LONGEST} characters"
                raise yaml.constructor.ConstructorError(problem=problem)
            return self.construct_yaml_int(node)

    ours: dict[str | None, Any] = {
        "tag:yaml.org,2002:binary": Loader.construct_undefined,  # no setting is made of bytes
        "tag:yaml.org,2002:int": Loader.construct_short_int,
    }
    Loader.yaml_constructors = Loader.yaml_constructors | ours
    return Loader


def _refuse_aliases(raw: Any, where: str, seen: set[int]) -> None:
    """Refuse a list or mapping that stands in two places: a few nested ones are more than memory holds."""
    if not isinstance(raw, Mapping | list):
        return
    if id(raw) in seen:
        raise InputError(f"{where}: aliases (&NAME, *NAME) of lists and mappings are not allowed; write them out")
    seen.add(id(raw))
    for item in raw.values() if isinstance(raw, Mapping) else raw:
        _refuse_aliases(item, where, seen)


def _short(value: Any) -> str:
    """Return a value on one line, cut short where it is long or deep."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 100
    return short.repr(value)


def _words(raw: Any) -> Iterator[str]:
    """Yield every key, every entry of a list, which for Hydra may be a key as well, and texts with ``${``."""
    if isinstance(raw, Mapping):
        for key, value in raw.items():
            yield str(key).removeprefix("override ")
            yield from _words(value)
    elif isinstance(raw, list):
        for item in raw:
            if isinstance(item, str) and item != "_self_":
                yield item
            yield from _words(item)
    elif isinstance(raw, str) and "${" in raw:
        yield raw
