"""Tolerances: each has a basis and a reason, and follows from the measured spreads by one rule."""

from __future__ import annotations

import json
import subprocess
import sys

import pandas as pd
import pytest
from refusals import refusal

from fracbench.harness.check import tolerances
from fracbench.harness.check.tolerances import (
    MEASURED,
    NO_REASON,
    IllConditioned,
    Tolerance,
    Tolerances,
    derive,
    load_spreads,
    load_tolerances,
    outdated,
    rounded_up,
    to_toml,
    write,
)
from fracbench.harness.config.paths import asset

TOML = "\n".join(
    f'[{column}]\nabsolute = 1e-6\nrelative = 1e-3\nbasis = "measured"\nreason = "rounding"\n'
    for column in MEASURED
)
ROWS = '[[rows]]\ntable = "t"\nrows = "grove2, *"\nrelative = { aepe = 0.05 }\nreason = "two basins"\n'
ORIGIN = {"solver_version": 7, "cpu": "Abacus"}
TYPED = Tolerances({column: Tolerance(1e-6, 1e-3, "measured", "rounding") for column in MEASURED})


def spreads(values, column="aepe", under="float64") -> pd.DataFrame:
    """A table of spreads: those of one column as given, of the others 0."""
    records = [
        {"row": f"row {i}", "column": name, "two threads": 0.0, under: value if name == column else 0.0}
        for i, value in enumerate(values)
        for name in MEASURED
    ]
    return pd.DataFrame(records)


# -- the file ------------------------------------------------------------------------------------


def test_tolerances_are_read(reference):
    (reference / "tolerances.toml").write_text(TOML + ROWS)
    read = load_tolerances()
    assert read.columns == {column: Tolerance(1e-6, 1e-3, "measured", "rounding") for column in MEASURED}
    assert read.of("t", "grove2, tvl1", "aepe") == Tolerance(1e-6, 0.05, "measured", "rounding")
    assert read.of("t", "grove2, tvl1_sb", "aepe").relative == 0.05
    for other in (("u", "grove2, tvl1", "aepe"), ("t", "venus, tvl1", "aepe"), ("t", "grove2, tvl1", "aae")):
        assert read.of(*other).relative == 1e-3


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('reason = "rounding"', ""),
        ('reason = "rounding"', 'reason = " "'),
        ('basis = "measured"', ""),
        ('basis = "measured"', 'basis = ""'),
        ("absolute = 1e-6", ""),
        ("absolute = 1e-6", "absolute = -1e-6"),
        ("relative = 1e-3", "relative = inf"),
        ("relative = 1e-3", "relative = nan"),
        ("relative = 1e-3", 'relative = "1e-3"'),
        ("relative = 1e-3", "relativ = 1e-3"),
        ("[aepe]", "[apee]"),
        ("[aepe]", "[aepe"),
        ("[aepe]", "[aae]"),
        ("{ aepe = 0.05 }", "{ apee = 0.05 }"),
        ("{ aepe = 0.05 }", "{}"),
        ("{ aepe = 0.05 }", "0.05"),
        ("aepe = 0.05", "aepe = nan"),
        ("aepe = 0.05", 'aepe = "wide"'),
        ('reason = "two basins"', 'reason = ""'),
        ('reason = "two basins"', ""),
        ('rows = "grove2, *"', ""),
        ("[[rows]]", "[rows]"),
    ],
)
def test_a_tolerance_without_all_it_needs_is_refused(reference, old, new):
    assert old in TOML + ROWS
    (reference / "tolerances.toml").write_text((TOML + ROWS).replace(old, new, 1))
    assert "each of aae, aepe, sdae needs absolute, relative, basis, reason" in refusal(load_tolerances)


@pytest.mark.parametrize("content", [None, b"\xff\xfe"])
def test_no_tolerances_at_all_are_refused(reference, content):
    if content is not None:
        (reference / "tolerances.toml").write_bytes(content)
    assert "tolerances.toml" in refusal(load_tolerances)


# -- the rule ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1.1e-3, 2e-3),
        (2e-3, 2e-3),
        (3 * 2e-4, 6e-4),
        (2.01e-3, 3e-3),
        (9.1e-3, 1e-2),
        (1.0, 1.0),
        (0.0, 1e-5),
        (3e-6, 1e-5),
        (9.5, 10.0),
    ],
)
def test_rounding_up_to_one_digit(value, expected):
    assert rounded_up(value) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("value", [float("inf"), float("nan"), -1.0])
def test_what_is_not_finite_has_no_tolerance(value):
    with pytest.raises(ValueError, match="a spread must be finite"):
        rounded_up(value)


def test_a_column_covers_all_rows_but_those_that_are_ill_conditioned():
    """Rows that differ in the last value only are judged together; the rest sets the column's tolerance."""
    usual, curve = spreads([1e-4] * 9 + [6e-4]), spreads([1e-5, 2e-2])
    curve["row"] = "main, " + curve["row"]
    found = derive({"t": usual, "u": curve}, TYPED)
    assert found.columns["aepe"].relative == pytest.approx(2e-3)  # 3 x 6e-4
    assert found.columns["aae"].relative == 1e-5
    assert found.rows == (IllConditioned("u", "main, *", {"aepe": 0.06}, NO_REASON),)
    assert found.of("u", "main, row 0", "aepe").relative == pytest.approx(0.06)
    assert found.of("u", "main, row 0", "aae") == found.columns["aae"]
    basis = found.columns["aepe"].basis
    assert basis.startswith("3 times 6.0e-04, the largest relative spread of 10 cells (t, u)")
    assert basis.endswith("2 cells are in ill-conditioned rows")


