"""Run the points of a plan that the store does not hold yet."""

from __future__ import annotations

import importlib.util
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from fracbench.errors import InputError
from fracbench.harness.run import provenance
from fracbench.harness.run.cost import pixels
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import MEASURES, Job, Outcome, Point
from fracbench.harness.run.pool import LocalPool, Pool
from fracbench.harness.run.store import Row, Store
from fracbench.model import SOLVER_VERSION

#: A point whose worker dies is started this many times.
MAX_ATTEMPTS = 2

#: None on Windows, where two sweeps at once are as safe but do not share the work.
fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None

#: Seconds between two looks at points that another sweep has claimed.
_LOOK_SECONDS = 0.2

OnRow = Callable[[Row], None]


@dataclass
class Report:
    """The rows of all points of a run by key, how many were computed and reused, and why points were computed.

    Reused are points that the store held, or that another sweep computed meanwhile. Reasons: ``new``, ``solver
    version 1 -> 2``, ``data changed``, ``failed before``.
    """

    rows: dict[str, Row] = field(default_factory=dict)
    computed: int = 0
    reused: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def failed(self) -> list[Row]:
        """Rows that are not ``done``."""
        return [row for row in self.rows.values() if row.status != "done"]


def missing(plan: Plan, store: Store, *, rerun_failed: bool = False) -> tuple[Report, dict[str, Point]]:
    """Compare a plan with the store: return its rows and reasons, and the points to compute, in order."""
    if not store.readonly:
        _take_loose_rows(store)
    points = plan.unique()
    stored = store.get_many(points)
    report, todo = Report(), {}
    for key, point in points.items():
        row = stored.get(key)
        if row is not None and (row.status == "done" or not rerun_failed):
            report.rows[key] = row
            report.reused += 1
        else:
            todo[key] = point
            report.reasons[_reason(row, point, store)] += 1
    return report, todo


def _take_loose_rows(store: Store) -> None:
    """Store the rows that an older fracbench finished and left beside the store when it was killed."""
    for path in sorted(claims_folder(store.path).glob("*.json")):
        with suppress(ValueError):  # cut short
            store.put(Row.from_json(path.read_text()))
        path.unlink(missing_ok=True)


def _reason(row: Row | None, point: Point, store: Store) -> str:
    if row is not None:
        return f"{row.status} before"
    older = store.by_identity(point.identity)
    if not older:
        return "new"
    latest = older[-1]
    if latest.solver_version != SOLVER_VERSION:
        return f"solver version {latest.solver_version} -> {SOLVER_VERSION}"
    if latest.spec.get("version", "") != point.version:
        return f"{point.method}: {latest.spec.get('version') or 'no version'} -> {point.version}"
    return "data changed"


def run(
    plan: Plan,
    store: Store,
    *,
    jobs: int,
    rerun_failed: bool = False,
    on_row: OnRow | None = None,
) -> Report:
    """Compute the points that the store lacks; each row is stored as soon as its point is done.

    The plan's configuration says where it runs and how long a point may take; `jobs` are processes on this
    machine. `on_row` is called with each new row.
    """
    report, todo = missing(plan, store, rerun_failed=rerun_failed)
    if not todo:
        return report
    with (
        Claims(claims_folder(store.path)) as claims,
        closing(_pool(plan, jobs, store)) as pool,
        closing(_Sweep(todo, store, claims, pool, plan).rows()) as rows,
    ):
        for row, computed in rows:
            report.rows[row.key] = row
            report.computed += computed
            report.reused += not computed
            if on_row is not None:
                on_row(row)
    return report


def compute_here(points: Mapping[str, Point], store: Store, folder: Path | None) -> dict[str, Row]:
    """Return the rows of points by key; those that the store lacks are computed in this process, one by one.

    For many short points that are known one after another: a row costs a transaction, and no message to a worker.
    """
    from fracbench.harness.run.compute_point import run_point

    rows = store.get_many(points)
    for key, point in points.items():
        if key not in rows:
            job = Job(key, point, 1, SOLVER_VERSION, provenance.commit(), folder)
            rows[key] = job.row(run_point(point, folder))
            store.put(rows[key])
    return rows


def _pool(plan: Plan, jobs: int, store: Store) -> Pool:
    parallel = plan.config.parallel
    if parallel.backend == "dask":
        from fracbench.harness.run.dask import DaskPool

        return DaskPool(parallel.address, store)
    return LocalPool(jobs, store)


