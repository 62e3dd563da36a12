"""The tidy table of a plan: one row a point, labels, parameters and errors in columns."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import MEASURES
from fracbench.harness.run.sqlite import DAMAGED
from fracbench.harness.run.store import Row, StoreError

if TYPE_CHECKING:
    import pandas as pd

METRICS = ("aae", "aepe", "sdae")
#: Columns of a tidy table that are computed. Seconds are not among them: they differ from run to run, and
#: a table that is computed again must not differ by a byte. They are in the store.
COUNTS = ("n_pixels", "n_unknown", "n_nonfinite")
RESULT_COLUMNS = (*METRICS, *COUNTS)
_WHOLE = (*COUNTS, "iterations", "inner_iterations")


def tidy(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return one row a planned flow: labels, parameters, errors, iterations, how it ended.

    Points without a row have the status ``missing``, failed ones NaN errors; parameters that are numbers in every
    row are numbers. A parameter that came after results were stored (`Method.younger`) has a column only where a
    point has an unusual value of it, so that older tables stay as they are.

    StoreError: the result of a row is none of ours.
    """
    import pandas as pd

    blank = {name: "" for each in plan.points.frames if each.point.score not in MEASURES for name in each.labels}
    parameters, shown = set[str](), set[str]()
    usual: dict[str, Mapping[str, str]] = {}  # by method
    columns: dict[str, _Words | list[str] | array[float]] = {}
    same = {key: key for key in rows}  # one text for each key, though it is made anew
    for count, planned in enumerate(_flows_of(plan)):
        point, key, canonical = planned.point, planned.point.key, planned.point.canonical
        if point.method not in usual:
            usual[point.method] = point.usual
            parameters.update(canonical)
        younger = usual[point.method]
        shown.update(name for name, value in canonical.items() if younger.get(name) != value)
        try:
            ending = _ending(rows.get(key))
        except (AttributeError, KeyError, TypeError, ValueError) as exc:
            raise StoreError(f"the result of point {key[:12]} {DAMAGED} ({exc!r})") from exc
        record = {**blank, **planned.labels, **canonical, **ending, "key": same.get(key, key)}
        for name, value in record.items():
            if name not in columns:
                columns[name] = _new_column(name, value, count)
        for name, values in columns.items():
            values.append(record.get(name, math.nan))
    del same
    finished = {}
    for name in list(columns):  # one by one, so that no column is there twice for long
        values = columns.pop(name)
        if name in shown or name not in parameters:
            finished[name] = _finished(values, whole=name in _WHOLE, numeric=name in parameters)
    return pd.DataFrame(finished, copy=False)


class _Words:
    """A column of few distinct words: each is kept once, and if there are several, its number for each row."""

    def __init__(self, count: int) -> None:
        self._numbers: dict[Any, int] = {math.nan: 0} if count else {}
        self._count = count
        self._rows: array[int] | None = None

    def append(self, word: Any) -> None:
        """Add the word of a row."""
        number = self._numbers.setdefault(word, len(self._numbers))
        if number and self._rows is None:
            self._rows = array("i", [0]) * self._count
        if self._rows is not None:
            self._rows.append(number)
        self._count += 1

    def series(self, *, numeric: bool) -> pd.Series:
        """Return the column; with `numeric` as numbers, if all words are."""
        import pandas as pd

        words = pd.Series(list(self._numbers))
        if numeric:
            with suppress(ValueError, TypeError):
                words = pd.to_numeric(words)
        rows = np.zeros(self._count, np.intc) if self._rows is None else np.frombuffer(self._rows, np.intc)
        return words.take(rows).reset_index(drop=True)


def _new_column(name: str, value: Any, count: int) -> _Words | list[str] | array[float]:
    """Return a column of so many rows without a value, for values of one kind."""
    if name == "key":
        return [""] * count
    return _Words(count) if value is None or isinstance(value, str) else array("d", [math.nan]) * count


def _finished(values: _Words | list[str] | array[float], *, whole: bool, numeric: bool) -> pd.Series:
    import pandas as pd

    if isinstance(values, _Words):
        return values.series(numeric=numeric)
    column = pd.Series(np.frombuffer(values) if isinstance(values, array) else values)
    # A point that failed has no counts; those of the others stay whole numbers.
    return column.astype("Int64") if whole else column


def _ending(row: Row | None) -> dict[str, Any]:
    """Return what a row says of its flow: numbers, NaN where there is none, and words or None."""
    result = row.result if row else {}
    found = {name: result.get(name) for name in RESULT_COLUMNS}
    for name, errors in {**result.get("classes", {}), **result.get("masks", {})}.items():
        found |= {f"{metric}_{name}": errors[metric] for metric in METRICS}
    if "fl_all" in result:
        found["fl_all"] = result["fl_all"]
    found |= result.get("fluid", {})
    found |= {name: _total(result.get(name)) for name in ("iterations", "inner_iterations")}
    numbers = {name: math.nan if value is None else float(value) for name, value in found.items()}
    stop = result.get("stop")
    if not isinstance(stop, str | None):
        raise TypeError(f"stop is of type {type(stop).__name__}")
    status, error = (row.status, row.error) if row else ("missing", None)
    return {**numbers, "stop": stop, "status": status, "error": error}


def _flows_of(plan: Plan) -> Iterator[PlannedPoint]:
    return (planned for planned in plan.points if planned.point.score not in MEASURES)


def _total(levels: Sequence[Sequence[int]] | None) -> int | None:
    return None if levels is None else sum(sum(level) for level in levels)
