"""The override grammar: what ``alpha=0:2:0.1 region=grove2_A`` on the command line stands for.

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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation, localcontext
from fnmatch import fnmatchcase
from itertools import pairwise, product

from fracbench.errors import InputError, unknown_name

MAX_POINTS = 100_000
"""The largest grid: anything larger is taken for a slip of the step."""

_MAX_DIGITS = 400
# Enough for the sum of any two numbers of float64 range with _MAX_DIGITS digits each.
_EXACT = Context(prec=1100)
_LOG_PRECISION = 40
_SIX_DIGITS = Context(prec=6)

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_KEY = re.compile(r"[A-Za-z_]\w*(?:[./]\w+)*", re.ASCII)
_HOST_AND_PORT = re.compile(r"(?:[A-Za-z][\w.-]*|\d+(?:\.\d+){3}|\[[\da-fA-F:]+\]):\d+", re.ASCII)
_CALL = re.compile(r"(\w+)\s*\((.*)\)", re.DOTALL)
_LEXEME = re.compile(r"'[^']*'|\"[^\"]*\"|.", re.DOTALL)
_QUOTES = ("'", '"')


@dataclass(frozen=True)
class Axis:
    """One direction of a grid: its key, or zipped keys, and the distinct tuples of values they take."""

    keys: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Grid:
    """The points that a list of overrides stands for: the product of its axes, the slowest first."""

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

        Parameters
        ----------
        n : int, optional
            Values kept on an axis of numbers, at least 2: its ends and those evenly between them. Of
            several sequences or regions the first two are kept; other names stay as they are.

        Returns
        -------
        Grid
            Axes in the same order, with a part of their values.
        """
        return Grid(tuple(Axis(axis.keys, _thinned(axis, n)) for axis in self.axes))

    def _columns(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        for axis in self.axes:
            yield from zip(axis.keys, zip(*axis.values, strict=True), strict=True)


def parse_overrides(tokens: Sequence[str]) -> Grid:
    """Read command-line overrides.

    Parameters
    ----------
    tokens : sequence of str
        ``KEY=VALUE`` and ``zip(KEY,KEY)=(VALUE,VALUE),...``; the module's docstring has the grammar.

    Returns
    -------
    Grid
        Their product, in the order given. Globs such as ``region=grove2_*`` stay as they are: see
        `expand_names`.

    Raises
    ------
    InputError
        If a token is malformed, a key occurs twice, a number is not finite, or the grid has more than
        `MAX_POINTS` points. The points of a grid too large are counted, never made.
    """
    axes: list[Axis] = []
    taken: set[str] = set()
    for token in tokens:
        try:
            axes.append(_parse_token(token))
            _claim(axes[-1].keys, taken)
        except InputError as exc:
            raise InputError(f"{_quote(token)}: {exc}") from exc
    grid = Grid(tuple(axes))
    try:
        _refuse_beyond_limit(grid.size)
    except InputError as exc:
        raise InputError(f"{_quote(' '.join(tokens))}: {exc}") from exc
    return grid


def canonical_number(text: str) -> str | None:
    """Return the one spelling of a number, or None if `text` is no finite number of float64 range.

    Parameters
    ----------
    text : str
        For example ``"1e-3"``, ``"+1.0"``, ``".5"``, ``"-0"``.

    Returns
    -------
    str or None
        Plain decimal notation without superfluous zeros: ``"0.001"``, ``"1"``, ``"0.5"``, ``"0"``. Every
        digit given is kept.
    """
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        return None
    try:
        number = Decimal(text)
    except InvalidOperation:  # an exponent beyond what decimal can hold
        return None
    value = float(text)
    if math.isinf(value) or (value == 0) != (not number) or len(number.as_tuple().digits) > _MAX_DIGITS:
        return None
    return _plain(number)


def expand_names(pattern_values: Sequence[str], allowed: Sequence[str], kind: str) -> list[str]:
    """Replace ``all`` and shell globs by the names they stand for.

    Parameters
    ----------
    pattern_values : sequence of str
        Names, ``all``, or globs with ``*``, ``?``, ``[...]``; upper and lower case differ.
    allowed : sequence of str
        The names there are.
    kind : str
        What a name stands for, for the error: ``"region"``.

    Returns
    -------
    list of str
        Every name once, in the order of `pattern_values`, each expanded in the order of `allowed`.

    Raises
    ------
    InputError
        If a name is unknown or a glob matches nothing.
    """
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
    call = _CALL.fullmatch(key.strip())
    if call is None:
        return Axis((_key(key),), tuple((v,) for v in _values(value)))
    if call[1] != "zip":
        raise unknown_name("way to combine keys", call[1], ["zip"])
    return _zip(call[2], value)


def _key(text: str) -> str:
    key = text.strip()
    if not _KEY.fullmatch(key):
        raise InputError(f"{_quote(key)} is not a key: write a name such as alpha or parallel.address")
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
    for part in _split(text):
        if not (part.startswith("(") and part.endswith(")")):
            raise InputError(f"{_quote(part)} is not a tuple: write zip(a,b)=(1,2),(3,4)")
        row = tuple(_scalar(value) for value in _split(part[1:-1]))
        if len(row) != len(keys):
            raise InputError(f"the tuple {_quote(part)} has {len(row)} value(s) for {len(keys)} key(s)")
        rows[row] = None
    return Axis(keys, tuple(rows))


def _values(text: str) -> list[str]:
    """Return the values of a union, each once."""
    values: dict[str, None] = {}
    asked = 0
    for part in _split(text):
        piece = _piece(part)
        asked += len(piece)
        _refuse_beyond_limit(asked)
        values.update(dict.fromkeys(piece))
    return list(values)


def _piece(text: str) -> list[str]:
    if text.startswith(_QUOTES):
        return [_scalar(text)]
    call = _CALL.fullmatch(text)
    if call is not None:
        name, body = call.groups()
        if name not in _FUNCTIONS:
            raise unknown_name("grid function", name, _FUNCTIONS)
        return _FUNCTIONS[name](body)
    if not _looks_like_range(text):
        return [_scalar(text)]
    parts = text.split(":")
    if len(parts) != 3:
        raise InputError("write a range as a:b:step, e.g. 0:2:0.1")
    start, stop, step = (_decimal(part) for part in parts)
    return _progression(start, stop, step, inclusive=True)


def _hydra_range(body: str) -> list[str]:
    """``range(stop)``, ``range(start,stop)``, ``range(start,stop,step)``, by position or by name."""
    names = ("start", "stop", "step")
    given: dict[str, Decimal] = {}
    for position, part in enumerate(_split(body)):
        name, equals, value = part.rpartition("=")
        if not equals and position >= len(names):
            raise InputError("range() takes start, stop and step")
        name = name.strip() if equals else names[position]
        if name not in names:
            raise unknown_name("argument of range()", name, names)
        if name in given:
            raise InputError(f"range() is given {name} twice")
        given[name] = _decimal(value)
    if "start" not in given:
        raise InputError("range() has no start: write range(start,stop,step)")
    start, step = given["start"], given.get("step", Decimal(1))
    if "stop" in given:
        return _progression(start, given["stop"], step, inclusive=False)
    return _progression(Decimal(0), start, step, inclusive=False)


def _choice(body: str) -> list[str]:
    return [_scalar(part) for part in _split(body)]


def _logarithmic(body: str) -> list[str]:
    """``log(a:b:n)``: n values of constant ratio, the inner ones to 6 significant digits."""
    parts = body.split(":")
    if len(parts) != 3:
        raise InputError("write log(a:b:n), e.g. log(1e-3:1:7)")
    start, stop, n = (_decimal(part) for part in parts)
    if min(start, stop) <= 0 or start == stop:
        raise InputError("the ends of log(a:b:n) must be positive and differ")
    if n != n.to_integral_value() or n < 2:
        raise InputError(f"n in log(a:b:n) must be a whole number from 2, not {_plain(n)}")
    _refuse_beyond_limit(int(n))
    with localcontext(prec=_LOG_PRECISION):
        ratio = (stop / start) ** (1 / (n - 1))
        exact = start
        values = [start]
        for _ in range(int(n) - 2):
            exact *= ratio
            values.append(_SIX_DIGITS.plus(exact))
    values.append(stop)
    if any(a == b or (a < b) != (start < stop) for a, b in pairwise(values)):
        raise InputError(f"the ends are too close for {int(n)} values of 6 digits")
    return [_plain(value) for value in values]


_FUNCTIONS: dict[str, Callable[[str], list[str]]] = {
    "choice": _choice,
    "log": _logarithmic,
    "range": _hydra_range,
}


def _progression(start: Decimal, stop: Decimal, step: Decimal, *, inclusive: bool) -> list[str]:
    """Count from `start` to `stop`, exactly; the size is known, and refused, before a value is made."""
    if not step:
        raise InputError("the step is 0")
    span = _EXACT.subtract(stop, start)
    if span and (span > 0) != (step > 0):
        form = "{}:{}:{}" if inclusive else "range({},{},{})"
        a, b, s, minus_s = (_plain(x) for x in (start, stop, step, step.copy_negate()))
        way = "up but stop is below start" if step > 0 else "down but stop is above start"
        raise InputError(f"counts {way}; use {form.format(a, b, minus_s)} or {form.format(b, a, s)}")
    quotient, rest = _EXACT.divmod(span, step)
    count = int(quotient) + bool(inclusive or rest)
    if not count:
        raise InputError("the range is empty: range() leaves out its stop")
    _refuse_beyond_limit(count)
    return [_plain(_EXACT.fma(step, Decimal(k), start)) for k in range(count)]


def _scalar(text: str) -> str:
    quoted = text.startswith(_QUOTES) and _LEXEME.fullmatch(text) is not None
    value = text[1:-1] if quoted else text
    if not value.strip():
        raise InputError("a value is empty")
    number = canonical_number(value)
    if number is not None:
        return number
    if _NUMBER.fullmatch(value) or _NOT_FINITE.fullmatch(value):
        raise InputError(f"{_quote(value)} is not a finite number of float64 range")
    if quoted:
        return value
    if any(c in value for c in "()'\""):
        raise InputError(f"cannot read {_quote(value)}: a text with ( ) or a quote is written in quotes")
    if value.count("[") != value.count("]"):
        raise InputError("lists are written without brackets: 1,2,5")
    if _looks_like_range(value):
        raise InputError(f"the range {_quote(value)} cannot stand inside choice() or a tuple")
    return value


def _split(text: str) -> list[str]:
    """Split at the commas outside parentheses and quotes."""
    parts, depth = [""], 0
    for match in _LEXEME.finditer(text):
        lexeme = match[0]
        if lexeme in _QUOTES:
            raise InputError("a quote is not closed")
        depth += (lexeme == "(") - (lexeme == ")")
        if depth < 0:
            break
        if lexeme == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += lexeme
    if depth:
        raise InputError("the parentheses do not match")
    parts = [part.strip() for part in parts]
    if not all(parts):
        raise InputError("a value is empty: is there a comma too many?")
    return parts


def _looks_like_range(text: str) -> bool:
    """Tell ``0:2`` (a range, if a wrong one) from ``tcp://host:8786``, ``host:8786`` and other texts."""
    if ":" not in text or "/" in text or "\\" in text or _HOST_AND_PORT.fullmatch(text):
        return False
    return any(_NUMBER.fullmatch(part.strip()) for part in text.split(":"))


def _decimal(text: str) -> Decimal:
    number = canonical_number(text)
    if number is None:
        raise InputError(f"{_quote(text)} is not a finite number")
    return Decimal(number)


def _plain(number: Decimal) -> str:
    text = format(number, "f")
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return text if number else "0"


def _refuse_beyond_limit(count: int) -> None:
    if count > MAX_POINTS:
        shown = str(count) if count < 10**15 else f"{Decimal(count):.2e}"
        raise InputError(f"asks for {shown} points, more than the {MAX_POINTS} allowed: use larger steps")


def _quote(text: str) -> str:
    """Quote what the user wrote on one line, shortened in the middle."""
    quoted = repr(text)
    return quoted if len(quoted) <= 100 else f"{quoted[:60]} ... {quoted[-30:]}"
