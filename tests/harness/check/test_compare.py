"""Two runs cell by cell: cells that differ and cells that only one run has are named, and no others."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace

import pytest

from fracbench.errors import InputError
from fracbench.harness.check import compare
from fracbench.harness.check.compare import compare_sides, label_points, open_side
from fracbench.harness.check.tolerances import MEASURED, Tolerance, Tolerances
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import Store
from fracbench.model import SOLVER_VERSION

TOLERANCES = Tolerances({column: Tolerance(1e-6, 1e-3, "measured", "rounding") for column in MEASURED})
POINTS = ["sequence=synthetic_flat", "method=tvl1_sb_alpha", "alpha=0.5,1"]


@pytest.fixture
def stores(work, fake_rows):
    """A function that writes a store of the two points; AEPE as given, and changes to the rows."""

    def make(name, aepe=0.2, keep=2, **changes):
        rows = fake_rows(make_plan(POINTS), lambda labels, params: (0.1, aepe, 0.3), **changes)
        with Store(work / name) as store:
            for row in [*rows.values()][:keep]:
                store.put(row)
        return str(work / name)

    return make


def differences(first, second) -> list[str]:
    verdicts = compare_sides(open_side(first), open_side(second), TOLERANCES)
    return [str(difference) for verdict in verdicts for difference in verdict.differences]


def test_equal_stores_agree_whatever_they_were_computed_with(stores):
    """Points match by identity, not by key, because runs of other solvers and machines are compared."""
    first = stores("a.sqlite")
    second = stores("b.sqlite", solver_version=2, seconds=9.0)
    (verdict,) = compare_sides(open_side(first), open_side(second), TOLERANCES)
    assert (verdict.differences, verdict.cells) == ([], 2 * 7)


def test_a_cell_that_moved_is_named_with_its_point_and_the_tolerance(stores):
    moved = differences(stores("a.sqlite"), stores("b.sqlite", aepe=0.201))
    assert len(moved) == 2
    assert moved[0].startswith("flat tvl1_sb_alpha alpha=0.5 #")
    assert moved[0].endswith(": aepe: stored 0.2, found 0.201 (allowed: 1e-06 + 0.001 of the stored)")
    assert differences(stores("a.sqlite"), stores("b2.sqlite", aepe=0.2001)) == []


def test_a_point_that_only_one_has_is_a_difference(stores):
    (said,) = differences(stores("a.sqlite"), stores("b.sqlite", keep=1))
    assert "alpha=1 #" in said and said.endswith("row: stored present, found missing (allowed: the same rows)")
    (said,) = differences(stores("c.sqlite", keep=1), stores("d.sqlite"))
    assert said.endswith("row: stored missing, found present (allowed: the same rows)")


def test_points_that_failed_are_not_comparable(stores):
    said = differences(stores("a.sqlite"), stores("b.sqlite", status="crashed"))
    assert any("status: stored done, found crashed" in line for line in said)
    assert any("aepe: stored 0.2, found  (allowed" in line for line in said)
    assert differences(stores("c.sqlite", status="crashed"), stores("d.sqlite", status="crashed")) != []


def test_the_newest_row_of_a_point_counts(stores, work, fake_rows):
    first = stores("a.sqlite")
    with Store(work / "a.sqlite") as store:
        for row in store.rows():
            later = {"key": f"later {row.key}", "created": "2999-01-01T00:00:00+00:00"}
            store.put(replace(row, **later, result={**row.result, "aepe": 0.7}))
    assert len(differences(first, stores("b.sqlite"))) == 2
    assert differences(first, stores("c.sqlite", aepe=0.7)) == []


def test_the_rows_of_one_commit(stores):
    old = {"provenance": {"commit": "a" * 40}}
    store = stores("a.sqlite", **old)
    with Store(store) as both:
        for row in both.rows():
            both.put(replace(row, key=f"b{row.key}", provenance={"commit": "b" * 40}, result={"aepe": 0.9}))
    of_commit = open_side(f"{store}@aaaa").title
    assert of_commit == f"store {store} of commit aaaa: 2 points, solver version {SOLVER_VERSION}"
    assert differences(f"{store}@aaaa", stores("c.sqlite")) == []
    assert differences(f"{store}@aaaa", f"{store}@bbbb") != []
    with pytest.raises(
        InputError, match=r"holds no row of commit 'cccc' \(there are: aaaaaaaaaaaa, bbbbbbbbbbbb\)"
    ):
        open_side(f"{store}@cccc")


def test_a_folder_of_results_stands_for_its_store(stores, work):
    (work / "mine" / "runs").mkdir(parents=True)
    store = stores("mine/runs/store.sqlite")
    assert open_side(str(work / "mine")).rows == open_side(store).rows


def test_labels_tell_points_apart_by_what_varies(fake_rows):
    plan = make_plan(["region=grove2_*", "dataset=synthetic", "method=tvl1_sb", "theta=0.3,0.4", "n_warps=2"])
    labels = label_points(fake_rows(plan).values())
    assert len(set(labels.values())) == len(labels)
    assert all("theta=0." in label and "n_warps" not in label for label in labels.values())
    boxed = fake_rows(plan)
    row = next(iter(boxed.values()))
    (label,) = label_points([replace(row, spec={**row.spec, "box": [1, 2, 3, 4]})]).values()
    assert label == f"parallax[1:2, 3:4] tvl1_sb #{row.identity[:8]}"


# -- commits -------------------------------------------------------------------------------------

TABLE = (
    "sequence,method,aae,aepe,sdae,n_pixels,n_unknown,n_nonfinite,status\ngrove2,tvl1,0.1,{},0.3,100,0,0,done\n"
)


@pytest.fixture
def commits(work, monkeypatch):
    """A repository with three commits of stored tables: 0.2, 0.2001 and 0.3 px, the last with one table more."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    git(work, "init", "--quiet")
    monkeypatch.setattr(compare, "checkout", lambda: work)
    folder = work / "results" / "reference"
    folder.mkdir(parents=True)
    (folder / "tolerances.toml").write_text("")
    for tag, aepe in (("one", 0.2), ("two", 0.2001), ("three", 0.3)):
        (folder / "t.csv").write_text(TABLE.format(aepe))
        if tag == "three":
            (folder / "u.csv").write_text(TABLE.format(aepe))
        git(work, "add", ".")
        git(work, "-c", "user.name=n", "-c", "user.email=e@x", "commit", "--quiet", "-m", tag)
        git(work, "tag", tag)
    return work


