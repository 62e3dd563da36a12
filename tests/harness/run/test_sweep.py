"""Running a plan: nothing is computed twice, nothing finished is lost, and a dead worker costs one point."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from fracbench.data.regions import Region
from fracbench.errors import FracbenchError
from fracbench.harness.run import point as point_module
from fracbench.harness.run import pool as workers
from fracbench.harness.run import sweep
from fracbench.harness.run.grid_points import PlannedPoints
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.point import Job, Outcome
from fracbench.harness.run.store import Store, encode

FLAT = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=2")


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "store.sqlite") as opened:
        yield opened


def plan(*tokens, base=FLAT):
    return make_plan([*tokens, *base], allow_download=False)


def by_alpha(made, report):
    return {planned.point.canonical["alpha"]: report.rows[planned.point.key] for planned in made.points}


def replace_point(monkeypatch, instead):
    """Let workers call ``instead(point, finish)`` for each point; `finish` gives a made-up outcome.

    The functions reach the workers by value: they see what is enclosed here, and no other change made in
    this process.
    """

    def compute(job, store, marks, parent):
        import os

        from fracbench.harness.run import compute_point
        from fracbench.harness.run import pool as workers
        from fracbench.harness.run.point import Outcome

        def finish(status="done", error=None):
            return Outcome(status, error, {}, 1.0, None, {"host": "h"})

        def run_point(point, folder, guard):
            with guard():
                return instead(point, finish)

        assert os.getpid() != parent, "a point was computed in the parent's own process"
        real, compute_point.run_point = compute_point.run_point, run_point
        try:
            return workers._compute(job, store, marks, parent)
        finally:
            compute_point.run_point = real

    monkeypatch.setattr(workers, "_compute", compute)


# -- what is computed ----------------------------------------------------------------------------


def test_each_point_is_computed_once_and_stored(store):
    made = plan("alpha=0:2:1")
    seen = []
    report = sweep.run(made, store, jobs=2, on_row=seen.append)
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
    again = sweep.run(made, store, jobs=2, on_row=seen.append)
    assert (again.computed, again.reused, len(seen)) == (0, 3, 3)
    assert {key: row.result for key, row in again.rows.items()} == {
        key: store.get(key).result for key in report.rows
    }


def test_a_larger_grid_computes_what_is_new(store):
    sweep.run(plan("alpha=0,1"), store, jobs=2)
    report = sweep.run(plan("alpha=0:2:0.5"), store, jobs=2)
    assert (report.computed, report.reused) == (3, 2)


def test_points_of_two_names_are_computed_once(store):
    report = sweep.run(plan("alpha=0,1", "method=tvl1"), store, jobs=2)
    assert (report.computed, len(report.rows)) == (1, 1)


def test_what_is_missing_is_told_before_it_is_computed(store):
    made = plan("alpha=0,1")
    report, todo = sweep.missing(made, store)
    assert (list(todo), report.rows) == (list(made.unique()), {})
    sweep.run(made, store, jobs=2)
    report, todo = sweep.missing(made, store)
    assert (todo, report.reused) == ({}, 2)


def test_rows_are_stored_as_they_come(store, tmp_path, monkeypatch):
    """Whatever stops the sweep later."""

    def instead(point, finish):
        import time

        time.sleep(0.3)
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,2")

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep.run(made, store, jobs=1, on_row=stop)
    with Store(tmp_path / "store.sqlite", readonly=True) as other:
        assert len(other.rows("done")) == 1
    assert sweep.run(made, store, jobs=1).computed == 2


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha"])
def test_the_number_of_workers_changes_no_bit(tmp_path, method):
    made = plan("lambda=0.2,0.3", f"method={method}", "sequence=synthetic_edge", base=FLAT[1:])
    results = []
    for jobs in (1, 2):
        with Store(tmp_path / f"{jobs}.sqlite") as store:
            rows = sweep.run(made, store, jobs=jobs).rows
        results.append({key: {**row.result, "phases": sorted(row.result["phases"])} for key, row in rows.items()})
    assert results[0] == results[1]
    assert len({result["aepe"] for result in results[0].values()}) == 2


# -- why a point is run again --------------------------------------------------------------------


def test_another_version_of_the_solver_is_a_reason(store, monkeypatch):
    sweep.run(plan("alpha=1"), store, jobs=1)
    version = point_module.SOLVER_VERSION
    for module in (point_module, sweep):
        monkeypatch.setattr(module, "SOLVER_VERSION", version + 1)
    report = sweep.run(plan("alpha=1,2"), store, jobs=1)
    assert dict(report.reasons) == {f"solver version {version} -> {version + 1}": 1, "new": 1}
    assert {row.solver_version for row in report.rows.values()} == {version + 1}
    assert len(store.rows("done")) == 3


def test_changed_data_are_a_reason(store, fake_rows):
    made = plan("alpha=1")
    (row,) = fake_rows(made).values()
    old = {**vars(row), "key": "made from other data", "solver_version": point_module.SOLVER_VERSION}
    store.put(type(row)(**{**old, "key": "older still", "solver_version": 0, "created": "2000-01-01T00:00:00"}))
    store.put(type(row)(**old))
    report, todo = sweep.missing(made, store)
    assert dict(report.reasons) == {"data changed": 1}
    assert len(todo) == 1


# -- failures ------------------------------------------------------------------------------------


def test_a_point_that_fails_is_a_row_and_the_others_go_on(store, monkeypatch):
    def instead(point, finish):
        return finish("failed", "made to fail") if point.canonical["alpha"] == "1" else finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0:2:0.5")
    report = sweep.run(made, store, jobs=2)
    assert report.computed == 5
    (failed,) = map(report.rows.__getitem__, report.failed)
    assert (failed.status, failed.error, failed.result) == ("failed", "made to fail", {})
    rows = by_alpha(made, report)
    assert {alpha for alpha, row in rows.items() if row.status == "done"} == {"0", "0.5", "1.5", "2"}
    assert store.get(failed.key).error == "made to fail"


def test_failed_points_are_run_again_only_on_request(store, fake_rows):
    made = plan("alpha=0,1")
    for row in fake_rows(made, status="failed").values():
        store.put(row)
    report = sweep.run(made, store, jobs=2)
    assert (report.computed, report.reused, len(report.failed)) == (0, 2, 2)
    report = sweep.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.failed, dict(report.reasons)) == (2, [], {"failed before": 2})
    report = sweep.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.reused) == (0, 2)


def read_log(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text().splitlines()]


def test_a_worker_that_dies_costs_its_point_one_retry_alone(store, monkeypatch, tmp_path):
    """Point 0 kills its worker while 1 is under way: both are tried again, each when nothing else runs."""
    log = tmp_path / "log"
    log.touch()

    def instead(point, finish):
        import os
        import time

        alpha = point.canonical["alpha"]
        with log.open("a") as file:
            file.write(f"start {alpha}\n")
        if alpha == "0":
            while "1" not in log.read_text().split():
                time.sleep(0.01)
            os._exit(9)
        if alpha == "1":
            time.sleep(0.5)
        with log.open("a") as file:
            file.write(f"end {alpha}\n")
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,0.5,1.5,2")
    report = sweep.run(made, store, jobs=2)
    rows = by_alpha(made, report)
    assert {alpha: row.status for alpha, row in rows.items()} == {
        "0": "crashed", "1": "done", "0.5": "done", "1.5": "done", "2": "done"
    }  # fmt: skip
    assert {alpha: row.attempts for alpha, row in rows.items()} == {"0": 2, "1": 2, "0.5": 1, "1.5": 1, "2": 1}
    assert "the worker process died 2 times" in rows["0"].error
    assert store.get(rows["0"].key).status == "crashed"
    events = read_log(log)
    assert sorted(alpha for what, alpha in events if what == "start") == ["0", "0", "0.5", "1", "1", "1.5", "2"]
    alone = [["start", "0"], ["start", "1"], ["end", "1"]]
    assert sorted(events[-3:]) == sorted(alone) and events[-3:] != [alone[1], alone[0], alone[2]]
    # ... and the sweep can be run again.
    replace_point(monkeypatch, lambda point, finish: finish())
    report = sweep.run(made, store, jobs=2, rerun_failed=True)
    assert (report.computed, report.failed, dict(report.reasons)) == (1, [], {"crashed before": 1})


def test_one_worker_may_die_as_well(store, monkeypatch):
    """With one job, too, points are computed in another process than this one."""

    def instead(point, finish):
        import os

        if point.canonical["alpha"] == "1":
            os._exit(9)
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,2")
    rows = by_alpha(made, sweep.run(made, store, jobs=1))
    assert {alpha: (row.status, row.attempts) for alpha, row in rows.items()} == {
        "0": ("done", 1), "1": ("crashed", 2), "2": ("done", 1)
    }  # fmt: skip


def test_a_worker_that_dies_after_its_point_is_finished_loses_nothing(store, monkeypatch, tmp_path):
    log = tmp_path / "log"
    replace_point(monkeypatch, lambda point, finish: finish())
    finish_and_say = workers._compute

    def compute(job, store, marks, parent):
        import os

        with log.open("a") as file:
            file.write(f"start {job.key}\n")
        finish_and_say(job, store, marks, parent)
        os._exit(9)

    monkeypatch.setattr(workers, "_compute", compute)
    report = sweep.run(plan("alpha=0,1,2"), store, jobs=1)
    assert {(row.status, row.attempts) for row in report.rows.values()} == {("done", 1)}
    assert len(read_log(log)) == 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_point_over_time_is_a_row_and_costs_no_other(store, monkeypatch, tmp_path, jobs):
    log = tmp_path / "log"

    def instead(point, finish):
        import ctypes
        import signal
        import time

        with log.open("a") as file:
            file.write(f"{point.canonical['alpha']}\n")
        if point.canonical["alpha"] == "0":  # Python itself stands still: nothing else in this process gets a turn
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})  # which would end the sleep early
            ctypes.PyDLL(None).sleep(60)
        time.sleep(0.4 if point.canonical["alpha"] == "1" else 0.0)
        return finish()

    replace_point(monkeypatch, instead)
    made = plan("alpha=0,1,2", "parallel.timeout=0.7")
    started = time.monotonic()
    report = sweep.run(made, store, jobs=jobs)
    assert time.monotonic() - started < 50.0  # its process was ended; nobody waited for the point
    rows = by_alpha(made, report)
    assert {alpha: (row.status, row.attempts) for alpha, row in rows.items()} == {
        "0": ("timeout", 1), "1": ("done", 1), "2": ("done", 1)
    }  # fmt: skip
    assert rows["0"].error == "not finished within the 0.7 s allowed"
    assert sorted(log.read_text().split()) == ["0", "1", "2"]


def test_the_estimate_alone_is_timed(store, monkeypatch):
    """Not the start of a worker, nor compilation, nor the errors of the flow."""

    def compute(job, store, marks, parent):
        import time

        from fracbench.harness.run import compute_point
        from fracbench.harness.run import pool as workers

        def slowly(function):
            def instead(*arguments):
                time.sleep(0.6)
                return function(*arguments)

            return instead

        before = compute_point._warm_up, compute_point.flow_errors
        compute_point._warm_up, compute_point.flow_errors = map(slowly, before)
        try:
            return workers._compute(job, store, marks, parent)
        finally:
            compute_point._warm_up, compute_point.flow_errors = before

    monkeypatch.setattr(workers, "_compute", compute)
    report = sweep.run(plan("alpha=0,1", "parallel.timeout=0.5"), store, jobs=1)
    assert {(row.status, row.attempts) for row in report.rows.values()} == {("done", 1)}


def test_what_was_finished_as_the_time_ended_is_kept(store, fake_rows):
    """The row is in the store although the process ended itself."""
    (row,) = fake_rows(plan("alpha=0")).values()
    store.put(row)
    job = Job(row.key, plan("alpha=0").points[0].point, 1, 2, {}, timeout=1.0)
    with closing(workers.LocalPool(1, store)) as pool:
        (Path(pool._marks.name) / row.key).write_text("Timeout")
        assert list(pool._died([job])) == [(row.key, encode(row))]
        assert list(Path(pool._marks.name).iterdir()) == []


def test_the_key_of_a_point_is_not_interned(store, monkeypatch, tmp_path):
    """Python 3.12 keeps interned texts for ever: memory would grow with each point."""
    key = secrets.token_hex(32)  # no test before has met it
    monkeypatch.setattr(
        "fracbench.harness.run.compute_point.run_point", lambda *_: Outcome("done", None, {}, 1.0, None, {})
    )
    job = Job(key, plan("alpha=0").points[0].point, 1, 2, {})
    workers._compute(job, store.path, str(tmp_path), os.getppid())
    copy = key[:1] + key[1:]
    assert sys.intern(copy) is copy  # an equal text that was interned before would be returned


def say_who(point, finish):
    """Return the process, and whether it watches its parent and is deaf to Ctrl-C, in place of a host."""
    import os
    import signal
    import threading

    watched = any(thread.name == "parent" for thread in threading.enumerate())
    deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return replace(finish(), machine={"host": [os.getpid(), watched, deaf]})


@pytest.mark.parametrize("noticed", [False, True])
def test_a_worker_that_dies_while_it_is_idle_costs_nothing(store, monkeypatch, noticed):
    replace_point(monkeypatch, say_who)
    (row,) = sweep.run(plan("alpha=0"), store, jobs=1).rows.values()
    pid = row.provenance["host"][0]
    os.kill(pid, signal.SIGKILL)
    if noticed:
        while _alive(pid):
            time.sleep(0.05)
    report = sweep.run(plan("alpha=1"), store, jobs=1)
    assert [(row.status, row.attempts) for row in report.rows.values()] == [("done", 1)]


def test_workers_serve_one_sweep_after_another(store, monkeypatch):
    """They are not started again, watch their parent and are deaf to Ctrl-C all the time."""
    replace_point(monkeypatch, say_who)
    seen = set()
    for alpha in ("0", "0.25", "0.5", "0.75", "1"):
        report = sweep.run(plan(f"alpha={alpha}"), store, jobs=1)
        seen |= {tuple(row.provenance["host"]) for row in report.rows.values()}
    assert len(seen) <= 2
    assert {(watched, deaf) for _, watched, deaf in seen} == {(True, True)}


# -- what was finished without being stored, and sweeps at once -----------------------------------


@pytest.mark.parametrize(
    "no_row",
    ['{"key": ', "[" * 100_000, '{"key":"k","identity":"i","spec":5,"solver_version":1,"status":"done"}'],
    ids=["cut", "deep", "spec"],
)
def test_rows_that_an_older_version_left_beside_the_store_are_taken_not_computed(store, fake_rows, no_row):
    made = plan("alpha=0,1")
    first, second = fake_rows(made).values()
    folder = sweep.claims_folder(store.path)
    folder.mkdir()
    (folder / f"{first.key}.json").write_text(first.to_json())
    (folder / f"{second.key}.json").write_text(no_row)
    report, todo = sweep.missing(made, store)
    assert (list(report.rows), list(todo)) == ([first.key], [second.key])
    assert store.rows() == [first]
    assert list(folder.iterdir()) == []


OTHER_SWEEP = """
import sys
from pathlib import Path
from fracbench.harness.run.sweep import Claims
with Claims(Path(sys.argv[1])) as claims:
    print(claims.take(sys.argv[2]), flush=True)
    sys.stdin.readline()
