"""Disturb a sweep of many small points: kills, a full disk, a clock that goes back; and see that nothing was lost.

Two sweeps of the same points run one after another: one is left alone, the other is killed every 20 s on average
(its parent, a worker, or all), finds its disk full, and sees its clock go back by an hour. The table must be the
same, no finished point may be computed again, and the memory of the processes that are left alone must not grow.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import common
import numpy as np

from fracbench.commands import cli, console
from fracbench.commands.bench import results_stem, write_results
from fracbench.errors import FracbenchError, InputError
from fracbench.harness.run import pool
from fracbench.harness.run.store import STORE, Store

_SMALL = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1")
_WORD = "--as-sweep"
_DISK_MIB = 400
_BACK_SECONDS = 3600.0
#: Shares of the points after which the disk is full and the clock goes back.
_FULL, _BACK = 0.4, 0.6
#: The share after which memory is watched: caches are full by then.
_STEADY = 0.5
#: MiB by which a process may grow from then on: what it takes and gives back at each point varies by as much.
_MAX_GROWN = 2.0


def as_sweep(log: Path, clock: Path, arguments: list[str]) -> int:
    """Run the command line; workers log each point's start and end, and take the time from a file's offset."""
    real = pool._compute

    def compute(job: Any, store: Any, marks: Any, parent: int) -> Any:  # reaches the workers by value
        from fracbench.harness.run import store as module

        class Clock:
            @staticmethod
            def now(zone: Any) -> datetime:
                return datetime.now(zone) + timedelta(seconds=float(clock.read_text() or 0))

        def say(what: str) -> None:
            with log.open("a") as file:
                file.write(f"{what} {job.key}\n")

        module.datetime = Clock  # type: ignore[attr-defined,assignment]
        say("start")
        row = real(job, store, marks, parent)
        say("end  ")
        return row

    pool._compute = compute
    return cli.main(arguments)


@dataclass
class Soak:
    """A folder in which one command is started again and again until its points are through; and its log."""

    folder: Path
    notes: Path
    points: int
    samples: list[tuple[float, int, float, float]] = field(default_factory=list)  # s, points, MiB parent, worker
    done: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)
        self.notes.mkdir(exist_ok=True)
        self.log, self.clock = self.notes / "log", self.notes / "clock"
        self.log.touch()
        self.clock.touch()
        self.side = round((self.points / 10) ** 0.5)
        self.points = 10 * self.side**2
        self.began = datetime.now(UTC).isoformat(timespec="seconds")

    def start(self) -> subprocess.Popen[str]:
        """Start the sweep in a process group of its own."""
        alphas, lambdas = (
            ",".join(f"{start + width * i / self.side:.5g}" for i in range(self.side))
            for start, width in ((0, 2), (0.1, 1))
        )
        # All orders come early: what a worker keeps for each of them is no growth with the points.
        grid = [*_SMALL, "theta=0.1:1:0.1", f"lambda={lambdas}", f"alpha={alphas}"]
        words = [sys.executable, __file__, _WORD, str(self.log), str(self.clock), "sweep", *grid]
        return subprocess.Popen(
            [*words, "--rerun", "failed"],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def ended(self) -> int:
        """Return how many points have ended."""
        return sum(line.startswith("end") for line in self.log.read_text().splitlines())

    def sample(self, process: subprocess.Popen[str], started: float) -> None:
        """Take down the memory of the parent and of its largest worker."""
        worker = max((_resident(pid) for pid in _children(process.pid)), default=0.0)
        self.samples.append((time.monotonic() - started, self.ended(), _resident(process.pid), worker))

    def run(self, disturb: Any = None) -> float:
        """Run the sweep to its end, and return the seconds; ``disturb(soak, process)`` is called once a second."""
        started = time.monotonic()
        while True:
            process = self.start()
            while process.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(1.0)
                if process.poll() is None:
                    self.sample(process, started)
                    if disturb is not None:
                        disturb(self, process)
            said = process.communicate()[0]
            if process.returncode == 0:
                return time.monotonic() - started
            if process.returncode == 2:
                self.full(said)
            elif process.returncode != -signal.SIGKILL:
                raise FracbenchError(f"the sweep ended with code {process.returncode}: {said[-500:]}")

    def full(self, said: str) -> None:
        """See that a full disk was told in one line and left the store whole; then make room."""
        lines = [line for line in said.splitlines() if line.startswith("fracbench: ")]
        if len(lines) != 1 or "Traceback" in said or not self.ballast.exists():
            raise FracbenchError(f"the sweep ended with code 2: {said[-500:]}")
        console.say(f"the disk was full: {lines[0]}")
        self.ballast.unlink()
        with sqlite3.connect(self.folder / "results" / STORE) as db:
            if db.execute("PRAGMA integrity_check").fetchone() != ("ok",):
                raise FracbenchError("the full disk has damaged the store")

    @property
    def ballast(self) -> Path:
        """The file that fills the disk."""
        return self.folder / "ballast"

    def csv(self) -> bytes:
        """Return the table."""
        (path,) = (self.folder / "results" / "sweeps").glob("*.csv")
        return path.read_bytes()

    def check(self) -> tuple[int, int, int]:
        """Return the numbers of rows, of points that were computed again, and of rows dated too early."""
        ended: set[str] = set()
        again = 0
        for line in self.log.read_text().splitlines():
            what, key = line.split()
            again += what == "start" and key in ended
            ended |= {key} if what == "end" else set()
        with Store(self.folder / "results" / STORE, readonly=True) as store:
            early = sum(row.created < self.began for row in store.rows("done"))
            return store.counts()["done"], again, early

    def slopes(self) -> tuple[float, float]:
        """Return the growth of the parent and of the largest worker, MiB per 1,000 points, in the second half."""
        later = np.array([each for each in self.samples if _STEADY * self.points < each[1] < self.points])
        if len(later) < 3:
            return np.nan, np.nan
        parent, worker = (float(1000 * np.polyfit(later[:, 1], later[:, i], 1)[0]) for i in (2, 3))
        return parent, worker

    def grown(self) -> float:
        """Return the MiB by which the parent or the largest worker, whichever more, grew in the second half."""
        return max(self.slopes()) * (1.0 - _STEADY) * self.points / 1000


class Trouble:
    """What happens to a sweep; the same for the same seed, as far as time allows."""

    def __init__(self, every: float, *, full_disk: bool) -> None:
        self._chance, self._every = random.Random(20240229), every
        self._next = time.monotonic() + self._chance.expovariate(1 / every)
        self._full_disk, self._back = full_disk, False

    def __call__(self, soak: Soak, process: subprocess.Popen[str]) -> None:
        """Fill the disk, put the clock back, or kill, if it is time."""
        ended = soak.ended()
        if self._full_disk and ended > _FULL * soak.points:
            self._full_disk = False
            soak.done["full disk"] += 1
            with suppress(OSError), soak.ballast.open("wb", buffering=0) as file:
                while True:
                    file.write(bytes(1 << 16))
        if not self._back and ended > _BACK * soak.points:
            self._back = True
            soak.done["clock back"] += 1
            soak.clock.write_text(str(-_BACK_SECONDS))
        if time.monotonic() < self._next or soak.ballast.exists():
            return
        self._next = time.monotonic() + self._chance.expovariate(1 / self._every)
        kind = self._chance.choice(["parent", "worker", "all"])
        with suppress(ProcessLookupError, IndexError):
            if kind == "all":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                workers = [pid for pid in _children(process.pid) if _resident(pid) > 50.0]
                os.kill(process.pid if kind == "parent" else self._chance.choice(workers), signal.SIGKILL)
            soak.done[f"kill of {kind}"] += 1


def _children(pid: int) -> list[int]:
    with suppress(OSError):
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


def _resident(pid: int) -> float:
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    return 0.0


@contextmanager
def _small_disk() -> Iterator[Path | None]:
    """Yield a folder on a file system of its own in memory; None where this user may not mount one."""
    folder = Path(tempfile.mkdtemp(prefix="fracbench-"))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={_DISK_MIB}m", "tmpfs", str(folder)]
    mounted = shutil.which("mount") is not None and subprocess.run(mount, capture_output=True).returncode == 0
    try:
        yield folder if mounted else None
    finally:
        if mounted:
            subprocess.run(["umount", "--lazy", str(folder)], check=True)
        shutil.rmtree(folder, ignore_errors=True)


def measure(arguments: argparse.Namespace) -> None:
    """Run both sweeps, compare them, print and write the table."""
    stem = results_stem(arguments.overrides, "soak")
    with tempfile.TemporaryDirectory(prefix="fracbench-") as other, _small_disk() as disk:
        alone = Soak(Path(other, "alone"), Path(other, "log"), arguments.points)
        disturbed = Soak((disk or Path(other)) / "disturbed", Path(other, "other_log"), arguments.points)
        if disk is None:
            console.say("without a full disk: this user may not mount a file system")
        records = []
        for soak, disturb in ((alone, None), (disturbed, Trouble(arguments.every, full_disk=disk is not None))):
            seconds = soak.run(disturb)
            rows, again, early = soak.check()
            # Kills start processes anew: no growth of one process can be told.
            parent, worker = soak.slopes() if disturb is None else (np.nan, np.nan)
            records.append({
                "sweep": soak.folder.name,
                "rows": rows,
                "again": again,
                "early": early,
                "seconds": seconds,
                "kills": sum(count for what, count in soak.done.items() if what.startswith("kill")),
                "parent_mib": max(each[2] for each in soak.samples),
                "worker_mib": max(each[3] for each in soak.samples),
                "parent_growth": parent,
                "worker_growth": worker,
            })  # fmt: skip
            if soak.done:
                console.say(", ".join(f"{what}: {count}" for what, count in sorted(soak.done.items())))
        same = alone.csv() == disturbed.csv()
    console.say(f"the tables are {'the same' if same else 'not the same'}, byte for byte")
    console.say("again: finished points that were computed again; early: rows dated before the sweep began")
    note = "growth: MiB per 1,000 points in the second half, of the parent and of the largest worker; one run"
    write_results(records, stem, "A sweep that is disturbed", note)
    if not same or any(record["again"] for record in records) or records[0]["rows"] != records[1]["rows"]:
        raise FracbenchError("the disturbed sweep is not as the other")
    if disturbed.done["clock back"] and not records[1]["early"]:
        raise FracbenchError("the clock did not go back")
    if alone.grown() > _MAX_GROWN:
        raise FracbenchError(f"the memory of a process that was left alone grew by {alone.grown():.1f} MiB")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark and return its exit code."""
    if argv and argv[0] == _WORD:
        return as_sweep(Path(argv[1]), Path(argv[2]), list(argv[3:]))
    if not Path("/proc/self/status").exists() or not hasattr(os, "killpg"):
        raise InputError("soak needs Linux")
    parser = common.parser(__doc__, repeats=False)
    parser.add_argument("--points", type=int, default=20_000, metavar="N", help="default: 20,000, about")
    parser.add_argument("--every", type=float, default=20.0, metavar="S", help="between kills (default: 20)")
    return common.run(measure, parser, argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
