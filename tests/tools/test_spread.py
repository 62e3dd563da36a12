"""The spread of a table: computed in processes of their own, compared with the usual one cell by cell."""

from __future__ import annotations

import json
import math
import re

import pytest
import spread
from spread import (
    CIRCUMSTANCES,
    USUAL,
    Circumstance,
    measure,
    results_of,
    spreads,
    summary,
)

from fracbench.errors import FracbenchError, InputError
from fracbench.harness.check import regression, tolerances
from fracbench.harness.run.compute_point import run_point
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.provenance import machine
from fracbench.model import SOLVER_VERSION

GRID = ["sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=3", "method=tvl1_sb_alpha", "alpha=0.5,1"]


def cells(aae, aepe="0.5", sdae="0.25") -> dict[str, str]:
    return {"aae": aae, "aepe": aepe, "sdae": sdae}


@pytest.fixture
def mini(monkeypatch):
    """A stored table of two points; `answers` gives the result of each circumstance."""
    plan = make_plan(GRID)
    monkeypatch.setattr(spread, "plan_of", lambda name: plan)
    return plan


def test_the_circumstances_are_those_that_must_not_matter():
    names = {one.name for one in CIRCUMSTANCES}
    assert {"two threads", "float64", "BLAS for Nehalem", "BLAS for Haswell", "BLAS for SkylakeX"} < names
    assert Circumstance("usual", {}, threads=1, dtype="", kernel="", nudge=0.0) == USUAL
    assert {one.environment.get("OPENBLAS_CORETYPE", "") for one in CIRCUMSTANCES} >= {"Nehalem", "SkylakeX"}
    assert {abs(one.nudge) for one in CIRCUMSTANCES} == {0.0, 1e-6, 2e-6}  # far below what a table prints


def test_differences_are_relative_to_the_usual_number():
    tables = {"usual": {"a": cells("2.0"), "b": cells("4.0")}, "float64": {"a": cells("2.0"), "b": cells("4.1")}}
    table = spreads(tables)
    assert table[["row", "column"]].values.tolist()[:2] == [["a", "aae"], ["a", "aepe"]]
    assert table["float64"].tolist() == pytest.approx([0, 0, 0, 0.025, 0, 0])
    (line,) = summary("t", table)
    assert line == {"table": "t", "under": "float64", "aae": "2.5e-02", "aepe": "0.0e+00", "sdae": "0.0e+00"}


@pytest.mark.parametrize(("usual", "other"), [("nan", "nan"), ("1", "inf"), ("1", ""), ("", "1"), ("0", "1e-9")])
def test_what_cannot_be_compared_has_an_infinite_spread(usual, other):
    table = spreads({"usual": {"a": cells(usual)}, "float64": {"a": cells(other)}})
    assert math.isinf(table["float64"][0])


def test_a_row_that_is_missing_has_an_infinite_spread():
    table = spreads({"usual": {"a": cells("1"), "b": cells("1")}, "float64": {"a": cells("1")}})
    assert [math.isinf(value) for value in table["float64"]] == [False] * 3 + [True] * 3


def test_rows_are_called_as_in_the_check(mini, monkeypatch):
    result = {"aae": 0.1, "aepe": 0.2, "sdae": 0.3, "n_pixels": 1, "n_unknown": 0, "n_nonfinite": 0}
    asked = []

    def answer(name, circumstance):
        asked.append(circumstance.name)
        moved = result | ({"aepe": 0.3} if circumstance.dtype else {})
        return None if circumstance.kernel == "SkylakeX" else dict.fromkeys(mini.unique(), moved)

    monkeypatch.setattr(spread, "_in_a_process", answer)
    done = []
    table = measure(["mini"], jobs=2, on_done=done.append)["mini"]
    assert sorted(asked) == sorted(one.name for one in (USUAL, *CIRCUMSTANCES))
    assert len(done) == len(asked)
    assert table["row"].unique().tolist() == [
        "reference, synthetic_flat, tvl1_sb_alpha, 0.5",
        "reference, synthetic_flat, tvl1_sb_alpha, 1.0",
    ]
    assert "BLAS for SkylakeX" not in table.columns  # this machine does not have it
    assert table.loc[table["column"] == "aepe", "float64"].tolist() == pytest.approx([0.5, 0.5])


def test_what_another_processor_has_stored_counts_if_it_has_the_same_rows():
    usual = {"usual": {"a": cells("2.0")}, "float64": {"a": cells("2.0")}}
    table = spreads(usual, {"as stored from Abacus": {"a": cells("2.2")}, "as stored from Z3": {"b": cells("9")}})
    assert table["as stored from Abacus"].tolist() == pytest.approx([0.1, 0, 0])
    assert list(table.columns) == ["row", "column", "float64", "as stored from Abacus"]


@pytest.mark.parametrize(
    ("record", "found"),
    [
        ({"cpu": "Abacus", "solver_version": SOLVER_VERSION}, True),
        ({"cpu": machine()["cpu"], "solver_version": SOLVER_VERSION}, False),
        ({"cpu": "Abacus", "solver_version": SOLVER_VERSION - 1}, False),
        (None, False),
    ],
)
def test_what_is_stored_from_another_processor(reference, record, found):
    (reference / "t.csv").write_text("sequence,aae,aepe,sdae\nvenus,1,2,3\n")
    if record:
        (reference / "t.json").write_text(json.dumps([record | {"cpu": "Z3"}, record]))
    cells = {"sequence": "venus", "aae": "1", "aepe": "2", "sdae": "3"}
    assert spread.stored_elsewhere("t") == ({"as stored from Abacus": {"venus": cells}} if found else {})


