"""Stored tables: every changed number and every changed table is reported."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from refusals import refusal

from fracbench.harness.check import regression
from fracbench.harness.check.regression import COUNTED, check, compare, update
from fracbench.harness.check.tolerances import MEASURED, IllConditioned, Tolerance, Tolerances
from fracbench.harness.run.plan import make_plan
from fracbench.model import SOLVER_VERSION

GRID = (
    "sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=2", "theta={theta}", "alpha=0.5,1",
    "method=tvl1,tvl1_sb_alpha",
)  # fmt: skip
TOLERANCES = Tolerances({column: Tolerance(1e-6, 1e-3, "measured", "rounding") for column in MEASURED})
TOML = "\n".join(
    f'[{column}]\nabsolute = 1e-6\nrelative = 1e-3\nbasis = "measured"\nreason = "rounding"' for column in MEASURED
)


def table(**changes) -> pd.DataFrame:
    columns = {
        "sequence": ["grove2", "venus"],
        "method": ["tvl1", "tvl1"],
        "aae": ["0.1", "0.2"],
        "aepe": ["0.3", "0.4"],
        "sdae": ["0.5", "0.6"],
        "n_pixels": ["100", "200"],
        "n_unknown": ["1", "2"],
        "n_nonfinite": ["0", "0"],
        "status": ["done", "done"],
    }
    return pd.DataFrame(columns | changes)


def differences(stored: pd.DataFrame, found: pd.DataFrame) -> list[str]:
    return [str(difference) for difference in compare("t", stored, found, TOLERANCES).differences]


@pytest.fixture(autouse=True)
def mini(work, reference) -> None:
    """A new project with one tiny experiment and tolerances."""
    (work / "experiments").mkdir()
    (reference / "tolerances.toml").write_text(TOML)
    write_experiment(work, theta="0.3")


def write_experiment(work, theta, name="mini", grid=GRID):
    tokens = "\n".join(f"  - {token.format(theta=theta)}" for token in grid)
    (work / "experiments" / f"{name}.yaml").write_text(f"title: Mini\ngrid:\n{tokens}\n")


def store_table(name="mini", reason="first"):
    return update(name, reason, jobs=2)


def recheck(name="mini"):
    return check(name, jobs=2)


def files(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def made_up(reference, monkeypatch, fake_rows):
    """Recomputing gives made-up errors without delay; a test sets ``made_up["aepe"]``."""
    numbers = {"aepe": 0.2, "status": "done"}

    def recompute(plan, jobs, on_row=None):
        errors = (0.1, numbers["aepe"], 0.3)
        return fake_rows(plan, lambda labels, params: errors, status=numbers["status"])

    monkeypatch.setattr(regression, "recompute", recompute)
    return numbers


# -- cell by cell --------------------------------------------------------------------------------


def test_equal_tables_hold():
    verdict = compare("t", table(), table(), TOLERANCES)
    assert verdict.differences == []
    assert verdict.cells == 2 * 7


def test_the_order_of_rows_and_columns_does_not_matter():
    turned = table().iloc[::-1, ::-1]
    assert differences(table(), turned) == []


def test_a_number_within_its_tolerance_holds_and_beyond_it_does_not():
    assert differences(table(), table(aae=["0.1001", "0.2"])) == []
    assert differences(table(), table(aae=["0.0999", "0.2"])) == []
    (said,) = differences(table(), table(aae=["0.1", "0.20021"]))
    assert said == "venus, tvl1: aae: stored 0.2, found 0.20021 (allowed: 1e-06 + 0.001 of the stored)"
    assert differences(table(), table(aae=["0.1", "0.19979"])) != []


def test_the_tolerance_is_the_columns_own():
    tolerances = Tolerances({**TOLERANCES.columns, "sdae": Tolerance(1.0, 0.0, "b", "r")})
    moved = table(sdae=["1.4", "0.6"])
    assert compare("t", table(), moved, tolerances).differences == []
    assert compare("t", table(), moved, TOLERANCES).differences != []


@pytest.mark.parametrize("column", ["n_pixels", "n_unknown", "n_nonfinite"])
def test_counts_must_be_equal(column):
    before = table()[column][0]
    (said,) = differences(table(), table(**{column: ["101", table()[column][1]]}))
    assert said == f"grove2, tvl1: {column}: stored {before}, found 101 (allowed: equal)"


def test_a_point_that_failed_is_a_difference():
    (said,) = differences(table(), table(status=["done", "failed"]))
    assert said == "venus, tvl1: status: stored done, found failed (allowed: equal)"


@pytest.mark.parametrize("value", ["nan", "NaN", "", "inf", "about 0.1", "None"])
@pytest.mark.parametrize("side", ["stored", "found"])
def test_what_is_no_number_never_holds(value, side):
    spoiled = table(aae=[value, "0.2"])
    tables = (spoiled, table()) if side == "stored" else (table(), spoiled)
    (said,) = differences(*tables)
    assert said.startswith("grove2, tvl1: aae: stored ")
    assert repr(value)[1:-1] in said


@pytest.mark.parametrize("value", ["nan", "x", "inf"])
def test_what_is_no_number_does_not_even_equal_itself(value):
    spoiled = table(aae=[value, "0.2"])
    assert len(differences(spoiled, spoiled)) == 1


def test_a_missing_and_an_extra_row_are_differences():
    assert differences(table(), table().iloc[:1]) == [
        "venus, tvl1: row: stored present, found missing (allowed: the same rows)"
    ]
    assert differences(table().iloc[:1], table()) == [
        "venus, tvl1: row: stored missing, found present (allowed: the same rows)"
    ]
    assert len(differences(table(), table(sequence=["grove2", "urban2"]))) == 2
    assert len(differences(table(), table().iloc[:0])) == 2


@pytest.mark.parametrize("column", [*MEASURED, *COUNTED, "method", "sequence"])
def test_a_missing_and_an_extra_column_are_differences(column):
    less = table().drop(columns=column)
    missing = differences(table(), less)
    assert f"all rows: {column}: stored present, found missing (allowed: the same columns)" in missing
    extra = differences(less, table())
    assert f"all rows: {column}: stored missing, found present (allowed: the same columns)" in extra


@pytest.mark.parametrize("column", [*MEASURED, *COUNTED])
def test_a_column_that_both_lack_is_a_difference(column):
    less = table().drop(columns=column)
    assert len(differences(less, less)) == len(less)


def test_a_column_that_nobody_knows_is_a_difference():
    assert len(differences(table(), table(median=["1", "2"]))) == 1
    assert len(differences(table(median=["1", "2"]), table())) == 1


def test_rows_that_cannot_be_told_apart_are_a_difference():
    twice = pd.concat([table(), table().iloc[:1]])
    assert differences(twice, table()) == ["all rows: keys: stored 3, found 2 (allowed: distinct rows)"]
    assert differences(table(), twice) == ["all rows: keys: stored 2, found 3 (allowed: distinct rows)"]
    assert differences(twice, twice) == ["all rows: keys: stored 3, found 3 (allowed: distinct rows)"]


def test_what_is_not_finite_is_outside_every_tolerance():
    wide = Tolerance(1e9, 1e9, "b", "r")
    assert wide.allows(1.0, 2.0)
    assert not wide.allows(1.0, float("inf"))
    assert not wide.allows(float("inf"), float("inf"))
    assert not wide.allows(float("nan"), 1.0)
    assert not wide.allows(1.0, float("nan"))


# -- check and update ----------------------------------------------------------------------------


def test_a_stored_table_holds_until_a_parameter_changes(reference, work):
    """The whole check: compute, store, compute again and compare, then with theta larger by 1 %."""
    paths = store_table()
    assert paths == [reference / "mini.csv", reference / "mini.json"]
    stored = pd.read_csv(paths[0])
    assert list(stored) == ["part", "protocol", "sequence", "region", "method", "alpha", *MEASURED, *COUNTED]
    # TV-L1 does not depend on alpha: it has one row.
    assert [*zip(stored["method"], stored["alpha"].fillna(-1), strict=True)] == [
        ("tvl1", -1),
        ("tvl1_sb_alpha", 0.5),
        ("tvl1_sb_alpha", 1),
    ]
    verdict = recheck()
    assert (verdict.differences, verdict.skipped, verdict.cells) == ([], "", 3 * 7)
    write_experiment(work, theta="0.303")
    moved = recheck().differences
    assert "main, reference, synthetic_flat, tvl1_sb_alpha, 1.0" in {difference.row for difference in moved}
    assert {difference.column for difference in moved} <= set(MEASURED)
    for difference in moved:
        assert difference.allowed == "1e-06 + 0.001 of the stored"
        assert abs(float(difference.found) / float(difference.stored) - 1) > 0.001


def test_a_table_stored_again_is_the_same_bytes(reference):
    path, _ = store_table()
    first = path.read_bytes()
    store_table(reason="again")
    again = path.read_bytes()
    assert first == again
    assert first.endswith(b"\n") and b"\r" not in first


def test_stored_numbers_have_nine_digits(reference, made_up):
    made_up["aepe"] = 2 / 3
    store_table()
    assert set(pd.read_csv(reference / "mini.csv", dtype=str)["aepe"]) == {"0.666666667"}


def test_an_update_records_why(reference, made_up):
    store_table(reason="first")
    made_up["aepe"] = 0.25
    assert recheck().differences
    store_table(reason="faster solver")
    assert recheck().differences == []
    entries = json.loads((reference / "mini.json").read_text())
    assert [entry["reason"] for entry in entries] == ["first", "faster solver"]
    for entry in entries:
        assert entry["solver_version"] == SOLVER_VERSION
        assert {"date", "commit", "dirty", "cpu", "python", "versions", "threads"} <= set(entry)


@pytest.mark.parametrize("reason", ["", "  \n"])
def test_an_update_needs_a_reason(reference, reason):
    assert '--reason "why' in refusal(lambda: store_table(reason=reason))
    assert files(reference) == ["tolerances.toml"]


def test_nothing_is_stored_of_points_that_failed(reference, made_up):
    made_up["status"] = "crashed"
    said = refusal(store_table)
    assert "mini: 3 points are not done (first: made up); nothing was written" in said
    assert files(reference) == ["tolerances.toml"]


def test_nothing_is_stored_outside_a_checkout(reference, made_up, monkeypatch):
    monkeypatch.setattr(regression, "checkout", lambda: None)
    assert "no checkout to write to" in refusal(store_table)
    assert files(reference) == ["tolerances.toml"]


def test_a_damaged_history_is_refused_and_kept(reference, made_up):
    (reference / "mini.json").write_text("[")
    assert "mini.json: cannot be read as JSON" in refusal(store_table)
    assert (reference / "mini.json").read_text() == "["
    assert not (reference / "mini.csv").exists()


def test_points_that_fail_are_told_apart_from_those_that_hold(reference, made_up, monkeypatch, fake_rows):
    store_table()

    def one_fails(plan, jobs, on_row=None):
        rows = fake_rows(plan)
        key = plan.points[1].point.key
        return rows | {key: fake_rows(plan, status="failed")[key]}

    monkeypatch.setattr(regression, "recompute", one_fails)
    moved = recheck().differences
    assert {difference.row for difference in moved} == {"main, reference, synthetic_flat, tvl1_sb_alpha, 0.5"}
    assert {difference.column for difference in moved} == {*MEASURED, *COUNTED}
    monkeypatch.setattr(regression, "recompute", lambda plan, *_: fake_rows(plan, status="failed"))
    assert len(recheck().differences) == 3 * 7


def test_every_table_is_listed(reference, made_up):
    assert regression.stored_tables() == []
    store_table()
    store_table("mini_synthetic")
    assert regression.stored_tables() == ["mini", "mini_synthetic"]


def test_a_table_of_which_only_the_record_is_left_does_not_hold(reference, made_up):
    store_table()
    (reference / "mini.csv").unlink()
    assert regression.stored_tables() == ["mini"]
    (said,) = recheck().differences
    assert str(said) == "all rows: table: stored missing, found present (allowed: the same tables)"


def test_ill_conditioned_rows_have_a_tolerance_of_their_own():
    rows = IllConditioned("t", "venus, *", {"aae": 0.1}, "two basins")
    tolerances = Tolerances(TOLERANCES.columns, (rows,))
    assert compare("t", table(), table(aae=["0.1", "0.21"]), tolerances).differences == []
    for name, moved in (("t", ["0.105", "0.2"]), ("u", ["0.1", "0.21"]), ("t", ["0.1", "0.23"])):
        assert len(compare(name, table(), table(aae=moved), tolerances).differences) == 1
    (said,) = compare("t", table(), table(aae=["0.1", "0.23"]), tolerances).differences
    assert said.allowed == "1e-06 + 0.1 of the stored"


def test_an_unknown_table_offers_the_nearest(reference, made_up):
    store_table()
    assert "unknown stored table 'mimi': did you mean 'mini'?" in refusal(lambda: recheck("mimi"))
    assert "unknown experiment 'mimi'" in refusal(lambda: store_table("mimi"))


@pytest.mark.parametrize("content", [b"", b'a,"b\n', b"\xff\xfe,\xff\n", b"a,b\n1,2,3\n1\n"])
def test_a_stored_table_that_cannot_be_read_is_refused(reference, made_up, content):
    (reference / "mini.csv").write_bytes(content)
    if content.startswith(b"a,b\n"):  # readable, but not a table: no cell of it holds
        assert recheck().differences
    else:
        assert "mini.csv: cannot be read as a table" in refusal(recheck)


def test_an_empty_table_does_not_hold(reference, made_up):
    store_table()
    path = reference / "mini.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    assert len(recheck().differences) == 3


# -- which data ----------------------------------------------------------------------------------


def test_a_table_of_middlebury_is_skipped_without_middlebury(reference, work, no_middlebury):
    write_experiment(work, "0.3", "paper", ("sequence=grove2", "max_iter=1"))
    (reference / "paper.csv").write_text("sequence,aae\ngrove2,1\n")
    verdict = recheck("paper")
    assert verdict.skipped == "the Middlebury data cannot be had here"
    assert (verdict.cells, verdict.differences) == (0, [])
    assert "paper: the Middlebury data cannot be had here" in refusal(lambda: store_table("paper"))


def test_a_table_of_stand_ins_is_one_of_its_own(reference, work, no_middlebury):
    write_experiment(work, "0.3", "paper", ("sequence=grove2", "max_iter=1"))
    plan = regression.plan_of("paper_synthetic")
    assert plan.dataset == "synthetic"
    assert plan.points[0].point.key == make_plan(["sequence=grove2", "max_iter=1"]).points[0].point.key
    assert regression.plan_of("paper") is None
    assert regression.plan_of("mini") is not None  # asks for rendered scenes by name
