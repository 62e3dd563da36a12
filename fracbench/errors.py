"""The project's own errors: each message is one line that names the thing, the place and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: What a message says of a run that ended early.
RESUME = "finished points are stored; the same command resumes"


class FracbenchError(Exception):
    """Base class; the command line prints its message without a traceback."""


class InputError(FracbenchError, ValueError):
    """Something the user gave cannot be used; the command line exits with 2."""


class DataError(InputError):
    """A data set is missing, corrupt or unreadable."""


def nearest(name: str, allowed: Iterable[str]) -> str | None:
    """Return the allowed name most like `name`, or None if none is like it.

    Parameters
    ----------
    name : str
        What was given.
    allowed : iterable of str
        What could have been meant; compared without regard to case.

    Returns
    -------
    str or None
        The nearest allowed name.
    """
    by_folded = {a.casefold(): a for a in allowed}
    hits = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.5)
    return by_folded[hits[0]] if hits else None


def unknown_name(kind: str, name: str, allowed: Iterable[str], where: str = "") -> InputError:
    """Build the error for a name that is not among those allowed.

    Parameters
    ----------
    kind : str
        What the name stands for, e.g. ``"region"``.
    name : str
        What was given.
    allowed : iterable of str
        The names there are.
    where : str, optional
        The place, e.g. a file name, put in front of the message.

    Returns
    -------
    InputError
        ``unknown region 'grove2_a': did you mean 'grove2_A'? (allowed: ...)``; to be raised by the caller.
    """
    options = sorted(allowed)
    guess = nearest(name, options)
    hint = f": did you mean {guess!r}?" if guess else ""
    place = f"{where}: " if where else ""
    return InputError(f"{place}unknown {kind} {name!r}{hint} (allowed: {', '.join(options)})")


def match_name(name: str, allowed: Iterable[str], kind: str) -> str:
    """Return the allowed name that `name` is, without regard to case.

    Parameters
    ----------
    name : str
        What was given, e.g. ``"grove2"``.
    allowed : iterable of str
        The names there are, e.g. ``("Grove2", ...)``.
    kind : str
        What the name stands for, for the message.

    Returns
    -------
    str
        The name in its own spelling.

    Raises
    ------
    InputError
        If there is no such name; the message gives the nearest one.
    """
    by_folded = {a.casefold(): a for a in allowed}
    try:
        return by_folded[str(name).casefold()]
    except KeyError:
        raise unknown_name(kind, str(name), by_folded.values()) from None
