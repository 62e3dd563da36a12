"""Status: every planned point is counted once, as what it is, and the command that goes on is told."""

from __future__ import annotations

import json

import pytest

from fracbench.harness.run import plan, point, sweep
from fracbench.harness.run.plan import plan_experiment
from fracbench.harness.run.status import standing
from fracbench.harness.run.store import Store
from fracbench.model import SOLVER_VERSION

POINTS = (
    "sequence=synthetic_flat",
    "n_scales=1",
    "n_warps=1",
    "max_iter=2",
    "method=tvl1_sb_alpha",
    "alpha=0:1:0.25",
)
SETTINGS = ["dataset=synthetic"]


@pytest.fixture
def mini(work):
    """The working folder with an experiment of five points."""
    (work / "experiments").mkdir()
    write(work, "mini", POINTS)
    return work


def write(folder, name, tokens):
    (folder / "experiments" / f"{name}.yaml").write_text(f"grid: {json.dumps(list(tokens))}\n")


def fill(folder, fake_rows, *, done=0, failed=0):
    planned = plan_experiment({"main": POINTS}, SETTINGS)
    rows = [*fake_rows(planned).values()]
    bad = [*fake_rows(planned, status="timeout").values()]
    with Store(folder / "results" / "runs" / "store.sqlite") as store:
        for row in rows[:done] + bad[done : done + failed]:
            store.put(row)


def stand(name="mini", settings=SETTINGS):
    with Store("results/runs/store.sqlite", readonly=True) as store:
        return standing(name, settings, store)


def test_every_point_is_counted_once(mini, fake_rows, monkeypatch):
    fill(mini, fake_rows, done=2, failed=1)
    found = stand()
    assert (found.points, found.done, found.failed, found.stale, found.missing) == (5, 2, 1, 0, 2)
    assert found.why == {"new": 2}
    for module in (point, sweep):  # a new solver: what was done is stale
        monkeypatch.setattr(module, "SOLVER_VERSION", 99)
    found = stand()
    assert (found.points, found.done, found.failed, found.stale, found.missing) == (5, 0, 0, 3, 2)
    assert found.why == {"new": 2, f"solver version {SOLVER_VERSION} -> 99": 3}


def test_data_that_changed_make_points_stale(mini, fake_rows, monkeypatch):
    fill(mini, fake_rows, done=5)
    monkeypatch.setattr(plan, "digest_of", lambda *_, **__: "other data")
    found = stand()
    assert (found.done, found.stale, found.why) == (0, 5, {"data changed": 5})


def test_the_command_that_goes_on(mini, fake_rows):
    assert stand().command == "fracbench experiment mini dataset=synthetic"
    fill(mini, fake_rows, done=4, failed=1)
    assert stand().command == "fracbench experiment mini dataset=synthetic --rerun failed"
    fill(mini, fake_rows, done=5)
    assert stand().command == ""
    write(mini, "fig99", POINTS[:-1])
    write(mini, "table9", [*POINTS, "theta=0.3,0.4"])
    assert stand("fig99").command == "fracbench figure 99 dataset=synthetic"
    assert stand("table9").command == "fracbench table 9 dataset=synthetic"


def test_an_experiment_that_cannot_be_planned_does_not_hide_the_others(mini, cli):
    write(mini, "wrong", ["alhpa=1"])
    found = stand("wrong")
    assert (found.points, found.command) == (0, "")
    assert found.error.startswith("unknown key 'alhpa'")
    said = cli("status", "wrong", "mini", "dataset=synthetic")
    assert said.code == 0
    assert "wrong: cannot be planned: unknown key 'alhpa'" in said.out
    assert "mini: fracbench experiment mini dataset=synthetic  (5 new)\n" in said.out


def test_the_table_and_its_json_say_the_same(mini, cli, fake_rows):
    fill(mini, fake_rows, done=2, failed=1)
    said = cli("status", "mini", "dataset=synthetic")
    assert said.out.startswith("store results/runs/store.sqlite: 2 done, 1 timeout\n")
    (line,) = [line for line in said.out.splitlines() if line.startswith("│ mini")]
    assert [cell.strip() for cell in line.strip("│").split("│")] == ["mini", "synthetic", "5", "2", "1", "0", "2"]
    found = json.loads(cli("status", "mini", "dataset=synthetic", "--json").out)
    assert found["rows"] == {"done": 2, "failed": 0, "crashed": 0, "timeout": 1, "diverged": 0}
    (one,) = found["experiments"]
    assert {key: one[key] for key in ("points", "done", "failed", "stale", "missing")} == {
        "points": 5, "done": 2, "failed": 1, "stale": 0, "missing": 2
    }  # fmt: skip


def test_nothing_is_written_and_a_missing_store_is_an_empty_one(mini, cli):
    assert cli("status", "mini", "dataset=synthetic").out.startswith("store results/runs/store.sqlite: no rows\n")
    assert [path.name for path in mini.iterdir()] == ["experiments"]


def test_all_experiments_without_a_name(mini, cli, monkeypatch):
    from fracbench.harness.config import experiment

    monkeypatch.setattr(experiment, "asset", lambda relative: mini / relative)
    found = json.loads(cli("status", "dataset=synthetic", "--json").out)
    assert [one["experiment"] for one in found["experiments"]] == ["mini"]
