"""Running a plan: nothing is computed twice, nothing finished is lost, and a dead worker costs one point."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fracbench.errors import FracbenchError
from fracbench.harness import execute
from fracbench.harness import plan as plan_module
from fracbench.harness.plan import make_plan
from fracbench.harness.store import Store

FLAT = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=2")


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "store.sqlite") as opened:
        yield opened


def plan(*tokens, base=FLAT):
    return make_plan([*tokens, *base], allow_download=False)


def by_alpha(made, report):
    return {planned.point.params["alpha"]: report.rows[planned.point.key] for planned in made.points}


def replace_point(monkeypatch, instead):
    """Let workers call ``instead(point, finish)`` for each point; `finish` gives a made-up outcome.

    The functions reach the workers by value: they see what is enclosed here, and no other change made in
    this process.
    """
    parent = os.getpid()

    def marked(key, point, folder, started):
        import os

        from fracbench.harness import execute, task

        def finish(status="done", error=None):
            return task.Outcome(status, error, {}, 1.0, None, {"host": "h"})

        assert os.getpid() != parent, "a point was computed in the parent's own process"
        real = task.run_point
        task.run_point = lambda point, folder: instead(point, finish)
        try:
            return execute._marked(key, point, folder, started)
        finally:
            task.run_point = real

    monkeypatch.setattr(execute, "_marked", marked)


# -- what is computed ----------------------------------------------------------------------------


def test_each_point_is_computed_once_and_stored(store):
    made = plan("alpha=0:2:1")
    seen = []
    report = execute.run(made, store, jobs=2, on_row=seen.append)
    assert (report.computed, report.reused, dict(report.reasons)) == (3, 0, {"new": 3})
    assert set(report.rows) == set(made.unique())
    assert sorted(row.key for row in seen) == sorted(report.rows)
    for key, row in report.rows.items():
        assert store.get(key).result == row.result
        assert (row.status, row.error, row.attempts) == ("done", None, 1)
        assert row.spec == made.unique()[key].spec
        assert row.seconds > 0
        assert row.provenance["threads"] == 1
        assert row.provenance["data"] == made.unique()[key].data_digest
        assert {"commit", "dirty", "host", "versions"} <= set(row.provenance)
    again = execute.run(made, store, jobs=2, on_row=seen.append)
    assert (again.computed, again.reused, len(seen)) == (0, 3, 3)
    assert {key: row.result for key, row in again.rows.items()} == {
        key: store.get(key).result for key in report.rows
    }


def test_a_larger_grid_computes_what_is_new(store):
    execute.run(plan("alpha=0,1"), store, jobs=2)
    report = execute.run(plan("alpha=0:2:0.5"), store, jobs=2)
    assert (report.computed, report.reused) == (3, 2)


def test_points_of_two_names_are_computed_once(store):
    report = execute.run(plan("alpha=0,1", "method=tvl1"), store, jobs=2)
    assert (report.computed, len(report.rows)) == (1, 1)


def test_what_is_missing_is_told_before_it_is_computed(store):
    told = []
    made = plan("alpha=0,1")
    report, todo = execute.missing(made, store)
    assert (list(todo), report.rows) == (list(made.unique()), {})
    execute.run(made, store, jobs=2, on_start=lambda report, n: told.append((report.reused, n)))
    assert told == [(0, 2)]
    report, todo = execute.missing(made, store)
    assert (todo, report.reused) == ({}, 2)


def test_rows_are_stored_as_they_come(store, tmp_path, monkeypatch):
    """Whatever stops the sweep later."""
    replace_point(monkeypatch, lambda point, finish: finish())
    made = plan("alpha=0,1,2")

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        execute.run(made, store, jobs=1, on_row=stop)
    with Store(tmp_path / "store.sqlite", readonly=True) as other:
        assert len(other.rows("done")) == 1
    assert execute.run(made, store, jobs=1).computed == 2


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha"])
def test_the_number_of_workers_changes_no_bit(tmp_path, method):
    made = plan("lambda=0.2,0.3", f"method={method}", "sequence=synthetic_edge", base=FLAT[1:])
    results = []
    for jobs in (1, 2):
        with Store(tmp_path / f"{jobs}.sqlite") as store:
            rows = execute.run(made, store, jobs=jobs).rows
        results.append({key: {**row.result, "phases": sorted(row.result["phases"])} for key, row in rows.items()})
    assert results[0] == results[1]
    assert len({result["aepe"] for result in results[0].values()}) == 2


# -- why a point is run again --------------------------------------------------------------------


def test_another_version_of_the_solver_is_a_reason(store, monkeypatch):
    execute.run(plan("alpha=1"), store, jobs=1)
    version = plan_module.SOLVER_VERSION
    for module in (plan_module, execute):
        monkeypatch.setattr(module, "SOLVER_VERSION", version + 1)
    report = execute.run(plan("alpha=1,2"), store, jobs=1)
    assert dict(report.reasons) == {f"solver version {version} -> {version + 1}": 1, "new": 1}
    assert {row.solver_version for row in report.rows.values()} == {version + 1}
    assert len(store.rows("done")) == 3


def test_changed_data_are_a_reason(store, fake_rows):
    made = plan("alpha=1")
    (row,) = fake_rows(made).values()
    old = {**vars(row), "key": "made from other data", "solver_version": plan_module.SOLVER_VERSION}
    store.put(type(row)(**old))
    report, todo = execute.missing(made, store)
    assert dict(report.reasons) == {"data changed": 1}
    assert len(todo) == 1


# -- failures ------------------------------------------------------------------------------------


def test_a_point_that_fails_is_a_row_and_the_others_go_on(store, monkeypatch):
    def instead(point, finish):
        return finish("failed", "made to fail") if point.params["alpha"] == "1" else finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0:2:0.5")
    report = execute.run(made, store, jobs=2)
    assert report.computed == 5
    (failed,) = report.failed
    assert (failed.status, failed.error, failed.result) == ("failed", "made to fail", {})
    rows = by_alpha(made, report)
    assert {alpha for alpha, row in rows.items() if row.status == "done"} == {"0", "0.5", "1.5", "2"}
    assert store.get(failed.key).error == "made to fail"


def test_failed_points_are_run_again_only_on_request(store, fake_rows):
    made = plan("alpha=0,1")
    for row in fake_rows(made, status="failed").values():
        store.put(row)
    report = execute.run(made, store, jobs=2)
    assert (report.computed, report.reused, len(report.failed)) == (0, 2, 2)
    report = execute.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.failed, dict(report.reasons)) == (2, [], {"failed before": 2})
    report = execute.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.reused) == (0, 2)


def read_log(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text().splitlines()]


def test_a_worker_that_dies_costs_its_point_one_retry_alone(store, monkeypatch, tmp_path):
    """Points 0 and 1 are under way when 0 kills its worker: both are tried again, one after the other."""
    log = tmp_path / "log"
    log.touch()

    def instead(point, finish):
        import os
        import time

        alpha = point.params["alpha"]

        def say(what):
            with log.open("a") as file:
                file.write(f"{what} {alpha}\n")

        def started():
            return log.read_text().split()

        first_time = f"start {alpha}\n" not in log.read_text()
        say("start")
        if alpha == "0":
            while "1" not in started():
                time.sleep(0.01)
            os._exit(9)
        if alpha == "1" and first_time:
            time.sleep(600)
        say("end")
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,0.5,1.5,2")
    report = execute.run(made, store, jobs=2)
    rows = by_alpha(made, report)
    assert {alpha: row.status for alpha, row in rows.items()} == {
        "0": "crashed", "1": "done", "0.5": "done", "1.5": "done", "2": "done"
    }  # fmt: skip
    assert {alpha: row.attempts for alpha, row in rows.items()} == {"0": 2, "1": 2, "0.5": 1, "1.5": 1, "2": 1}
    assert "the worker process died 2 times" in rows["0"].error
    assert store.get(rows["0"].key).status == "crashed"
    events = read_log(log)
    assert sorted(alpha for what, alpha in events if what == "start") == ["0", "0", "0.5", "1", "1", "1.5", "2"]
    # The retries follow the first death, and nothing begins between the start and the end of either.
    retry_of_0 = [i for i, event in enumerate(events) if event == ["start", "0"]][1]
    retry_of_1 = [i for i, event in enumerate(events) if event == ["start", "1"]][1]
    assert {retry_of_0, retry_of_1} == {2, 3}
    assert events[retry_of_1 + 1] == ["end", "1"]
    # ... and the sweep can be run again.
    replace_point(monkeypatch, lambda point, finish: finish())
    report = execute.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.failed, dict(report.reasons)) == (1, [], {"crashed before": 1})


def test_one_worker_may_die_as_well(store, monkeypatch):
    """With one job, too, points are computed in another process than this one."""

    def instead(point, finish):
        import os

        if point.params["alpha"] == "1":
            os._exit(9)
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,2")
    rows = by_alpha(made, execute.run(made, store, jobs=1))
    assert {alpha: row.status for alpha, row in rows.items()} == {"0": "done", "1": "crashed", "2": "done"}
    # Point 0 may be started twice: its outcome can be on its way when the worker dies at once after it.
    assert rows["1"].attempts == 2 and rows["0"].attempts <= 2 and rows["2"].attempts == 1


def test_one_job_means_one_point_at_a_time(store, monkeypatch, tmp_path):
    log = tmp_path / "log"

    def instead(point, finish):
        import time

        for what in ("start", "end"):
            with log.open("a") as file:
                file.write(f"{what} {point.params['alpha']}\n")
            time.sleep(0.05)
        return finish()

    replace_point(monkeypatch, instead)
    execute.run(plan("alpha=0,0.5,1,1.5"), store, jobs=1)
    assert [what for what, _ in read_log(log)] == ["start", "end"] * 4


def test_workers_that_die_before_they_begin_end_the_sweep(store, monkeypatch):
    def marked(key, point, folder, started):
        import os

        os._exit(9)

    monkeypatch.setattr(execute, "_marked", marked)
    with pytest.raises(FracbenchError, match="die before they begin"):
        execute.run(plan("alpha=0,1"), store, jobs=2)
    assert store.rows() == []


def test_no_points_need_no_workers():
    assert list(execute.outcomes({}, None, 2)) == []
