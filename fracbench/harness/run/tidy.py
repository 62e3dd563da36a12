"""The tidy table of a plan: one row a point, labels, parameters and errors in columns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import MEASURES
from fracbench.harness.run.store import Row

if TYPE_CHECKING:
    import pandas as pd

METRICS = ("aae", "aepe", "sdae")
#: Columns of a tidy table that are computed. Seconds are not among them: they differ from run to run, and
#: a table that is computed again must not differ by a byte. They are in the store.
COUNTS = ("n_pixels", "n_unknown", "n_nonfinite")
RESULT_COLUMNS = (*METRICS, *COUNTS)


def tidy(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return one row a planned flow: labels, parameters, errors, iterations, how it ended.

    Points without a row have the status ``missing``, failed ones NaN errors; parameters that are numbers in every
    row are numbers. A parameter that came after results were stored (`Method.younger`) has a column only where a
    point has an unusual value of it, so that older tables stay as they are.
    """
    import pandas as pd

    blank, parameters, keyed = dict[str, str](), set[str](), set[str]()
    for planned in _flows_of(plan):
        blank.update(dict.fromkeys(planned.labels, ""))
        parameters.update(planned.point.canonical)
        keyed.update(planned.point.spec["params"])
    columns: dict[str, list[Any]] = {}  # many points as records would take five times the memory
    for count, planned in enumerate(_flows_of(plan)):
        row = rows.get(planned.point.key)
        result = row.result if row else {}
        record: dict[str, Any] = {**blank, **planned.labels, **planned.point.canonical}
        record.update({name: result.get(name) for name in RESULT_COLUMNS})
        for name, errors in {**result.get("classes", {}), **result.get("masks", {})}.items():
            record.update({f"{metric}_{name}": errors[metric] for metric in METRICS})
        if "fl_all" in result:
            record["fl_all"] = result["fl_all"]
        record.update(result.get("fluid", {}))
        record["iterations"] = _total(result.get("iterations"))
        record["inner_iterations"] = _total(result.get("inner_iterations"))
        record["stop"] = result.get("stop")
        record["status"] = row.status if row else "missing"
        record["error"] = row.error if row else None
        record["key"] = planned.point.key
        for name in record:
            if name not in columns:
                columns[name] = [math.nan] * count
        for name, values in columns.items():
            values.append(record.get(name, math.nan))
    table = pd.DataFrame(columns)
    table = table.drop(columns=parameters - keyed)
    for column in table.columns:
        if column in METRICS or column in parameters:
            table[column] = _as_numbers(table[column])
    # A point that failed has no counts; those of the others stay whole numbers.
    return table.astype(dict.fromkeys((*COUNTS, "iterations", "inner_iterations"), "Int64"))


def _flows_of(plan: Plan) -> Iterator[PlannedPoint]:
    return (planned for planned in plan.points if planned.point.score not in MEASURES)


def _total(levels: Sequence[Sequence[int]] | None) -> int | None:
    return None if levels is None else sum(sum(level) for level in levels)


def _as_numbers(column: pd.Series) -> pd.Series:
    import pandas as pd

    try:
        return pd.to_numeric(column)
    except (ValueError, TypeError):
        return column
