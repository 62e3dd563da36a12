"""`fracbench check` detects small changes of the numerics.

Each test computes some rows of the project's own stored tables, once as the package is and once with a change
made to it, and compares them as the command does, with the project's own tolerances.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fracbench.data import gray
from fracbench.data.datasets import middlebury
from fracbench.errors import DataError
from fracbench.evaluation import metrics
from fracbench.harness.check import regression
from fracbench.harness.check.regression import Verdict, check
from fracbench.harness.run import compute_point
from fracbench.harness.run.grid_points import PlannedPoint, PlannedPoints
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.model import SOLVER_VERSION
from fracbench.model.operators import zero

Part = tuple[str, dict[str, set[str]]]  # a stored table, and which of its rows

SCENES: Part = ("table2_synthetic", {"protocol": {"reference"}, "sequence": {"synthetic_flat", "synthetic_edge"}})
CURVES: Part = ("regions_synthetic", {"region": {"urban3_A"}, "alpha": {"0.6", "1.4", "1.8"}})
COLOUR: Part = ("regions", {"region": {"rubberwhale_A"}, "alpha": {"1.2"}})  # Middlebury is in colour,
UNKNOWN: Part = ("regions", {"region": {"hydrangea_A"}, "alpha": {"1.2"}})  # and has pixels of unknown flow


def forget() -> None:
    """Empty every cache that could hold a value from before a change."""
    for name, module in list(sys.modules.items()):
        if name.startswith("fracbench.model") or module is compute_point:
            for thing in vars(module).values():
                getattr(thing, "cache_clear", lambda: None)()


@pytest.fixture(autouse=True)
def anew():
    forget()
    yield
    forget()


@pytest.fixture
def checked(monkeypatch) -> Callable[..., Verdict]:
    """`fracbench check` on a part of a stored table, in this process, where a change can reach it."""
    read, plan_of = regression.read_table, regression.plan_of

    def run(part: Part, change: Callable[[Point], Point] = lambda point: point) -> Verdict:
        name, wanted = part

        def is_wanted(planned: PlannedPoint) -> bool:
            known = {**planned.point.canonical, **planned.labels}
            return all(known[key] in values for key, values in wanted.items())

        def plan(name: str) -> Plan:
            whole = plan_of(name)
            return replace(whole, points=PlannedPoints(list(filter(is_wanted, whole.points))))

        def stored(path):
            table = read(path)
            for column, values in wanted.items():
                table = table[table[column].isin(values)]
            assert not table.empty
            return table

        def recompute(plan: Plan, jobs: int, on_row=None) -> dict[str, Row]:
            points = plan.unique().items()
            return {key: row(point, compute_point.run_point(change(point), plan.folder)) for key, point in points}

        monkeypatch.setattr(regression, "plan_of", plan)
        monkeypatch.setattr(regression, "read_table", stored)
        monkeypatch.setattr(regression, "recompute", recompute)
        return check(name, jobs=1)

    return run


def row(point: Point, outcome: compute_point.Outcome) -> Row:
    assert outcome.error is None, outcome.error
    return Row(
        key=point.key,
        identity=point.identity,
        spec=point.spec,
        solver_version=SOLVER_VERSION,
        status=outcome.status,
        result=outcome.result,
    )


def columns(verdict: Verdict) -> set[str]:
    return {difference.column for difference in verdict.differences}


@pytest.fixture
def data(middlebury, monkeypatch):
    """The Middlebury data, or a skip."""
    monkeypatch.setenv("FRACBENCH_DATA", str(middlebury))


# -- on the rendered scenes ----------------------------------------------------------------------


@pytest.mark.parametrize("part", [SCENES, CURVES])
def test_what_is_not_changed_holds(checked, part):
    verdict = checked(part)
    assert verdict.cells > 0
    assert [str(difference) for difference in verdict.differences] == []


@pytest.mark.parametrize("part", [SCENES, CURVES])
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_theta_changed_by_one_per_cent_is_seen(checked, part, factor):
    def change(point: Point) -> Point:
        return replace(point, params=point.params.replace({"theta": factor * point.params.theta}))

    assert columns(checked(part, change)) & {"aae", "aepe", "sdae"}


@pytest.mark.parametrize("shift", [-1, 1])
def test_the_recurrence_of_the_weights_shifted_by_one_index_is_seen(checked, monkeypatch, shift):
    def weights(alpha: float, n: int):
        w = np.ones(n)
        for k in range(1, n):
            w[k] = (1.0 - (alpha + 1.0) / max(k + shift, 1)) * w[k - 1]
        return w

    monkeypatch.setattr(zero, "gl_weights", weights)
    assert columns(checked(CURVES)) >= {"aae", "aepe", "sdae"}


def test_the_weights_of_this_test_are_the_packages_but_for_the_shift(checked, monkeypatch):
    """This shows that the test before detects the shift alone."""

    def weights(alpha: float, n: int):
        return np.cumprod([1.0, *(1.0 - (alpha + 1.0) / k for k in range(1, n))])

    monkeypatch.setattr(zero, "gl_weights", weights)
    assert checked(CURVES).differences == []


def test_a_border_left_out_of_the_metric_is_seen(checked, monkeypatch):
    whole = metrics._checked_mask

    def inner(mask, shape):
        inside = whole(mask, shape).copy()
        inside[:, 0] = False
        return inside

    monkeypatch.setattr(metrics, "_checked_mask", inner)
    assert "n_pixels" in columns(checked(SCENES))


# -- on Middlebury -------------------------------------------------------------------------------


@pytest.mark.middlebury
@pytest.mark.parametrize("part", [COLOUR, UNKNOWN])
def test_what_is_not_changed_holds_on_middlebury(data, checked, part):
    assert checked(part).differences == []


@pytest.mark.middlebury
@pytest.mark.parametrize(
    "formula",
    [
        lambda r, g, b: (299 * r + 587 * g + 114 * b + 500) // 1000,
        lambda r, g, b: (2126 * r + 7152 * g + 722 * b) // 10000,
        lambda r, g, b: (r + g + b) // 3,
    ],
    ids=["rounded", "Rec. 709", "mean"],
)
def test_another_formula_for_gray_is_seen(data, checked, monkeypatch, formula):
    def to_gray(image, name="frame"):
        return formula(*np.moveaxis(np.asarray(image, np.int64), 2, 0)).astype(np.float64)

    monkeypatch.setattr(gray, "to_gray", to_gray)
    assert columns(checked(COLOUR)) & {"aae", "aepe", "sdae"}


@pytest.mark.middlebury
def test_unknown_pixels_that_are_scored_are_seen(data, checked, monkeypatch):
    checked_flows = metrics._checked
    monkeypatch.setattr(metrics, "_checked", lambda *flows: tuple(map(np.nan_to_num, checked_flows(*flows))))
    assert columns(checked(UNKNOWN)) >= {"aae", "aepe", "sdae", "n_pixels", "n_unknown"}


def test_without_middlebury_the_skip_can_be_seen(cli, no_middlebury, monkeypatch):
    monkeypatch.delenv("FRACBENCH_DATA", raising=False)
    with pytest.raises(DataError):
        middlebury.find()
    said = cli("check", "table2", "regions")
    reason = "SKIPPED: the Middlebury data cannot be had here"
    assert said.out == f"table2: {reason}\nregions: {reason}\n"
    assert said.code == 1
