"""The override grammar: the meaning of ``alpha=0:2:0.1 region=grove2_A`` on the command line.

=============================================  ==================================================
``alpha=1.2``                                  one value
``alpha=0:2:0.1``                              from 0 to 2 by 0.1, **both ends included**
``alpha=1,2,5`` and ``alpha=0:1:0.25,1.5,2``   lists and unions
``lambda=log(1e-3:1:7)``                       7 values evenly spaced in the logarithm, exact ends
``range(0,2,0.1)``, ``choice(a,b,c)``          Hydra's own: the stop of ``range`` is left out
``alpha=1,2 theta=0.3,0.4``                    the product, first key slowest
``zip(lambda,theta)=(0.3,0.3),(0.4,0.4)``      keys that change together
=============================================  ==================================================

Numbers are decimals from the command line to the key of a stored point, and each has one spelling
(`canonical_number`): ``0.1 + 0.2`` is ``0.3``, and a binary float never becomes a key. A text that
holds a comma, a parenthesis or ``number:number`` is written in quotes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product

from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.numbers import (
    CALL,
    canonical_number,
    quote,
    refuse_beyond_limit,
    scalar,
    split,
    values_of,
)

_KEY = re.compile(r"[A-Za-z_]\w*(?:[./]\w+)*", re.ASCII)


@dataclass(frozen=True)
class Axis:
    """One direction of a grid: its key, or zipped keys, and the distinct tuples of values they take."""

    keys: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Grid:
    """The grid of a list of overrides: the product of its axes, the slowest first."""

    axes: tuple[Axis, ...] = ()

    @property
    def size(self) -> int:
        """The number of points; 1 for no overrides at all."""
        return math.prod(len(axis.values) for axis in self.axes)

    @property
    def fixed(self) -> dict[str, str]:
        """The keys that have the same value at every point, with that value."""
        return {key: values[0] for key, values in self._columns() if len(set(values)) == 1}

    @property
    def varying(self) -> tuple[str, ...]:
        """The keys that take more than one value, in the order of the command line."""
        return tuple(key for key, values in self._columns() if len(set(values)) > 1)

    def points(self) -> Iterator[dict[str, str]]:
        """Yield every point as ``{key: value}``, the last axis changing fastest."""
        for rows in product(*(axis.values for axis in self.axes)):
            point: dict[str, str] = {}
            for axis, row in zip(self.axes, rows, strict=True):
                point.update(zip(axis.keys, row, strict=True))
            yield point

    def thinned(self, n: int = 3) -> Grid:
        """Return a small grid of the same shape, to try an experiment out.

        An axis of numbers keeps `n` values: its ends and those evenly between them. Of several sequences or
        regions the first two are kept; other names stay as they are.
        """
        return Grid(tuple(Axis(axis.keys, _thinned(axis, n)) for axis in self.axes))

    def _columns(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        for axis in self.axes:
            yield from zip(axis.keys, zip(*axis.values, strict=True), strict=True)


def parse_overrides(tokens: Sequence[str]) -> Grid:
    """Read command-line overrides; the module's docstring has the grammar.

    Globs such as ``region=grove2_*`` stay as they are: see `expand_names`. The points of a grid that is too large
    are counted, never made.
    """
    axes: list[Axis] = []
    taken: set[str] = set()
    for token in tokens:
        try:
            axes.append(_parse_token(token))
            _claim(axes[-1].keys, taken)
        except InputError as exc:
            raise InputError(f"{quote(token)}: {exc}") from exc
    grid = Grid(tuple(axes))
    try:
        refuse_beyond_limit(grid.size)
    except InputError as exc:
        raise InputError(f"{quote(' '.join(tokens))}: {exc}") from exc
    return grid


def expand_names(pattern_values: Sequence[str], allowed: Sequence[str], kind: str) -> list[str]:
    """Replace ``all`` and shell globs by the names they stand for, each once; upper and lower case differ."""
    names: dict[str, None] = {}
    for pattern in pattern_values:
        if pattern in allowed:
            hits = [pattern]
        elif pattern == "all":
            hits = list(allowed)
        elif any(c in pattern for c in "*?["):
            hits = [name for name in allowed if fnmatchcase(name, pattern)]
        else:
            raise unknown_name(kind, pattern, allowed)
        if not hits:
            raise InputError(f"no {kind} matches {pattern!r} (allowed: {', '.join(allowed)})")
        names.update(dict.fromkeys(hits))
    return list(names)


def _thinned(axis: Axis, n: int) -> tuple[tuple[str, ...], ...]:
    if axis.keys[0] in ("sequence", "region"):
        return axis.values[:2]
    last = len(axis.values) - 1
    if last < n or any(canonical_number(value) is None for row in axis.values for value in row):
        return axis.values
    return tuple(axis.values[round(i * last / (n - 1))] for i in range(n))


def _parse_token(token: str) -> Axis:
    key, equals, value = token.partition("=")
    if not equals:
        raise InputError("write KEY=VALUE, e.g. alpha=0:2:0.1")
    if not value.strip():
        raise InputError("nothing follows '=': write KEY=VALUE, e.g. alpha=0:2:0.1")
    call = CALL.fullmatch(key.strip())
    if call is None:
        return Axis((_key(key),), tuple((v,) for v in values_of(value)))
    if call[1] != "zip":
        raise unknown_name("way to combine keys", call[1], ["zip"])
    return _zip(call[2], value)


def _key(text: str) -> str:
    key = text.strip()
    if not _KEY.fullmatch(key):
        raise InputError(f"{quote(key)} is not a key: write a name such as alpha or parallel.address")
    return key


def _claim(keys: Sequence[str], taken: set[str]) -> None:
    for key in keys:
        if key in taken:
            raise InputError(f"the key {key!r} is given twice")
        taken.add(key)


def _zip(names: str, text: str) -> Axis:
    """``zip(lambda,theta)=(0.3,0.3),(0.4,0.4)``."""
    keys = tuple(_key(name) for name in names.split(","))
    rows: dict[tuple[str, ...], None] = {}
    for part in split(text):
        if not (part.startswith("(") and part.endswith(")")):
            raise InputError(f"{quote(part)} is not a tuple: write zip(a,b)=(1,2),(3,4)")
        row = tuple(scalar(value) for value in split(part[1:-1]))
        if len(row) != len(keys):
            raise InputError(f"the tuple {quote(part)} has {len(row)} value(s) for {len(keys)} key(s)")
        rows[row] = None
    return Axis(keys, tuple(rows))
