"""The project's own errors: each message is one line that names the thing, the place and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: The end of a message about a run that ended early.
RESUME = "finished points are stored; the same command resumes"


class FracbenchError(Exception):
    """Base class; the command line prints its message without a traceback."""


class InputError(FracbenchError, ValueError):
    """An input of the user cannot be used; the command line exits with 2."""


class DataError(InputError):
    """A data set is missing, corrupt or unreadable."""


class AbsentError(InputError):
    """A program that a method needs is not installed."""


def nearest(name: str, allowed: Iterable[str]) -> str | None:
    """Return the allowed name most like `name` without regard to case, or None if none is like it."""
    by_folded = {a.casefold(): a for a in allowed}
    hits = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.5)
    return by_folded[hits[0]] if hits else None


def unknown_name(kind: str, name: str, allowed: Iterable[str], where: str = "") -> InputError:
    """Return the error for a `name` of some `kind` that is not allowed; `where` is e.g. a file's name.

    ``unknown region 'grove2_a': did you mean 'grove2_A'? (allowed: ...)``
    """
    options = sorted(allowed)
    guess = nearest(str(name), options)  # in Python a name may be of any type
    hint = f": did you mean {guess!r}?" if guess else ""
    place = f"{where}: " if where else ""
    return InputError(f"{place}unknown {kind} {name!r}{hint} (allowed: {', '.join(options)})")


def match_name(name: str, allowed: Iterable[str], kind: str) -> str:
    """Return the allowed name of some `kind` that `name` is, without regard to case."""
    by_folded = {a.casefold(): a for a in allowed}
    try:
        return by_folded[str(name).casefold()]
    except KeyError:
        raise unknown_name(kind, str(name), by_folded.values()) from None
