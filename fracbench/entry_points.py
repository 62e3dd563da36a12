"""Methods and datasets of other packages, found by their entry points.

A package is imported when one of its methods or datasets is asked for. If that fails, the others go on working.
"""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable, Container
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from fracbench.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

_log = logging.getLogger(__name__)
T = TypeVar("T")


class Offers(Generic[T]):
    """The offers of one group: objects of class `kind`, under names that are not among our `own`.

    `signed(offer, package, release)` adds the distribution to a loaded object.
    """

    def __init__(
        self, kind: type[T], own: Container[str], signed: Callable[[T, str, str], T] = lambda offer, *_: offer
    ) -> None:
        self._kind, self._own, self._signed = kind, own, signed
        self._noun = kind.__name__.lower()

    def names(self) -> list[str]:
        """Return the names, sorted, after a warning of those that we have too; no package is imported."""
        for line in self._taken():
            _warn_once(line)
        return [name for name in self._entries() if name not in self._own]

    def __contains__(self, name: str) -> bool:
        return name in self._entries()

    def load(self, name: str) -> T:
        """Return the object of a name."""
        found = self._load(name, tuple(sys.path))
        if isinstance(found, str):
            raise InputError(found)
        return found

    def load_all(self) -> tuple[list[T], list[str]]:
        """Return all objects, and a line for each entry point that cannot be used."""
        usable, unusable = [], self._taken()
        for name in self._entries():
            if name not in self._own:
                try:
                    usable.append(self.load(name))
                except InputError as exc:
                    unusable.append(str(exc))
        return usable, unusable

    def _entries(self) -> dict[str, tuple[EntryPoint, ...]]:
        return _read(tuple(sys.path)).get(f"fracbench.{self._noun}s", {})

    def _taken(self) -> list[str]:
        return [
            f"entry point {name!r} of {_packages(entries)}: fracbench has a {self._noun} of this name, which is "
            "used; choose another"
            for name, entries in self._entries().items()
            if name in self._own
        ]

    @cache  # noqa: B019  a package is tried once; the two objects of this class live as long as the process
    def _load(self, name: str, _: tuple[str, ...]) -> T | str:
        """Return an object, or the reason why it cannot be used."""
        entries = self._entries()[name]
        if len(entries) > 1:
            return f"entry point {name!r}: {_packages(entries)} offer the same name; uninstall one"
        (entry,) = entries
        place = f"entry point {name!r} of {_packages(entries)}"
        try:
            found = entry.load()
        except (Exception, SystemExit) as exc:
            return f"{place}: {entry.value} cannot be loaded: {described(exc)}"
        if not isinstance(found, self._kind):
            return (
                f"{place}: {entry.value} is of type {type(found).__name__}, not a fracbench.{self._kind.__name__}"
            )
        if (called := getattr(found, "name", None)) != name:
            return f"{place}: the {self._noun} is called {called!r}; give the entry point the same name"
        return self._signed(found, *_package(entry))


def described(exc: BaseException) -> str:
    """Return an error on one line, with the place in the code."""
    message = f"{type(exc).__name__}: {exc}" if str(exc) else type(exc).__name__
    place = traceback.extract_tb(exc.__traceback__)[-1]
    return f"{' '.join(message.split())} ({Path(place.filename).name}:{place.lineno})"


@cache
def _read(_: tuple[str, ...]) -> dict[str, dict[str, tuple[EntryPoint, ...]]]:
    """Return the entry points on ``sys.path`` by group and name; a name should have one."""
    from importlib.metadata import entry_points  # takes long; our own methods and datasets need none of it

    found: dict[str, dict[str, tuple[EntryPoint, ...]]] = {}
    try:
        everything = entry_points()
    except Exception as exc:  # a file entry_points.txt that is none, of any package
        _warn_once(f"other packages are left out: their entry points cannot be read: {exc}")
        return {}
    for group in ("fracbench.methods", "fracbench.datasets"):
        for entry in sorted(everything.select(group=group), key=lambda entry: entry.name):
            names = found.setdefault(group, {})
            names[entry.name] = (*names.get(entry.name, ()), entry)
    return found


@cache
def _warn_once(line: str) -> None:
    _log.warning("%s", line)


def _packages(entries: tuple[EntryPoint, ...]) -> str:
    return " and ".join(sorted(" ".join(_package(entry)) for entry in entries))


def _package(entry: EntryPoint) -> tuple[str, str]:
    """Return name and version of the distribution that offers an entry point."""
    try:
        name, version = getattr(entry.dist, "name", None), getattr(entry.dist, "version", None)
    except Exception:  # it has no file METADATA
        name, version = None, None
    return str(name or "unknown-package"), str(version or "of no version")
