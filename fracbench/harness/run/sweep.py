"""Run the points of a plan that the store does not hold yet."""

from __future__ import annotations

import importlib.util
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sized
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, BinaryIO, Self

from fracbench.errors import InputError
from fracbench.harness.run import provenance
from fracbench.harness.run.cost import pixels
from fracbench.harness.run.grid_points import UniquePoints
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import MEASURES, Job, Outcome, Point
from fracbench.harness.run.pool import LocalPool, Pool
from fracbench.harness.run.store import Row, Store, StoredRows, Values, decode, encode, status_of
from fracbench.model import SOLVER_VERSION

#: A point whose worker dies is started this many times.
MAX_ATTEMPTS = 2

#: None on Windows, where two sweeps at once are as safe but do not share the work.
fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None

#: The key of a point, its row, and whether it was computed here.
_Stored = tuple[str, Values, bool]

#: Seconds between two looks at points that another sweep has claimed.
_LOOK_SECONDS = 0.2

#: Files for the locks of `Claims`: with 20,000 locks in one file, to take and release another took 17 ms.
_CLAIM_FILES = 128

OnRow = Callable[[Row], object]


@dataclass
class Report:
    """The rows of all points of a run by key, how many were computed and reused, and why points were computed.

    Reused are points that the store held, or that another sweep computed meanwhile. Reasons: ``new``, ``solver
    version 1 -> 2``, ``data changed``, ``failed before``. Rows are read from the store when they are asked for.
    """

    store: Path
    statuses: dict[str, str | None] = field(default_factory=dict)
    computed: int = 0
    reused: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    @cached_property
    def rows(self) -> Mapping[str, Row]:
        """The rows that there are, by key, in the order of the plan."""
        return StoredRows(self.store, self.statuses)

    @property
    def failed(self) -> list[str]:
        """Keys of the rows that are not ``done``."""
        return [key for key, status in self.statuses.items() if status not in (None, "done")]


def missing(plan: Plan, store: Store, *, rerun_failed: bool = False) -> tuple[Report, UniquePoints]:
    """Compare a plan with the store: return its rows and reasons, and the points to compute, in order."""
    if not store.readonly:
        _take_loose_rows(store)
    points = plan.unique()
    report, todo = Report(store.path, dict.fromkeys(points)), []
    report.statuses.update(store.statuses(points))
    identities = cache(store.identities)  # not read where all points are stored
    for key, status in report.statuses.items():
        if status == "done" or (status is not None and not rerun_failed):
            report.reused += 1
        else:
            todo.append(key)
            report.statuses[key] = None
            report.reasons[_reason(status, key, points, store, identities)] += 1
    return report, points.only(todo)


def count_missing(plan: Plan, store: Store, *, rerun_failed: bool = False) -> tuple[int, list[tuple[Point, int]]]:
    """Return the number of distinct points, and those to compute: one for all alike, with their number."""
    if len(plan.points) < store.size():
        stored = {key for key, status in store.statuses(plan.unique()) if status == "done" or not rerun_failed}
    else:
        stored = set(store.keys("done" if rerun_failed else None))
    total, todo = 0, []
    for point, count, keys in plan.points.groups():
        total += count
        # Without stored points no key is made.
        todo.append((point, count - len(stored.intersection(keys)) if stored else count))
    return total, [(point, count) for point, count in todo if count]


def _take_loose_rows(store: Store) -> None:
    """Store the rows that an older fracbench finished and left beside the store when it was killed."""
    for path in sorted(claims_folder(store.path).glob("*.json")):
        with suppress(ValueError, TypeError, RecursionError):  # cut short, or no row
            store.put(Row.from_json(path.read_text()))
        path.unlink(missing_ok=True)