"""


@pytest.mark.skipif(sweep.fcntl is None, reason="this system has no such locks")
def test_two_sweeps_share_the_work(store, fake_rows, monkeypatch):
    """A point that another process has claimed is left to it, and its row is taken from the store."""
    replace_point(monkeypatch, lambda point, finish: finish())
    made = plan("alpha=0,1,2")
    theirs, *ours = fake_rows(made).values()
    folder = sweep.claims_folder(store.path)
    folder.mkdir()
    other = subprocess.Popen(
        [sys.executable, "-c", OTHER_SWEEP, str(folder), theirs.key],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert other.stdout.readline() == "True\n"
    with sweep.Claims(folder) as claims:
        assert [claims.take(theirs.key), claims.take(ours[0].key)] == [False, True]
        claims.release(ours[0].key)

    def on_row(row):
        if len(store.rows()) == 2:  # both of ours: now the other one finishes, too
            store.put(theirs)
            other.communicate("go on\n", timeout=60)

    report = sweep.run(made, store, jobs=2, on_row=on_row)
    assert (report.computed, report.reused, len(report.rows)) == (2, 1, 3)
    assert report.rows[theirs.key] == theirs


@pytest.mark.skipif(sweep.fcntl is None, reason="this system has no such locks")
def test_a_claim_ends_with_its_process(store):
    folder = sweep.claims_folder(store.path)
    with sweep.Claims(folder) as claims:
        other = subprocess.Popen(
            [sys.executable, "-c", OTHER_SWEEP, str(folder), "abc"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        other.stdout.readline()
        assert not claims.take("abc")
        other.kill()
        other.communicate(timeout=60)
        assert claims.take("abc")


def test_a_claim_holds_where_there_are_no_locks(store, monkeypatch):
    class NoLocks:
        LOCK_EX = LOCK_NB = LOCK_UN = 0

        @staticmethod
        def lockf(*_):
            raise OSError(95, "not supported")

    with sweep.Claims(sweep.claims_folder(store.path)) as claims:
        assert claims.take("ab" * 32) and claims.take("ab" * 32)
        claims.release("ab" * 32)
        for substitute in (NoLocks, None):
            monkeypatch.setattr(sweep, "fcntl", substitute)
            assert claims.take("cd" * 32)
            claims.release("cd" * 32)


def test_measures_go_first_and_then_the_largest_points(store, monkeypatch):
    replace_point(monkeypatch, lambda point, finish: finish())
    made = plan("alpha=0,1,2")
    regions = [Region("small", "edge", (0, 20), (0, 20)), None, Region("large", "edge", (0, 100), (0, 100))]
    points = [
        replace(planned, point=replace(planned.point, region=region))
        for planned, region in zip(made.points, regions, strict=True)
    ]
    points.append(replace(points[0], point=replace(points[0].point, score="spectrum")))
    seen = []
    sweep.run(replace(made, points=PlannedPoints(points)), store, jobs=1, on_row=seen.append)
    assert [row.spec["box"] for row in seen] == [[0, 20, 0, 20], None, [0, 100, 0, 100], [0, 20, 0, 20]]
    assert ["score" in row.spec for row in seen] == [True, False, False, False]


def test_the_points_of_a_rendered_pair_are_computed_together(store, monkeypatch):
    """A worker then renders it once."""
    replace_point(monkeypatch, lambda point, finish: finish())
    made = make_plan(["dataset=particles", "sequence=shear", "alpha=1,1.5", "seed=0,1"])
    assert [planned.labels["seed"] for planned in made.points] == ["0", "1", "0", "1"]
    seen = []
    sweep.run(made, store, jobs=1, on_row=seen.append)
    assert [row.spec.get("seed", 0) for row in seen] in ([0, 0, 1, 1], [1, 1, 0, 0])


# -- what stops a sweep ----------------------------------------------------------------------------


def test_workers_end_with_their_parent(tmp_path):
    """Also while they compute; what they were at is not finished behind the back of the next run."""
    script = tmp_path / "parent.py"
    script.write_text(ORPHANS)
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.communicate(timeout=60)
    deadline = time.monotonic() + 30
    while _alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _alive(worker)
    assert all(path.name.startswith("claims-") for path in (tmp_path / "store.sqlite-spool").iterdir())


ORPHANS = """
from fracbench.harness.run import pool as workers, sweep
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import Store

