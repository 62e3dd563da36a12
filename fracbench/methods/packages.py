"""Methods of other packages, found by their entry points in the group ``fracbench.methods``.

A package is imported when one of its methods is asked for. If that fails, the other methods go on working.
"""

from __future__ import annotations

import dataclasses
import logging
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from fracbench.errors import InputError
from fracbench.methods.method import Method, described

_log = logging.getLogger(__name__)

GROUP = "fracbench.methods"


@cache
def offered() -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points by the name of their method; a name should have one."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    try:
        for entry in entry_points(group=GROUP):
            found[entry.name] = (*found.get(entry.name, ()), entry)
    except Exception as exc:  # a file entry_points.txt that is none, of any package
        _log.warning("methods of other packages are left out: their entry points cannot be read: %s", exc)
        return {}
    return dict(sorted(found.items()))


@cache
def _load(name: str) -> Method | str:
    """Return a method, or the reason why it cannot be used: a package is tried once."""
    entries = offered()[name]
    if len(entries) > 1:
        packages = " and ".join(sorted(" ".join(_package(entry)) for entry in entries))
        return f"entry point {name!r}: {packages} offer the same name; uninstall one"
    (entry,) = entries
    package, release = _package(entry)
    place = f"entry point {name!r} of {package} {release}"
    try:
        found = entry.load()
    except (Exception, SystemExit) as exc:
        return f"{place}: {entry.value} cannot be loaded: {described(exc)}"
    if not isinstance(found, Method):
        return f"{place}: {entry.value} is of type {type(found).__name__}, not a fracbench.Method"
    if found.name != name:
        return f"{place}: the method is called {found.name!r}; give the entry point the same name"
    return dataclasses.replace(found, package=package, release=release)


def load(name: str) -> Method:
    """Return the method of an entry point."""
    found = _load(name)
    if isinstance(found, str):
        raise InputError(found)
    return found


def taken(name: str) -> str:
    """Say that the method of an entry point has the name of one of ours."""
    packages = " and ".join(" ".join(_package(entry)) for entry in offered()[name])
    return (
        f"entry point {name!r} of {packages}: fracbench has a method of this name, which is used; choose another"
    )


def _package(entry: EntryPoint) -> tuple[str, str]:
    """Return name and version of the distribution that offers an entry point."""
    try:
        name, version = getattr(entry.dist, "name", None), getattr(entry.dist, "version", None)
    except Exception:  # it has no file METADATA
        name, version = None, None
    return str(name or "unknown-package"), str(version or "of no version")