def _reason(
    status: str | None, key: str, points: UniquePoints, store: Store, identities: Callable[[], set[str]]
) -> str:
    if status is not None:
        return f"{status} before"
    if not identities():
        return "new"
    identity = points.identity(key)
    if identity not in identities():
        return "new"
    point, latest = points[key], store.by_identity(identity)[-1]
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
    on_end: Callable[[], object] | None = None,
    compared: tuple[Report, UniquePoints] | None = None,
    pool: Pool | None = None,
) -> Report:
    """Compute the points that the store lacks; each row is stored as soon as its point is done.

    The plan's configuration says where it runs and how long a point may take; `jobs` are processes on this
    machine. `on_row` is called with each new row, `on_end` once for each: to read a row takes longer than to store
    it. `compared` is what `missing` has returned; `pool` takes the place of the plan's workers.
    """
    report, todo = compared or missing(plan, store, rerun_failed=rerun_failed)
    if not todo:
        return report
    with (
        Claims(claims_folder(store.path)) as claims,
        closing(pool or _pool(plan, jobs, store)) as workers,
        closing(_Sweep(todo, store, claims, workers, plan).rows()) as rows,
    ):
        for key, row, computed in rows:
            report.statuses[key] = status_of(row)
            report.computed += computed
            report.reused += not computed
            if on_row is not None:
                on_row(decode(row))
            if on_end is not None:
                on_end()
    return report


def compute_here(points: Mapping[str, Point], store: Store, folder: Path | None) -> dict[str, Row]:
    """Return the rows of points by key; those that the store lacks are computed in this process, one by one.

    For many short points that are known a few at a time: they cost one transaction, and no message to a worker.
    """
    from fracbench.harness.run.compute_point import run_point

    stored = store.get_many(points)
    new = {
        key: Job(key, point, 1, SOLVER_VERSION, provenance.commit(), folder).row(run_point(point, folder))
        for key, point in points.items()
        if key not in stored
    }
    if new:
        store.put_many([encode(row) for row in new.values()])
    return stored | new


def _pool(plan: Plan, jobs: int, store: Store) -> Pool:
    parallel = plan.config.parallel
    if parallel.backend == "dask":
        from fracbench.harness.run.dask import DaskPool

        return DaskPool(parallel.address, store)
    return LocalPool(jobs, store)


class _Sweep:
    """One run over missing points: those that wait, are under way, or have lost their worker."""

    def __init__(self, todo: UniquePoints, store: Store, claims: Claims, pool: Pool, plan: Plan) -> None:
        self._todo, self._store, self._claims, self._pool = todo, store, claims, pool
        self._folder = None if plan.folder is None else plan.folder.resolve()
        self._timeout, self._commit = plan.config.parallel.timeout, provenance.commit()
        self._waiting = deque(_in_turn(todo))
        self._retries: deque[str] = deque()
        self._attempts = Counter[str]()
        self._under_way: set[str] = set()
        self._claimed: list[str] = []  # by another sweep
        self._found: list[tuple[str, Values]] = []  # of another sweep
        self._before = store.get_encoded(todo)  # rows that are to be replaced

    def rows(self) -> Generator[_Stored, None, None]:
        """Yield the keys of rows that were stored, the rows, and whether they were computed here."""
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

    def _compute(self, keys: deque[str]) -> Iterator[_Stored]:
        """Compute points until there are no more or workers have died."""
        with closing(self._pool.compute(_Jobs(keys, self._jobs(keys)))) as ended:
            for key, row in ended:
                self._under_way.remove(key)
                yield from self._settle(key, row)
                while self._found:
                    yield *self._found.pop(), False
        while self._found:
            yield *self._found.pop(), False
        new = self._new(self._under_way)
        for key in self._under_way:  # not begun when workers died, or ended at the same moment
            if key in new:
                yield from self._settle(key, new[key])
            else:
                self._waiting.append(key)
        self._under_way.clear()

    def _jobs(self, keys: deque[str]) -> Iterator[Job]:
        """Claim points and yield them as jobs; note the points that other sweeps have claimed or finished."""
        while keys:
            block = [keys.popleft() for _ in range(min(self._pool.ahead, len(keys)))]
            ours = [key for key in block if self._claims.take(key)]
            if len(ours) < len(block):
                self._claimed += set(block).difference(ours)
            new = self._new(ours)
            for key in ours:
                if key in new:
                    self._claims.release(key)
                    self._found.append((key, new[key]))
                else:
                    self._under_way.add(key)
                    yield self._job(key)

    def _job(self, key: str) -> Job:
        attempt = self._attempts[key] + 1
        return Job(key, self._todo[key], attempt, SOLVER_VERSION, self._commit, self._folder, self._timeout)

    def _new(self, keys: Iterable[str]) -> dict[str, Values]:
        """Return the rows of keys, without those from before this sweep."""
        found = self._store.get_encoded(keys)
        return {key: row for key, row in found.items() if row != self._before.get(key)}

    def _settle(self, key: str, row: Values | None) -> Iterator[_Stored]:
        """Yield the row of a job that ended; without one, try again or give it up."""
        row = row or self._new([key]).get(key)
        if row is None:
            self._attempts[key] += 1
            if self._attempts[key] < MAX_ATTEMPTS:
                self._retries.append(key)
                return
            message = f"the worker process died {MAX_ATTEMPTS} times (out of memory, or a crash)"
            self._attempts[key] -= 1
            row = encode(self._job(key).row(Outcome("crashed", message, {}, None, None, provenance.machine())))
            self._store.put_many([row])
        self._claims.release(key)
        yield key, row, True