def run(path):
    def compute(job, store, marks, parent):
        import os, time
        os.write(1, f"{os.getpid()}\\n".encode())
        time.sleep(600)
    workers._compute = compute
    with Store(path) as store:
        sweep.run(make_plan(["sequence=synthetic_flat"]), store, jobs=1)

if __name__ == "__main__":
    run("store.sqlite")
"""


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/status")
    return not (status.exists() and "State:\tZ" in status.read_text())


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be blocked here")
def test_workers_leave_ctrl_c_to_their_parent(store, monkeypatch):
    """A terminal sends it to all; a worker would answer with a traceback, and its point would be lost."""

    def instead(point, finish):
        import os
        import signal
        import time

        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        return finish()

    replace_point(monkeypatch, instead)
    report = sweep.run(plan("alpha=0,1"), store, jobs=1)
    assert [row.status for row in report.rows.values()] == ["done", "done"]


def test_a_store_that_a_worker_cannot_write_is_one_clear_error(store, monkeypatch):
    replace_point(monkeypatch, lambda point, finish: finish())
    real = workers._compute

    def compute(job, store, marks, parent):
        from fracbench.harness.run import pool as workers
        from fracbench.harness.run.store import Store

        class Full(Store):
            def __init__(self, path):
                super().__init__(path)
                self._db.execute("PRAGMA max_page_count = 1")

        before, workers.Store = workers.Store, Full
        try:
            return real(job, store, marks, parent)
        finally:
            workers.Store = before

    monkeypatch.setattr(workers, "_compute", compute)
    with pytest.raises(FracbenchError, match="the disk is full; free some space") as caught:
        sweep.run(plan(*("alpha=0:2:0.01",), "lambda=0.1,0.2"), store, jobs=1)
    assert str(store.path) in str(caught.value)


def test_marks_that_cannot_be_written_are_one_clear_error(store, monkeypatch):
    replace_point(monkeypatch, lambda point, finish: finish())
    with closing(workers.LocalPool(1, store)) as pool:
        pool.close()
        monkeypatch.setattr(sweep, "_pool", lambda plan, jobs, store: pool)
        with pytest.raises(FracbenchError, match="No such file or directory; free some space") as caught:
            sweep.run(plan("alpha=0,1"), store, jobs=1)
    assert pool._marks.name in str(caught.value)
    assert store.rows() == []


def test_one_job_means_one_point_at_a_time(store, monkeypatch, tmp_path):
    log = tmp_path / "log"

    def instead(point, finish):
        import time

        for what in ("start", "end"):
            with log.open("a") as file:
                file.write(f"{what} {point.canonical['alpha']}\n")
            time.sleep(0.05)
        return finish()

    replace_point(monkeypatch, instead)
    sweep.run(plan("alpha=0,0.5,1,1.5"), store, jobs=1)
    assert [what for what, _ in read_log(log)] == ["start", "end"] * 4


def test_workers_that_die_before_they_begin_end_the_sweep(store, monkeypatch):
    def compute(job, store, marks, parent):
        import os

        os._exit(9)

    monkeypatch.setattr(workers, "_compute", compute)
    with pytest.raises(FracbenchError, match="die before they begin"):
        sweep.run(plan("alpha=0,1"), store, jobs=2)
    assert store.rows() == []


def test_no_points_need_no_workers(store, fake_rows, monkeypatch):
    made = plan("alpha=0")
    for row in fake_rows(made).values():
        store.put(row)
    monkeypatch.delattr(sweep, "_pool")
    assert sweep.run(made, store, jobs=2).reused == 1
