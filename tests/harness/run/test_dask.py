"""A Dask cluster: the same rows as here, whoever dies; data go to workers that have none."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("distributed", reason="needs the extra `dask`")

from fracbench.data.files import write_image
from fracbench.errors import DataError, FracbenchError, InputError
from fracbench.harness.run import batches, compute_point, dask, sweep
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.point import Job, Outcome, Point
from fracbench.harness.run.store import Row, Store, encode
from fracbench.harness.run.tidy import tidy
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

    def is_whole(self) -> bool:
        """Tell whether both workers are there again: a nanny may fail to start one anew."""
        from distributed import Client

        if self.process.poll() is not None:
            return False
        with Client(self.address, set_as_default=False) as client:
            try:
                client.wait_for_workers(2, timeout=30)
            except TimeoutError:
                return False
        return True

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
    """A cluster of two workers: the one of the test before, unless that has ended it or a worker for good."""
    if not clusters or not clusters[-1].is_whole():
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
    """Let workers call ``instead(job, compute)`` for each point; it reaches them by value."""
    real_batch = batches.run_batch

    def run_batch(*args):
        from fracbench.harness.run import batches

        real = batches.compute
        batches.compute = lambda job, mail: instead(job, lambda: real(job, mail))
        try:
            return real_batch(*args)
        finally:
            batches.compute = real

    monkeypatch.setattr(dask, "run_batch", run_batch)


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


def test_a_worker_killed_in_mid_batch_loses_nothing_and_the_table_is_that_of_one_machine(
    running, store, monkeypatch, tmp_path
):
    log = tmp_path / "log"
    log.touch()

    def instead(job, compute):
        import os
        import time

        with log.open("a") as file:
            file.write(f"{job.key} {os.getpid()}\n")
        time.sleep(0.1)
        compute()

    replace_compute(monkeypatch, instead)
    tokens = ("alpha=0.05:2:0.05", "lambda=0.3,0.5", "max_iter=1")
    made = plan(*tokens, address=running.address)
    batches_of, killed, finished = [], [], set()

    class Watched(dask.DaskPool):
        def _give_up(self, name):
            batches_of.extend([*batch.jobs] for batch in self._workers[name].batches)
            return super()._give_up(name)

    def on_row(row):
        finished.add(row.key)
        under_way = {name: worker.batches[0].jobs for name, worker in pool._workers.items() if worker.batches}
        name = next((name for name, jobs in under_way.items() if len(jobs) > 2), None)
        if not killed and len(finished) >= 20 and name:
            killed.append({*finished})
            pid = pool._client.run(os.getpid)[name]
            running.workers = [other for other in running.workers if other != pid]
            os.kill(pid, signal.SIGKILL)

    pool = Watched(running.address, store)
    with monkeypatch.context() as patched:
        patched.setattr(sweep, "_pool", lambda plan, jobs, store: pool)
        report = sweep.run(made, store, jobs=1, on_row=on_row)
    assert (report.computed, report.failed, len(killed)) == (80, [], 1)
    attempts = {key: row.attempts for key, row in report.rows.items()}
    begun = next(keys for keys in batches_of if keys)
    assert len(begun) > 1, "no batch was hit in the middle"
    assert {key for key, count in attempts.items() if count == 2} == set(begun)
    assert set(attempts.values()) == {1, 2}
    starts = Counter(line.split()[0] for line in log.read_text().splitlines())
    assert {starts[key] for key in killed[0]} == {1}, "a finished point was computed again"

    with Store(tmp_path / "here.sqlite") as other:
        here = make_plan([*tokens, *SMALL], allow_download=False)
        rows = sweep.run(here, other, jobs=2).rows
        assert tidy(made, report.rows).to_csv() == tidy(here, rows).to_csv()


@pytest.mark.parametrize("row", [None, "the row"])
def test_what_a_worker_returned_as_it_died_is_not_waited_for(row):
    class Lost:
        status = "finished"

        def result(self, timeout):
            raise TimeoutError

    pool, job = a_pool(), a_job(key="k", timeout=1.0)
    (batch,) = sent(pool, [job])
    batch.future.__class__ = Lost
    ended = [] if row is None else pool._read(0.1, [encode(job.expired({}))])
    ended += pool._end(batch, batch.future)
    assert [(key, found is not None) for key, found in ended] == [("k", row is not None)]
    assert not pool._out and not pool._workers["worker"].batches


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


class Future:
    status = "pending"
    cancelled = False

    def add_done_callback(self, call):
        self.call = call

    def end(self, status="finished"):
        self.status = status
        self.call(self)

    def result(self, timeout):
        return True

    def cancel(self):
        self.cancelled = True


class Client:
    """A client whose cluster does nothing by itself."""

    status = "running"

    def __init__(self, names):
        self.names, self.receive = list(names), None

    def subscribe_topic(self, topic, receive):
        self.receive = receive

    def nthreads(self):
        return dict.fromkeys(self.names, 1)

    def submit(self, *_, **__):
        return Future()


def a_pool(*names):
    """A pool that has looked, with workers of these names; one called ``worker`` if there are none."""
    pool = dask.DaskPool(None, None, Client(names or ["worker"]))
    pool._look()
    return pool


def sent(pool, jobs):
    """Send what the pool has room for, and return the batches by worker in their order."""
    pool._fill(dask._Source(jobs, pool._again))
    return [batch for worker in pool._workers.values() for batch in worker.batches]


def jobs_of(n, **changes):
    """Jobs of points of 1/8 s, by the pace of `paced`."""
    made = make_plan([*SMALL, f"alpha={','.join(str(i / 1000) for i in range(n))}"], allow_download=False)
    return [
        replace(a_job(**changes), key=planned.point.key, point=replace(planned.point, shape=(128, 128)))
        for planned in made.points
    ]


def paced(*names):
    pool = a_pool(*names)
    pool._pace.learn([job.point for job in jobs_of(1)], 0.125)
    return pool


def sizes(found):
    return [len(batch.jobs) for batch in found]


def test_a_batch_is_a_second_of_work_and_those_behind_it_five_at_most():
    pool = paced("a")
    first, second = sent(pool, jobs_of(400))
    assert sizes([first, second]) == [8, 40]
    assert not pool._idle and not pool._busy
    assert sizes(sent(paced("a", "b"), jobs_of(6))) == [3, 3]  # nobody waits while another has a queue


def test_points_of_unknown_time_go_alone():
    assert sizes(sent(a_pool("a"), jobs_of(5))) == [1]


def test_points_of_unknown_time_do_not_join_a_batch():
    jobs = jobs_of(2)
    jobs.append(replace(jobs[0], point=replace(jobs[0].point, method="tvl1")))
    assert sizes(sent(paced("a"), jobs)) == [2, 1]


def test_rows_that_have_come_are_stored_when_the_scheduler_goes(store):
    pool, jobs = paced("a"), jobs_of(400)
    pool._store = store
    ended = pool.compute(jobs)
    pool._messages.put((None, [0.1, [encode(job.row(an_outcome())) for job in jobs[:1]]]))
    assert next(ended)[0] == jobs[0].key
    pool._messages.put((None, [0.1, [encode(job.row(an_outcome())) for job in jobs[1:3]]]))
    pool._client.status = "closed"
    pool._next_look = 0.0
    with pytest.raises(FracbenchError, match="does not answer any more"):
        for _ in ended:
            pool._next_look = 0.0
    assert set(store.keys()) == {job.key for job in jobs[:3]}


def test_points_that_are_tried_again_go_alone():
    first, second = sent(paced("a"), jobs_of(4, attempt=2))
    assert sizes([first, second]) == [1, 1]


def test_no_point_waits_behind_a_single_one_that_takes_long():
    pool = a_pool("a")
    jobs = jobs_of(5)
    pool._pace.learn([jobs[0].point], 60.0)
    assert sizes(sent(pool, jobs)) == [1]


def test_the_unfinished_points_of_a_dead_workers_batch_count_an_attempt_and_those_behind_do_not():
    pool = paced("a")
    jobs = jobs_of(400)
    first, second = sent(pool, jobs)
    done = [encode(job.row(an_outcome())) for job in jobs[:4]]
    assert pool._read(0.4, done) == [(row[0], row) for row in done]
    assert pool._give_up("a") == [(job.key, None) for job in jobs[4:8]]
    assert list(pool._again) == jobs[8:48]
    assert first.future.cancelled and second.future.cancelled
    assert not pool._out
    assert pool._read(0.4, done) == []  # what comes twice is stored once


def test_a_time_limit_costs_no_other_point_of_the_batch():
    pool = paced("a")
    jobs = jobs_of(400)
    sent(pool, jobs)
    rows = [encode(jobs[0].row(an_outcome())), encode(replace(jobs[1], timeout=1.0).expired({}))]
    assert len(pool._read(0.4, rows)) == 2
    assert pool._give_up("a") == []
    assert list(pool._again) == jobs[2:48]


def test_a_batch_that_was_through_does_not_shield_the_next_one():
    pool = paced("a")
    jobs = jobs_of(400)
    sent(pool, jobs)
    pool._read(1.0, [encode(job.row(an_outcome())) for job in jobs[:8]])
    assert pool._give_up("a") == [(job.key, None) for job in jobs[8:48]]


def test_files_of_one_pair_go_with_a_batch(monkeypatch):
    jobs = jobs_of(400)
    for job in jobs[3:]:
        object.__setattr__(job.point, "data_digest", "another")
    assert sizes(sent(paced("a"), jobs)) == [8, 40]  # rendered pairs have none
    monkeypatch.setattr(dask, "contents_of", lambda point: lambda name, folder: {})
    assert sizes(sent(paced("a"), jobs)) == [3, 40]


def test_what_is_packed_comes_back():
    jobs = [*jobs_of(3, timeout=2.0, folder=Path("data")), a_job(), *jobs_of(5)[3:]]
    jobs[1] = replace(jobs[1], attempt=2)
    batch = pickle.loads(pickle.dumps(batches.Batch(jobs)))
    assert list(batch.jobs()) == jobs
    assert [job.point.spec for job in batch.jobs()] == [job.point.spec for job in jobs]
    one, two = (len(pickle.dumps(batches.Batch(jobs_of(n)))) for n in (1, 2))
    assert two - one < 200  # of the second, what differs


def test_a_worker_that_makes_other_keys_is_refused():
    first, second = jobs_of(2)
    with pytest.raises(InputError, match="install the same fracbench"):
        list(batches.Batch([first, replace(second, key="f" * 64)]).jobs())


def an_outcome():
    return Outcome("done", None, {"aae": 0.5}, 0.1, None, {})


def a_job(**changes):
    point = Point("tvl1", FlowParams(), "middlebury", "Grove2", None, 0, "digest")
    return Job(
        **{"key": "k", "point": point, "attempt": 1, "solver_version": SOLVER_VERSION, "commit": {}} | changes
    )


def test_data_that_are_not_what_they_should_be_are_refused():
    with pytest.raises(DataError, match=r"Grove2/frame10\.png is corrupt"):
        batches.load_files(
            a_job(), {f"Grove2/{file}": b"x" for file in ("frame10.png", "frame11.png", "flow10.flo")}
        )


@pytest.mark.parametrize("file", ["../a.png", "a/../../b.png", "/a.png"])
def test_no_file_that_is_sent_leads_out_of_the_workers_folder(file):
    with pytest.raises(InputError, match=r"dataset middlebury: the file .* leads out of its folder"):
        batches.load_files(a_job(), {file: b"x"})


def test_a_worker_without_the_data_asks_for_them():
    assert batches.run_batch(batches.Batch([a_job()]), {}, "topic", 0.0) is False


def test_a_worker_with_another_solver_is_refused():
    with pytest.raises(InputError, match="install the same fracbench"):
        batches.run_batch(batches.Batch([a_job(solver_version=SOLVER_VERSION + 1)]), {}, "topic", 0.0)


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