def test_a_column_is_never_wider_than_the_limit():
    limit = tolerances.WIDEST["aepe"] / tolerances.MARGIN
    assert derive({"t": spreads([0.99 * limit])}, TYPED).rows == ()
    (rows,) = derive({"t": spreads([1.01 * limit])}, TYPED).rows
    assert rows.relative == {"aepe": pytest.approx(0.006)}


def test_the_largest_spread_under_any_circumstance_counts():
    one, other = spreads([1e-3]), spreads([1.5e-3], under="kernels")
    both = one.merge(other, on=["row", "column", "two threads"])
    assert derive({"t": both}, TYPED).columns["aepe"].relative == pytest.approx(5e-3)
    assert derive({"t": one}, TYPED).columns["aepe"].relative == pytest.approx(3e-3)


# -- writing -------------------------------------------------------------------------------------


def test_what_is_written_is_read_and_the_reasons_stay(reference):
    (reference / "tolerances.toml").write_text(TOML)
    paths = write({"t": spreads([1e-4] * 60 + [1e-2])}, ORIGIN)
    assert paths == [
        reference / "spread" / "t.csv",
        reference / "spread" / "t.json",
        reference / "tolerances.toml",
    ]
    assert json.loads(paths[1].read_text()) == ORIGIN
    read = load_tolerances()
    assert {tolerance.reason for tolerance in read.columns.values()} == {"rounding"}
    assert read.columns["aepe"].relative == pytest.approx(3e-4)
    assert read.rows == (IllConditioned("t", "row 60", {"aepe": 0.03}, NO_REASON),)
    path = reference / "tolerances.toml"
    path.write_text(path.read_text().replace(NO_REASON, "two basins"))
    write({"t": spreads([1e-4] * 60 + [2e-2])}, ORIGIN)
    assert load_tolerances().rows[0].reason == "two basins"


def test_the_spreads_of_other_tables_count_on(reference):
    (reference / "tolerances.toml").write_text(TOML)
    write({"t": spreads([1.5e-3])}, ORIGIN)
    write({"u": spreads([1e-4])}, ORIGIN)
    assert load_tolerances().columns["aepe"].relative == pytest.approx(5e-3)
    write({"t": spreads([1e-4])}, ORIGIN)
    assert load_tolerances().columns["aepe"].relative == pytest.approx(3e-4)


def test_what_this_machine_cannot_measure_stays(reference):
    """Kernels for another processor, and spreads that another processor has stored."""
    (reference / "tolerances.toml").write_text(TOML)
    write({"t": spreads([1.5e-3], under="SkylakeX")}, ORIGIN)
    write({"t": spreads([1e-4, 2e-4])}, ORIGIN)
    table = load_spreads()["t"].set_index(["row", "column"])
    assert list(table.columns) == ["two threads", "float64", "SkylakeX"]
    assert table.loc[("row 0", "aepe")].tolist() == [0, 1e-4, 1.5e-3]
    assert table.loc[("row 1", "aepe")].tolist() == [0, 2e-4, 0]
    assert load_tolerances().columns["aepe"].relative == pytest.approx(5e-3)
    write({"t": spreads([1e-4])}, ORIGIN | {"solver_version": 8})
    assert list(load_spreads()["t"].columns) == ["row", "column", "two threads", "float64"]


def test_a_spread_of_other_numerics_is_outdated(reference):
    (reference / "tolerances.toml").write_text(TOML)
    write({"t": spreads([1e-4])}, ORIGIN)
    assert outdated(["t", "u"], 7) == ["u"]
    assert outdated(["t"], 8) == ["t"]


def test_nothing_is_written_of_a_spread_that_is_not_finite(reference):
    (reference / "tolerances.toml").write_text(TOML)
    assert "no tolerance follows from the measured spreads" in refusal(
        lambda: write({"t": spreads([float("inf")])}, ORIGIN)
    )
    assert [path.name for path in reference.iterdir()] == ["tolerances.toml"]


@pytest.mark.parametrize("text", ["", "row,column\na,b,c,d\n", "row,aae\na,1\n", "row,column,x\na,aae,b\n"])
def test_a_table_of_spreads_that_is_none_is_refused(reference, text):
    (reference / "spread").mkdir()
    (reference / "spread" / "t.csv").write_text(text)
    assert "t.csv: no table of spreads" in refusal(load_spreads)


# -- those of the project ------------------------------------------------------------------------


def test_the_projects_tolerances_follow_from_its_spreads():
    """No number in the file is typed by hand."""
    stored = load_tolerances()
    found = derive(load_spreads(), stored)
    assert found == stored
    assert asset("results/reference/tolerances.toml").read_text(encoding="utf-8") == to_toml(found)
    assert NO_REASON not in {rows.reason for rows in stored.rows}


def test_the_projects_tolerances_are_tight():
    """One per cent more or less theta moves errors by some per cent: a tolerance must not hide it."""
    stored = load_tolerances()
    assert all(tolerance.relative <= tolerances.WIDEST[name] <= 1e-2 for name, tolerance in stored.columns.items())
    cells = [(name, *cell) for name, table in load_spreads().items() for cell in table[["row", "column"]].values]
    assert len(stored.rows) <= 10
    assert sum(stored.of(*cell).relative > 1e-2 for cell in cells) < 0.12 * len(cells)


def test_tolerances_are_imported_without_pandas():
    """The commands of the check plan before they need it."""
    code = "import sys; import fracbench.harness.check.tolerances; sys.exit('pandas' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
