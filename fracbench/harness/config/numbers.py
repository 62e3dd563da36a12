"""The values behind ``=`` in the grammar of `fracbench.harness.config.grid`: numbers, ranges, functions, texts.

Numbers are decimals throughout: ``0.1 + 0.2`` is ``0.3``, and each has one spelling.
"""

from __future__ import annotations

import math
import re
from decimal import Context, Decimal, InvalidOperation, localcontext
from itertools import pairwise

from fracbench.errors import InputError, unknown_name

MAX_POINTS = 1_000_000
"""The size of the largest grid: a larger one is taken for a slip of the step."""

_MAX_DIGITS = 400
# Enough for the sum of any two numbers of float64 range with _MAX_DIGITS digits each.
_EXACT = Context(prec=1100)
_LOG_PRECISION = 40
_SIX_DIGITS = Context(prec=6)

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_HOST_AND_PORT = re.compile(r"(?:[A-Za-z][\w.-]*|\d+(?:\.\d+){3}|\[[\da-fA-F:]+\]):\d+", re.ASCII)
CALL = re.compile(r"(\w+)\s*\((.*)\)", re.DOTALL)
_LEXEME = re.compile(r"'[^']*'|\"[^\"]*\"|.", re.DOTALL)
_QUOTES = ("'", '"')


def canonical_number(text: str) -> str | None:
    """Return the one spelling of a number, or None if `text` is no finite number of float64 range.

    That is plain decimal notation without superfluous zeros (``1e-3``: ``"0.001"``); every digit given is kept.
    """
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        return None
    try:
        number = Decimal(text)
    except InvalidOperation:  # an exponent beyond the range of decimal
        return None
    value = float(text)
    if math.isinf(value) or (value == 0) != (not number) or len(number.as_tuple().digits) > _MAX_DIGITS:
        return None
    return _plain(number)


def values_of(text: str) -> list[str]:
    """Return the values of a union such as ``0:1:0.25,1.5``, each once: canonical numbers, and texts.

    More than `MAX_POINTS` values are counted, never made.
    """
    values: dict[str, None] = {}
    asked = 0
    for part in split(text):
        piece = _piece(part)
        asked += len(piece)
        refuse_beyond_limit(asked)
        values.update(dict.fromkeys(piece))
    return list(values)


def _piece(text: str) -> list[str]:
    if text.startswith(_QUOTES):
        return [scalar(text)]
    call = CALL.fullmatch(text)
    if call is not None:
        name, body = call.groups()
        if name not in _FUNCTIONS:
            raise unknown_name("grid function", name, _FUNCTIONS)
        return _FUNCTIONS[name](body)
    if not _looks_like_range(text):
        return [scalar(text)]
    parts = text.split(":")
    if len(parts) != 3:
        raise InputError("write a range as a:b:step, e.g. 0:2:0.1")
    start, stop, step = (_decimal(part) for part in parts)
    return _progression(start, stop, step, inclusive=True)


def _hydra_range(body: str) -> list[str]:
    """``range(stop)``, ``range(start,stop)``, ``range(start,stop,step)``, by position or by name."""
    names = ("start", "stop", "step")
    given: dict[str, Decimal] = {}
    for position, part in enumerate(split(body)):
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
    if "stop" not in given:
        start, given["stop"] = Decimal(0), start
    return _progression(start, given["stop"], step, inclusive=False)


def _choice(body: str) -> list[str]:
    return [scalar(part) for part in split(body)]


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
    refuse_beyond_limit(int(n))
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


_FUNCTIONS = {"choice": _choice, "log": _logarithmic, "range": _hydra_range}


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
    refuse_beyond_limit(count)
    return [_plain(_EXACT.fma(step, Decimal(k), start)) for k in range(count)]


def scalar(text: str) -> str:
    """Return a single value: a number in canonical form, or a text without its quotes."""
    quoted = text.startswith(_QUOTES) and _LEXEME.fullmatch(text) is not None
    value = text[1:-1] if quoted else text
    if not value.strip():
        raise InputError("a value is empty")
    number = canonical_number(value)
    if number is not None:
        return number
    if _NUMBER.fullmatch(value) or _NOT_FINITE.fullmatch(value):
        raise InputError(f"{quote(value)} is not a finite number of float64 range")
    if quoted:
        return value
    if any(c in value for c in "()'\""):
        raise InputError(f"cannot read {quote(value)}: a text with ( ) or a quote is written in quotes")
    if value.count("[") != value.count("]"):
        raise InputError("lists are written without brackets: 1,2,5")
    if _looks_like_range(value):
        raise InputError(f"the range {quote(value)} cannot stand inside choice() or a tuple")
    return value


def split(text: str) -> list[str]:
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
        raise InputError(f"{quote(text)} is not a finite number")
    return Decimal(number)


def _plain(number: Decimal) -> str:
    text = format(number, "f")
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return text if number else "0"


def refuse_beyond_limit(count: int) -> None:
    """Refuse more than `MAX_POINTS` values or points."""
    if count > MAX_POINTS:
        shown = str(count) if count < 10**15 else f"{Decimal(count):.2e}"
        raise InputError(f"asks for {shown} points, more than the {MAX_POINTS} allowed: use larger steps")


def quote(text: str) -> str:
    """Quote a text of the user on one line, shortened in the middle."""
    quoted = repr(text)
    return quoted if len(quoted) <= 100 else f"{quoted[:60]} ... {quoted[-30:]}"
