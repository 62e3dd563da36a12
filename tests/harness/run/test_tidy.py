"""The tidy table beside a literal twin, which makes it of records, and its memory."""

from __future__ import annotations

import tracemalloc

import pandas as pd
import pytest

from fracbench.harness.run.plan import make_plan, plan_experiment
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import COUNTS, METRICS, tidy
from fracbench.model import SOLVER_VERSION


def row_of(point, status="done", error=None, **result):
    """Return a row as a worker would write it."""
    spec, identity = point.spec, point.identity
    return Row(
        key=point.key, identity=identity, spec=spec, solver_version=SOLVER_VERSION, status=status, error=error,
        result=result,
    )  # fmt: skip


@pytest.fixture
def planned():
    """Two methods with different parameters, a label that one part alone has, and rows of all kinds."""
    grids = {
        "one": ("sequence=synthetic_flat", "method=tvl1_sb_alpha", "alpha=1,1.25,1.5"),
        "two": ("sequence=synthetic_flat", "method=tvl1_sb,tvl1", "noise=0,2", "lambda=0.1"),
        "three": ("sequence=synthetic_flat", "method=tvl1_sb"),
    }
    plan = plan_experiment(grids, ("dataset=synthetic",), allow_download=False)
    points = [each.point for each in plan.points]
    errors = {"aae": 0.1, "aepe": 0.2, "sdae": 0.3, "n_pixels": 100, "n_unknown": 2, "n_nonfinite": 0}
    masks = {"matched": {"aae": 1.0, "aepe": 2.0, "sdae": None}}
    rows = [
        row_of(points[1], "failed", "no memory", aae=None),
        row_of(points[2], **errors, iterations=[[3, 4], [5]], inner_iterations=[[1], [2]], stop="max_iter"),
        row_of(points[3], **errors, masks=masks, fl_all=0.5, fluid={"vorticity": 0.25}, stop="tol"),
        row_of(points[6], **errors),
    ]
    return plan, {row.key: row for row in rows}


def twin(plan, rows):
    """Return the table of records, one by one; numbers and texts as in the files of results."""
    records = []
    names = [name for each in plan.points for name in each.labels]
    for each in plan.points:
        point, row = each.point, rows.get(each.point.key)
        result = row.result if row else {}
        record = dict.fromkeys(names, "") | dict(each.labels) | point.canonical
        record |= {name: result.get(name) for name in (*METRICS, *COUNTS)}
        for name, found in result.get("masks", {}).items():
            record |= {f"{metric}_{name}": found[metric] for metric in METRICS}
        record |= {"fl_all": result["fl_all"]} if "fl_all" in result else {}
        record |= result.get("fluid", {})
        for name in ("iterations", "inner_iterations"):
            record[name] = sum(map(sum, result[name])) if name in result else None
        record |= {"stop": result.get("stop"), "status": row.status if row else "missing"}
        records.append(record | {"error": row.error if row else None, "key": point.key})
    return pd.DataFrame(records)


def test_the_table_is_that_of_the_records(planned, tmp_path):
    table, expected = tidy(*planned), twin(*planned)
    hidden = [name for name in expected if name not in table]
    unchanged = {name for each in planned[0].points for name in each.point.usual}
    assert hidden and unchanged.issuperset(hidden)
    assert all(expected[name].dropna().nunique() == 1 for name in hidden)
    assert list(table) == [name for name in expected if name in table.columns]
    for name in table:
        numeric = table[name].dtype.kind in "if"
        shown = pd.to_numeric(expected[name]) if numeric else expected[name].astype(object)
        assert list(table[name].isna()) == list(shown.isna()), name
        assert table[name].dropna().tolist() == shown.dropna().tolist(), name
    assert table["alpha"].dtype == "float64" and table["n_warps"].dtype == "int64"
    assert [str(table[name].dtype) for name in (*COUNTS, "iterations")] == ["Int64"] * 4


def test_a_row_of_many_takes_half_a_kilobyte():
    plan = make_plan(["sequence=synthetic_flat", "alpha=0:2:0.01", "lambda=0.1:1:0.05"], allow_download=False)
    tidy(plan, {})  # imports
    tracemalloc.start()
    tidy(plan, {})
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / len(plan.points) < 700