def git(folder, *arguments):
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True)


def test_the_stored_tables_of_two_commits(commits):
    (commits / "results" / "reference" / "t.csv").write_text("what is in the folder does not matter")
    assert differences("one", "two") == []
    assert differences("one", "three") == [
        "grove2, tvl1: aepe: stored 0.2, found 0.3 (allowed: 1e-06 + 0.001 of the stored)",
        "all rows: table: stored missing, found present (allowed: the same tables)",
    ]
    assert differences("three", "two~1")[1].endswith(
        "table: stored present, found missing (allowed: the same tables)"
    )


@pytest.mark.parametrize("text", ["four", "no/such/file", "", "--all", "one:results", "x@one"])
def test_what_is_neither_a_store_nor_a_commit(commits, text):
    with pytest.raises(InputError, match="is neither a store nor a commit of"):
        open_side(text)


def test_a_commit_without_tables(commits):
    git(commits, "rm", "-r", "--quiet", "results")
    git(commits, "-c", "user.name=n", "-c", "user.email=e@x", "commit", "--quiet", "-m", "bare")
    with pytest.raises(InputError, match="commit HEAD: there are no tables under results/reference"):
        open_side("HEAD")


def test_outside_a_checkout_there_are_stores_only(work, monkeypatch):
    monkeypatch.setattr(compare, "checkout", lambda: None)
    with pytest.raises(InputError, match="'HEAD' is no store, and there is no checkout"):
        open_side("HEAD")


def test_a_store_and_a_commit_are_not_of_a_kind(commits, stores):
    with pytest.raises(InputError, match="one is a store and the other a commit"):
        differences("one", stores("a.sqlite"))


# -- the command ---------------------------------------------------------------------------------


def test_the_command_says_what_it_compares_and_leaves_with_1_where_they_differ(cli, stores):
    first, second, third = stores("a.sqlite"), stores("b.sqlite"), stores("c.sqlite", aepe=0.5)
    same = cli("compare", first, second)
    assert same.code == 0
    lines = same.out.splitlines()
    assert lines[0] == f"stored: store {first}: 2 points, solver version {SOLVER_VERSION}"
    assert lines[1] == f"found: store {second}: 2 points, solver version {SOLVER_VERSION}"
    assert lines[2].startswith("allowed for aae: 1e-06 + ")
    assert lines[-1] == "points: agree (14 cells compared)"
    other = cli("compare", first, third)
    assert other.code == 1
    assert "points: 2 DIFFERENCES (14 cells compared)" in other.out
    assert "aepe: stored 0.2, found 0.5 (allowed: " in other.out
