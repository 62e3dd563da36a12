"""Methods of other packages, found by their entry points in the group ``fracbench.methods``.

A package is imported when one of its methods is asked for. If that fails, the other methods go on working.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from fracbench.errors import InputError
from fracbench.methods.method import Method, described

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "fracbench.methods"


@cache
def offered() -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points by the name of their method; a name should have one."""
    from importlib.metadata import entry_points  # which takes a third of the time of `fracbench --help`

    found: dict[str, tuple[EntryPoint, ...]] = {}
    for entry in entry_points(group=GROUP):
        found[entry.name] = (*found.get(entry.name, ()), entry)
    return dict(sorted(found.items()))


@cache
def _load(name: str) -> Method | str:
    """Return a method, or the reason why it cannot be used: a package is tried once."""
    entries = offered()[name]
    if len(entries) > 1:
        packages = " and ".join(sorted(map(_package, entries)))
        return f"entry point {name!r}: {packages} offer the same name; uninstall one"
    (entry,) = entries
    place = f"entry point {name!r} of {_package(entry)}"
    try:
        found = entry.load()
    except (Exception, SystemExit) as exc:
        return f"{place}: {entry.value} cannot be loaded: {described(exc)}"
    if not isinstance(found, Method):
        return f"{place}: {entry.value} is of type {type(found).__name__}, not a fracbench.Method"
    if found.name != name:
        return f"{place}: the method is called {found.name!r}; give the entry point the same name"
    dist = entry.dist
    return found.offered_by(dist.name, dist.version) if dist else found


def load(name: str) -> Method:
    """Return the method of an entry point."""
    found = _load(name)
    if isinstance(found, str):
        raise InputError(found)
    return found


def taken(name: str) -> str:
    """Say that the method of an entry point has the name of one of ours."""
    packages = " and ".join(map(_package, offered()[name]))
    return (
        f"entry point {name!r} of {packages}: fracbench has a method of this name, which is used; choose another"
    )


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown package"
