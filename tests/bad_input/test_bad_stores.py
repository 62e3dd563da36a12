"""A file in place of a store is refused in one line with the remedy, and is not changed."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.sqlite import _COLUMNS, APPLICATION_ID, SCHEMA_VERSION
from fracbench.harness.run.store import Row, Store

POINT = ("alpha=1", "sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1")
PLACE = Path("results/runs/store.sqlite")


def fresh(path: Path) -> bytes:
    with Store(path):
        pass
    return path.read_bytes()


def execute(path: Path, *statements: str) -> None:
    db = sqlite3.connect(path)
    for statement in statements:
        db.execute(statement)
    db.commit()
    db.close()


def overwritten(path: Path, at: int, data: bytes) -> None:
    content = bytearray(fresh(path))
    content[at : at + len(data)] = data
    path.write_bytes(bytes(content))


STORES: list[tuple[str, Callable[[Path], object], str]] = [
    (
        "text",
        lambda path: path.write_text("a text, which is no database at all"),
        "is not a fracbench store",
    ),
    ("random", lambda path: path.write_bytes(bytes(range(256)) * 40), "is not a fracbench store"),
    ("folder", lambda path: path.mkdir(), "is a folder; name a file in it"),
    ("another", lambda path: execute(path, "CREATE TABLE a (b)"), "is another program's SQLite database"),
    ("newer", lambda path: later(path, SCHEMA_VERSION + 1), "written by a fracbench newer than this"),
    ("older", lambda path: later(path, SCHEMA_VERSION - 1), "written by a fracbench older than this"),
    ("negative", lambda path: later(path, -1), "written by a fracbench older than this"),
    ("cut off", lambda path: path.write_bytes(fresh(path)[:1500]), "store.sqlite"),
    ("header", lambda path: overwritten(path, 16, b"\xff\xff"), "store.sqlite"),
    ("no table", lambda path: bare(path), "store.sqlite"),
    ("trigger", lambda path: with_trigger(path), "it holds triggers or views"),
    ("view", lambda path: with_view(path), "it holds triggers or views"),
    ("another table", lambda path: another_table(path), "store.sqlite"),
]


def later(path: Path, version: int) -> None:
    fresh(path)
    execute(path, f"PRAGMA user_version = {version}")


def bare(path: Path) -> None:
    execute(path, f"PRAGMA application_id = {APPLICATION_ID}", f"PRAGMA user_version = {SCHEMA_VERSION}")


def with_trigger(path: Path) -> None:
    """A trigger would be run by our own statements."""
    fresh(path)
    execute(path, "CREATE TRIGGER gone AFTER INSERT ON points BEGIN DELETE FROM points; END")


def with_view(path: Path) -> None:
    """A view in place of the table could compute for ever."""
    bare(path)
    columns = ", ".join(f"NULL AS {name}" for name in _COLUMNS)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT"
    execute(path, f"CREATE VIEW points AS {endless} {columns} FROM n")


def another_table(path: Path) -> None:
    bare(path)
    execute(path, "CREATE TABLE points (key TEXT, identity TEXT)")


@pytest.fixture
def place(work) -> Path:
    (work / PLACE.parent).mkdir(parents=True)
    return work / PLACE


@pytest.mark.parametrize(("make", "named"), [pytest.param(make, named, id=name) for name, make, named in STORES])
@pytest.mark.parametrize("argv", [["sweep", *POINT], ["sweep", *POINT, "--dry-run"], ["status"]])
def test_files_that_are_no_store(work, place, refused, make, named, argv):
    make(place)
    refused(work, argv, str(PLACE), named)


@pytest.mark.parametrize(("make", "named"), [pytest.param(make, named, id=name) for name, make, named in STORES])
def test_no_side_of_a_comparison(work, place, refused, make, named):
    make(place)
    if place.is_dir():
        named = "is neither a store nor a commit"
    fresh(work / "good.sqlite")
    refused(work, ["compare", str(place), "good.sqlite"], named)


#: Column and value of a row that no program of ours has written.
VALUES = [
    ("spec", "__import__('os').abort()"),
    ("spec", "[" * 100_000),
    ("spec", "[1]"),
    ("spec", b"\xff"),
    ("result", "1" * 5000),
    ("provenance", "null"),
    ("error", b"\xff"),
    ("key", b"\xff"),
    ("created", b"\xff"),
    ("seconds", "long"),
    ("attempts", "many"),
    ("solver_version", 1.5),
]


@pytest.mark.parametrize(("column", "value"), VALUES)
def test_a_row_that_is_no_json_is_damage_not_code(work, place, refused, column, value):
    """A store is data: its columns are read as JSON, whatever they hold."""
    with Store(place):
        pass
    row = {"key": "k", "identity": "i", "spec": "{}", "solver_version": 1, "status": "done", "result": "{}"}
    row |= {"provenance": "{}", "attempts": 1, "created": "2026-01-01", column: value}
    db = sqlite3.connect(place)
    db.execute(f"INSERT INTO points ({', '.join(row)}) VALUES ({', '.join('?' * len(row))})", [*row.values()])
    db.commit()
    db.close()
    refused(work, ["compare", str(place), str(place)], "is damaged; move it away")


#: Results that no program of ours has written.
RESULTS = [
    {"aae": "small"},
    {"n_pixels": [1]},
    {"masks": 1},
    {"classes": {"edge": {}}},
    {"fluid": [1, 2]},
    {"iterations": 3},
    {"stop": ["tol"]},
]


@pytest.mark.parametrize("result", RESULTS, ids=lambda result: next(iter(result)))
def test_a_result_of_another_kind_is_damage(work, place, refused, cli, result):
    point = make_plan(POINT, allow_download=False).points[0].point
    spec = {"method": "tvl1_sb_alpha"}  # without its data: of no use for an estimate of time
    with Store(place) as store:
        store.put(
            Row(
                key=point.key, identity="i", spec=spec, solver_version=1, status="done", result=result, seconds=1.0
            )
        )
    assert "1 points, 1 stored, 0 to compute" in cli("sweep", *POINT, "--dry-run").out
    refused(work, ["sweep", *POINT], "the result of point", "is damaged; move it away")
