"""A Dask cluster: the same rows as here, whoever dies; data go to workers that have none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("distributed", reason="needs the extra `dask`")

from fracbench.data.files import write_image
from fracbench.errors import DataError, FracbenchError, InputError
from fracbench.harness.run import compute_point, dask, sweep
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.point import Job, Point
from fracbench.harness.run.store import Row, Store
from fracbench.model import SOLVER_VERSION
from fracbench.model.params import FlowParams

SMALL = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1")


class Running:
    """A cluster of two worker processes, each with its nanny, in a process of its own."""

    def __init__(self) -> None:
        script = Path(__file__).parents[2] / "helpers" / "dask_cluster.py"
        self.process = subprocess.Popen(
            [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.address, *pids = self.process.stdout.readline().split()
        self.workers = [int(pid) for pid in pids]

    def close(self) -> None:
        """End scheduler and workers, at once."""
        self.process.kill()
        self.process.communicate(timeout=60)


@pytest.fixture(scope="module")
def clusters():
    started = []
    yield started
    for one in started:
        one.close()


@pytest.fixture
def running(clusters):
    """A cluster that runs: the one of the test before, unless that has ended it."""
    if not clusters or clusters[-1].process.poll() is not None:
        clusters.append(Running())
    return clusters[-1]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(dask, "_POLL_SECONDS", 0.3)


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "store.sqlite") as opened:
        yield opened


def plan(*tokens, address):
    return make_plan([*tokens, *SMALL, "parallel=dask", f"parallel.address={address}"], allow_download=False)


def values(row):
    return {name: value for name, value in row.result.items() if name != "phases"}


def replace_compute(monkeypatch, instead):
    """Let workers call ``instead(compute)``; functions reach them by value, with what is enclosed here."""
    real = dask._compute

    def compute(job, files, topic):
        return instead(job, lambda: real(job, files, topic))

    monkeypatch.setattr(dask, "_compute", compute)


def test_a_worker_killed_in_mid_sweep_costs_one_retry_and_changes_no_bit(running, store, monkeypatch, tmp_path):
    first = tmp_path / "first"

    def instead(job, compute):
        import os
        import time

        try:
            with first.open("x") as file:
                file.write(str(os.getpid()))
            time.sleep(0.3)
        except FileExistsError:
            time.sleep(1.0)
        return compute()

    replace_compute(monkeypatch, instead)
    made = plan("alpha=0:2:0.25", "max_iter=2", address=running.address)
    killed = []

    def on_row(row):
        if not killed:  # the other worker is still at its first point
            (other,) = (pid for pid in running.workers if pid != int(first.read_text()))
            running.workers.remove(other)
            killed.append(other)
            os.kill(other, signal.SIGKILL)

    report = sweep.run(made, store, jobs=1, on_row=on_row)
    assert (report.computed, report.failed) == (9, [])
    assert sorted(row.attempts for row in report.rows.values()) == [1] * 8 + [2]
    assert sweep.run(made, store, jobs=1).computed == 0
    for key, point in made.unique().items():
        here = Row.from_json(
            replace(report.rows[key], result=compute_point.run_point(point, None).result).to_json()
        )
        assert values(here) == values(report.rows[key])


@pytest.mark.parametrize("row", [None, "the row"])
def test_what_a_worker_returned_as_it_died_is_not_waited_for(row):
    class Lost:
        status = "finished"

        def result(self, timeout):
            raise TimeoutError

    pool, lost = object.__new__(dask.DaskPool), Lost()
    pool._busy = {"worker": (a_job(key="k"), lost)}
    pool._rows = {} if row is None else {"k": row}
    assert pool._end("worker", lost) == [("k", row)]
    assert pool._busy == {}


def test_what_a_worker_finished_outlives_it(running, store, monkeypatch, tmp_path):
    log = tmp_path / "log"

    def instead(job, compute):
        import os
        import time

        with log.open("a") as file:
            file.write(f"{job.key}\n")
        compute()
        time.sleep(1.0)  # the row is on its way, the result of the task is not
        os._exit(9)

    replace_compute(monkeypatch, instead)
    report = sweep.run(plan("alpha=0.1,0.2", "max_iter=1", address=running.address), store, jobs=1)
    assert [(row.status, row.attempts) for row in report.rows.values()] == [("done", 1)] * 2
    assert sorted(log.read_text().split()) == sorted(report.rows)


def test_a_worker_that_dies_twice_makes_a_row(running, store, monkeypatch):
    def instead(job, compute):
        import os

        if job.point.canonical["alpha"] == "0.3":
            os._exit(9)
        return compute()

    replace_compute(monkeypatch, instead)
    report = sweep.run(plan("alpha=0.3,0.4", "max_iter=1", address=running.address), store, jobs=1)
    assert sorted((row.status, row.attempts) for row in report.rows.values()) == [("crashed", 2), ("done", 1)]


def test_a_point_over_time_is_a_row(running, store, monkeypatch):
    def instead(job, compute):
        import time

        from fracbench.harness.run import compute_point

        def run_point(point, folder, guard):
            with guard():
                time.sleep(600)

        real, compute_point.run_point = compute_point.run_point, run_point
        try:
            return compute()
        finally:
            compute_point.run_point = real

    replace_compute(monkeypatch, instead)
    made = plan("alpha=0.5", "max_iter=1", "parallel.timeout=0.5", address=running.address)
    (row,) = sweep.run(made, store, jobs=1).rows.values()
    assert (row.status, row.error, row.attempts) == ("timeout", "not finished within the 0.5 s allowed", 1)


def test_real_data_are_sent_to_workers_that_have_none(running, store, middlebury):
    tokens = ["region=grove2_B", "n_scales=1", "n_warps=1", "max_iter=1", f"paths.data={middlebury}"]
    made = make_plan([*tokens, "parallel=dask", f"parallel.address={running.address}"])
    report = sweep.run(made, store, jobs=1)
    assert [row.status for row in report.rows.values()] == ["done"]


def test_files_of_ones_own_are_sent_to_workers(running, store, tmp_path):
    scene = tmp_path / "training/clean/alley_1"
    scene.mkdir(parents=True)
    for number in (1, 2, 3):
        write_image(scene / f"frame_{number:04d}.png", np.eye(24, dtype=np.uint8) * 80 * number)
    tokens = ["dataset=sintel", f"paths.data={tmp_path}", "n_scales=1", "n_warps=1", "max_iter=1"]
    made = make_plan([*tokens, "parallel=dask", f"parallel.address={running.address}"])
    report = sweep.run(made, store, jobs=1)
    assert [(row.status, row.error) for row in report.rows.values()] == [("done", None)] * 2


def test_points_under_way_end_with_the_sweep(running, store, monkeypatch, tmp_path):
    log = tmp_path / "log"
    log.touch()

    def instead(job, compute):
        import os
        import time

        from fracbench.harness.run import compute_point

        def run_point(point, folder, guard):
            with log.open("a") as file:
                file.write(f"{os.getpid()}\n")
            time.sleep(600)

        real, compute_point.run_point = compute_point.run_point, run_point
        try:
            return compute()
        finally:
            compute_point.run_point = real

    class Interrupted(dask.DaskPool):
        def _wait(self, seconds):
            if len(log.read_text().split()) >= 2:
                raise KeyboardInterrupt
            return super()._wait(seconds)

    replace_compute(monkeypatch, instead)
    monkeypatch.setattr(sweep, "_pool", lambda plan, jobs, store: Interrupted(running.address, store))
    with pytest.raises(KeyboardInterrupt):
        sweep.run(plan("alpha=0,1,2", "max_iter=1", address=running.address), store, jobs=1)
    for pid in map(int, log.read_text().split()):
        deadline = time.monotonic() + 20
        while alive(pid):
            assert time.monotonic() < deadline, "a point of a sweep that was ended runs on"
            time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_scheduler_that_goes_ends_the_sweep_in_one_line(running, store):
    made = plan("alpha=0,1,2", "max_iter=1", address=running.address)
    with pytest.raises(FracbenchError, match="does not answer any more") as caught:
        sweep.run(made, store, jobs=1, on_row=lambda row: running.close())
    assert len(str(caught.value).splitlines()) == 1
    assert 1 <= len(store.rows()) <= 3


# -- without a cluster -----------------------------------------------------------------------------


def a_job(**changes):
    point = Point("tvl1", FlowParams(), "middlebury", "Grove2", None, 0, "digest")
    return Job(
        **{"key": "k", "point": point, "attempt": 1, "solver_version": SOLVER_VERSION, "commit": {}} | changes
    )


def test_data_that_are_not_what_they_should_be_are_refused():
    with pytest.raises(DataError, match=r"Grove2/frame10\.png"):
        dask._unpack(a_job(), {"frame10.png": b"x", "frame11.png": b"y", "flow10.flo": b"z"})


@pytest.mark.parametrize("file", ["../a.png", "a/../../b.png", "/a.png"])
def test_no_file_that_is_sent_leads_out_of_the_workers_folder(file):
    with pytest.raises(InputError, match=r"dataset middlebury: the file .* leads out of its folder"):
        dask._unpack(a_job(), {file: b"x"})


def test_a_worker_without_the_data_asks_for_them():
    assert dask._compute(a_job(), {}, "topic") is False


def test_a_worker_with_another_solver_is_refused():
    with pytest.raises(InputError, match="install the same fracbench"):
        dask._compute(a_job(solver_version=SOLVER_VERSION + 1), {}, "topic")


@pytest.mark.parametrize(
    ("address", "message"),
    [(None, "needs the address of a scheduler"), ("tcp://127.0.0.1:9", "no Dask scheduler answers there")],
)
def test_a_scheduler_that_is_not_there(address, message, monkeypatch):
    monkeypatch.setattr(dask, "_CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match=message) as caught:
        dask.DaskPool(address, None)
    assert len(str(caught.value).splitlines()) == 1


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(dask.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'fracbench\[dask\]'"):
        dask.DaskPool("tcp://127.0.0.1:8786", None)


@pytest.mark.parametrize(("workers", "said"), [({}, 1), ({"tcp://there:1": 1}, 0)])
def test_a_cluster_without_workers_is_told_once(monkeypatch, store, caplog, workers, said):
    client = SimpleNamespace(status="running", nthreads=lambda: workers, subscribe_topic=lambda *_: None)
    monkeypatch.setattr(dask, "_connect", lambda address: client)
    monkeypatch.setattr(dask, "_POLL_SECONDS", 0.0)
    pool = dask.DaskPool("tcp://there:8786", store)
    for _ in range(3):
        pool._look()
    assert caplog.messages == ["tcp://there:8786 has no workers yet; waiting for them"] * said