class _Sweep:
    """One run over missing points: those that wait, are under way, or have lost their worker."""

    def __init__(self, todo: Mapping[str, Point], store: Store, claims: Claims, pool: Pool, plan: Plan) -> None:
        self._todo, self._store, self._claims, self._pool = todo, store, claims, pool
        self._folder = None if plan.folder is None else plan.folder.resolve()
        self._timeout, self._commit = plan.config.parallel.timeout, provenance.commit()
        # The longest go first, so that no worker is left with one of them in the end, and the points of a pair
        # together, so that each worker reads or renders it once.
        pairs = {point.data_digest: i for i, point in enumerate(todo.values())}
        self._waiting = deque(sorted(todo, key=lambda key: (*_turn(todo[key]), pairs[todo[key].data_digest])))
        self._retries: deque[str] = deque()
        self._attempts = Counter[str]()
        self._under_way: set[str] = set()
        self._claimed: list[str] = []  # by another sweep
        self._found: list[Row] = []  # of another sweep
        self._before = store.get_many(todo)  # rows that are to be replaced

    def rows(self) -> Generator[tuple[Row, bool], None, None]:
        """Yield stored rows, and whether they were computed here."""
        while self._waiting or self._retries:
            keys, ended = self._waiting, False
            if not keys and self._pool.retry_alone:
                keys = deque([self._retries.popleft()])
            elif not keys:
                keys, self._retries = self._retries, deque()
            for ended_row in self._compute(keys):
                ended = True
                yield ended_row
            self._waiting.extend(self._claimed)
            self._claimed.clear()
            if not ended:
                time.sleep(_LOOK_SECONDS)

    def _compute(self, keys: deque[str]) -> Iterator[tuple[Row, bool]]:
        """Compute points until there are no more or workers have died."""
        with closing(self._pool.compute(self._jobs(keys))) as ended:
            for key, row in ended:
                self._under_way.remove(key)
                yield from self._settle(key, row)
                while self._found:
                    yield self._found.pop(), False
        while self._found:
            yield self._found.pop(), False
        for key in self._under_way:  # not begun when workers died, or ended at the same moment
            row = self._new(key)
            if row is None:
                self._waiting.append(key)
            else:
                yield from self._settle(key, row)
        self._under_way.clear()

    def _jobs(self, keys: deque[str]) -> Iterator[Job]:
        """Claim points and yield them as jobs; note the points that other sweeps have claimed or finished."""
        while keys:
            key = keys.popleft()
            if not self._claims.take(key):
                self._claimed.append(key)
            elif (row := self._new(key)) is not None:
                self._claims.release(key)
                self._found.append(row)
            else:
                self._under_way.add(key)
                yield self._job(key)

    def _job(self, key: str) -> Job:
        attempt = self._attempts[key] + 1
        return Job(key, self._todo[key], attempt, SOLVER_VERSION, self._commit, self._folder, self._timeout)

    def _new(self, key: str) -> Row | None:
        """Return the row of a key, unless it is the one from before this sweep."""
        row = self._store.get(key)
        return None if row == self._before.get(key) else row

    def _settle(self, key: str, row: Row | None) -> Iterator[tuple[Row, bool]]:
        """Yield the row of a job that ended; without one, try again or give it up."""
        row = row or self._new(key)
        if row is None:
            self._attempts[key] += 1
            if self._attempts[key] < MAX_ATTEMPTS:
                self._retries.append(key)
                return
            message = f"the worker process died {MAX_ATTEMPTS} times (out of memory, or a crash)"
            self._attempts[key] -= 1
            row = self._job(key).row(Outcome("crashed", message, {}, None, None, provenance.machine()))
            self._store.put(row)
        self._claims.release(key)
        yield row, True


def _turn(point: Point) -> tuple[bool, int]:
    return point.score not in MEASURES, -pixels(point)  # some measures take as long as many flows


def claims_folder(store: Path) -> Path:
    """Return the folder of a store's claims, ``NAME-spool`` beside it."""
    return store.with_name(f"{store.name}-spool")


class Claims:
    """The points that this process has under way, so that sweeps of one store share the work.

    A claim is a lock on one byte of a file, at an offset given by the key. The system frees it when the process
    ends, however it ends. Use it in a ``with`` statement; the folder, from `claims_folder`, is created.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(exist_ok=True)
            self._file = (folder / "claims").open("ab")
        except OSError as exc:
            raise InputError(f"{folder}: {exc.strerror}; make it a folder that can be written to") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def take(self, key: str) -> bool:
        """Claim a point; False if another process has it. Where there are no locks, all claims hold."""
        if fcntl is None:
            return True
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _offset(key))
        except (BlockingIOError, PermissionError):
            return False
        except OSError:  # a file system without locks
            return True
        return True

    def release(self, key: str) -> None:
        """Give a claim up."""
        if fcntl is not None:
            with suppress(OSError):
                fcntl.lockf(self._file, fcntl.LOCK_UN, 1, _offset(key))


def _offset(key: str) -> int:
    return int(key[:15], 16)  # 60 bits, as many as a file's offset can hold