def test_a_table_that_cannot_be_computed_at_all_is_an_error(mini, monkeypatch):
    monkeypatch.setattr(spread, "_in_a_process", lambda *_: None)
    with pytest.raises(FracbenchError, match="even under the usual circumstances"):
        measure(["mini"], jobs=1)


def test_a_table_without_its_data_is_refused(monkeypatch):
    monkeypatch.setattr(spread, "plan_of", lambda name: None)
    with pytest.raises(InputError, match="table2: the Middlebury data cannot be had here"):
        measure(["table2"], jobs=1)


def test_the_usual_circumstances_are_those_of_the_check():
    """The baseline of the spreads equals the values of `fracbench check` to the bit."""
    plan = make_plan(GRID)
    results = results_of(plan, 1, "")
    for key, point in plan.unique().items():
        outcome = run_point(point, None)
        assert {name: outcome.result[name] for name in results[key]} == results[key]
    assert results_of(plan, 1, "float64") != results
    nudged = results_of(plan, 1, "", 1e-6)
    for key, errors in results.items():
        assert nudged[key] != errors
        assert nudged[key]["aepe"] == pytest.approx(errors["aepe"], rel=1e-3)


def test_threads_reach_the_solver(monkeypatch):
    from fracbench.model import regularizers
    from fracbench.model.kernels import threads
    from fracbench.model.kernels.threads import count, parallel_map

    seen = []
    monkeypatch.setattr(threads, "LEAST_PIXELS", 0)
    monkeypatch.setattr(regularizers, "parallel_map", lambda *args: seen.append(count()) or parallel_map(*args))
    plan = make_plan(["sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1", "boundary=reflect"])
    results_of(plan, 2, "")
    assert set(seen) == {2}


def test_a_process_takes_on_its_circumstance(monkeypatch):
    """The kernel asked for is used, or the circumstance is left out, as for an unknown name."""
    name = regression.stored_tables()[-1]
    assert name == "table2_synthetic"
    calls = {}

    class Done:
        returncode, stdout = 0, '{"kernels": ["Haswell"], "results": {}}'

    def call(command, *, env, **_):
        calls.update(command=command, env=env)
        return Done

    monkeypatch.setattr(spread.subprocess, "run", call)
    haswell = next(one for one in CIRCUMSTANCES if one.kernel == "Haswell")
    assert spread._in_a_process(name, haswell) == {}
    assert calls["command"][1:] == [spread.__file__, "--answer", name, "1", "", "0.0"]
    assert calls["env"]["OPENBLAS_CORETYPE"] == "Haswell" and calls["env"]["OPENBLAS_NUM_THREADS"] == "1"
    nehalem = next(one for one in CIRCUMSTANCES if one.kernel == "Nehalem")
    assert spread._in_a_process(name, nehalem) is None
    Done.returncode = -4
    assert spread._in_a_process(name, haswell) is None


def test_the_spread_is_measured_and_the_tolerances_follow(work, tiny, reference, capsys, monkeypatch):
    grid = ", ".join([*tiny, "'alpha=0.5,1'"])
    (work / "experiments").mkdir()
    (work / "experiments" / "mini.yaml").write_text(f"title: Mini\ngrid: [{grid}]\n")
    tolerance = 'absolute = 1e-6\nrelative = 1e-3\nbasis = "b"\nreason = "r"\n'
    (reference / "tolerances.toml").write_text("".join(f"[{name}]\n{tolerance}" for name in tolerances.MEASURED))
    (reference / "mini.csv").write_text("sequence,aae,aepe,sdae\n")

    def answer(name, circumstance):
        moved = 0.00025 if circumstance.dtype else 0.0
        result = {"aae": 0.1, "aepe": 0.2 + moved, "sdae": 0.3, "n_pixels": 1, "n_unknown": 0, "n_nonfinite": 0}
        return dict.fromkeys(regression.plan_of(name).unique(), result)

    monkeypatch.setattr(spread, "_in_a_process", answer)
    before = sorted(reference.rglob("*"))
    assert spread.main([]) == 0
    assert re.search(r"mini +│ float64 +│ 0.0e\+00 │ 1.[23]e-03 │ 0.0e\+00", capsys.readouterr().out)
    assert sorted(reference.rglob("*")) == before
    assert spread.main(["mini", "--update"]) == 0
    out = capsys.readouterr().out
    assert re.findall("wrote .*/(.*)", out) == ["mini.csv", "mini.json", "tolerances.toml"]
    assert tolerances.load_tolerances().columns["aepe"].relative == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["tabel2"], "unknown stored table 'tabel2': did you mean 'table2'?"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--updat"], "did you mean --update?"),
    ],
)
def test_bad_input_is_one_line(argv, named, capsys):
    assert spread.main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line


def test_the_check_names_the_tool(cli):
    said = cli("check", "--spread", "table2")
    assert said.code == 2
    assert "python tools/spread.py [NAME...] [--update]" in said.err and len(said.err.splitlines()) == 1
