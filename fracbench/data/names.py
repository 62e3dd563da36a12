"""Names as people type them."""

from __future__ import annotations

from collections.abc import Iterable

from fracbench.errors import unknown_name


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