class _Jobs:
    """Jobs that are made as they are taken; about as many as there are keys."""

    def __init__(self, keys: Sized, jobs: Iterator[Job]) -> None:
        self._keys, self._jobs = keys, jobs

    def __iter__(self) -> Iterator[Job]:
        return self

    def __next__(self) -> Job:
        return next(self._jobs)

    def __length_hint__(self) -> int:
        return len(self._keys)


def _in_turn(todo: UniquePoints) -> list[str]:
    """Return the keys of points: the longest first, so that no worker is left with one of them in the end.

    The points of a pair come together, so that each worker reads or renders it once.
    """
    points = [planned.point for planned in todo.planned.frames]
    pairs = {point.data_digest: i for i, point in enumerate(points)}
    turns = [(*_turn(point), pairs[point.data_digest]) for point in points]
    place = {turn: i for i, turn in enumerate(sorted(set(turns)))}
    places = [place[turns[todo.frame_of(key)]] for key in todo]
    keys = list(todo)
    return [keys[i] for i in sorted(range(len(keys)), key=places.__getitem__)]


def _turn(point: Point) -> tuple[bool, int]:
    return point.score not in MEASURES, -pixels(point)  # some measures take as long as many flows


def claims_folder(store: Path) -> Path:
    """Return the folder of a store's claims, ``NAME-spool`` beside it."""
    return store.with_name(f"{store.name}-spool")


class Claims:
    """The points that this process has under way, so that sweeps of one store share the work.

    A claim is a lock on one byte of a file, at an offset given by the key. The system frees it when the process
    ends, however it ends. To add a lock it goes through all those of the file: there are several files, chosen by
    the key. Use it in a ``with`` statement; the folder, from `claims_folder`, is created.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[int, BinaryIO] = {}
        try:
            folder.mkdir(exist_ok=True)
        except OSError as exc:
            raise self._unusable(exc) from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files.values():
            file.close()

    def _unusable(self, exc: OSError) -> InputError:
        return InputError(f"{self._folder}: {exc.strerror}; make it a folder that can be written to")

    def _file(self, key: str) -> BinaryIO:
        number = int(key[-2:], 16) % _CLAIM_FILES
        if number not in self._files:
            try:
                self._files[number] = (self._folder / f"claims-{number}").open("ab")
            except OSError as exc:
                raise self._unusable(exc) from exc
        return self._files[number]

    def take(self, key: str) -> bool:
        """Claim a point; False if another process has it. Where there are no locks, all claims hold."""
        if fcntl is None:
            return True
        try:
            fcntl.lockf(self._file(key), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _offset(key))
        except (BlockingIOError, PermissionError):
            return False
        except OSError:  # a file system without locks
            return True
        return True

    def release(self, key: str) -> None:
        """Give a claim up."""
        if fcntl is not None:
            with suppress(OSError):
                fcntl.lockf(self._file(key), fcntl.LOCK_UN, 1, _offset(key))


def _offset(key: str) -> int:
    return int(key[:15], 16)  # 60 bits, as many as a file's offset can hold
