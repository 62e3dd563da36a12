"""Sweeps that are killed at random moments, run side by side, or find the disk full: nothing is lost or doubled.

``FRACBENCH_KILLS`` is the number of kills, 4 by default; 50 take some minutes.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

from fracbench.errors import RESUME
from fracbench.harness.run import sweep as execute
from fracbench.harness.run.store import STORE, Row, Store

KILLS = int(os.environ.get("FRACBENCH_KILLS", "4"))
POINTS = 36
#: Three swept numbers make no plot.
GRID = (
    "sweep", "sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1",
    "alpha=0.3:1.8:0.3", "lambda=0.1,0.2,0.3", "theta=0.2,0.3"
)  # fmt: skip
LOGGED = str(Path(__file__).parents[2] / "helpers" / "logged_sweep.py")
PATIENCE = 120.0

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no process groups here")


class Sweep:
    """A folder in which one command is started again and again."""

    def __init__(self, folder: Path, seconds: float = 0.03) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self.seconds, self.log = folder, seconds, folder / "log"
        self.log.touch()

    def start(self, *options: str, **how) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, LOGGED, str(self.log), str(self.seconds), *GRID, *options],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            **how,
        )

    def finish(self, *options: str) -> bytes:
        """Run to the end, undisturbed, and return the CSV."""
        process = self.start(*options)
        said, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, said
        return self.csv()

    def csv(self) -> bytes:
        (path,) = (self.folder / "results" / "sweeps").glob("*.csv")
        return path.read_bytes()

    def lines(self) -> list[list[str]]:
        return [line.split() for line in self.log.read_text().splitlines()]

    def stored(self) -> dict[str, Row]:
        with Store(self.folder / "results" / STORE, readonly=True) as store:
            return {row.key: row for row in store.rows("done")}

    def wait_for_starts(self, process: subprocess.Popen[str], count: int) -> None:
        """Wait until so many more points were started, or the process ends."""
        before, deadline = len(self.lines()), time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < deadline:
            if sum(line[0] == "start" for line in self.lines()[before:]) >= count:
                return
            time.sleep(0.005)

    def check(self, expected: bytes, kept: dict[str, Row]) -> None:
        """Finish, without delay, and see that nothing was lost, doubled, or computed again."""
        self.seconds = 0.0
        assert self.finish("--rerun", "failed") == expected
        rows = self.stored()
        assert len(rows) == POINTS
        assert {key: rows[key] for key in kept} == kept
        ended: set[str] = set()
        for what, key, _ in self.lines():
            assert what == "end" or key not in ended, "a finished point was started again"
            ended |= {key} if what == "end" else set()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> bytes:
    sweep = Sweep(tmp_path_factory.mktemp("undisturbed"), 0.0)
    csv = sweep.finish()
    assert Counter(line[0] for line in sweep.lines()) == {"start": POINTS, "end": POINTS}
    return csv


def kill(kind: str, process: subprocess.Popen[str], lines: list[list[str]]) -> None:
    """Kill the parent, the worker that was last heard of, or the whole process group."""
    try:
        if kind == "everything":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            os.kill(int(lines[-1][2]) if kind == "worker" and lines else process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def test_random_kills_lose_nothing_and_compute_nothing_twice(tmp_path, undisturbed):
    chance, sweep, kept, rounds = random.Random(20240229), Sweep(tmp_path / "0"), {}, 0
    done = Counter[str]()
    process = sweep.start()
    while done.total() < KILLS:
        sweep.wait_for_starts(process, chance.randint(0, 5))
        time.sleep(chance.uniform(0.0, 0.08))
        if process.poll() is not None:  # all points are through: the next round
            process.communicate()
            sweep.check(undisturbed, kept)
            rounds += 1
            sweep, kept = Sweep(tmp_path / str(rounds)), {}
            process = sweep.start()
            continue
        kind = chance.choice(["parent", "worker", "everything"])
        kept |= sweep.stored()
        kill(kind, process, sweep.lines())
        done[kind] += 1
        if kind != "worker":
            process.communicate(timeout=PATIENCE)
            process = sweep.start()
    kill("everything", process, [])
    process.communicate(timeout=PATIENCE)
    sweep.check(undisturbed, kept)
    print(f"{done.total()} kills ({dict(done)}), {rounds + 1} sweeps")


def test_two_sweeps_at_once_share_the_points(tmp_path, undisturbed):
    sweep = Sweep(tmp_path, 0.05)
    both = [sweep.start("--jobs", "1") for _ in range(2)]
    for process in both:
        said, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, said
    assert sweep.csv() == undisturbed
    starts = Counter(key for what, key, _ in sweep.lines() if what == "start")
    assert len(starts) == POINTS
    if execute.fcntl is not None:
        assert set(starts.values()) == {1}


def test_ctrl_c_stops_the_workers_too_and_says_how_to_go_on(tmp_path, undisturbed):
    sweep = Sweep(tmp_path, 0.2)
    process = sweep.start()
    sweep.wait_for_starts(process, 4)
    pids = {int(pid) for _, _, pid in sweep.lines()}
    before = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to parent and workers alike
    said, _ = process.communicate(timeout=PATIENCE)
    took = time.monotonic() - before
    assert process.returncode == 130
    last = said.splitlines()[-1]
    assert last == f"fracbench: interrupted; {RESUME}"
    assert "Traceback" not in said
    print(f"stopped after {took:.2f} s")
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    sweep.check(undisturbed, {})


def test_ctrl_c_does_not_wait_for_the_points(tmp_path):
    sweep = Sweep(tmp_path, 600.0)
    process = sweep.start()
    sweep.wait_for_starts(process, 2)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130


def test_a_full_disk_is_one_line_and_the_sweep_goes_on_later(tmp_path, undisturbed):
    resource = pytest.importorskip("resource")

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    sweep = Sweep(tmp_path)
    process = sweep.start(preexec_fn=small_disk)
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2, said
    (line,) = (line for line in said.splitlines() if line.startswith("fracbench: "))
    assert "store.sqlite: the disk cannot be read or written; check its space, quota and health" in line
    assert "Traceback" not in said
    kept = sweep.stored()
    assert 0 < len(kept) < POINTS
    with closing(Store(sweep.folder / "results" / STORE, readonly=True)) as store:
        assert store._db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    sweep.check(undisturbed, kept)
