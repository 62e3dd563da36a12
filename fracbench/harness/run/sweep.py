"""Run the points of a plan that the store does not hold yet."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from fracbench.errors import InputError
from fracbench.harness.run import provenance, spool
from fracbench.harness.run.cost import pixels
from fracbench.harness.run.message import Job, Outcome
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.pool import Crew, LocalCrew
from fracbench.harness.run.store import Row, Store
from fracbench.model import SOLVER_VERSION

#: So often a point is started whose worker dies.
MAX_ATTEMPTS = 2

#: How long to wait for a sign of life before looking around, seconds.
_LOOK_SECONDS = 0.2

OnRow = Callable[[Row], None]


@dataclass
class Report:
    """What a run did.

    Attributes
    ----------
    rows : dict of str to Row
        The rows of all points, by key; stored ones included.
    computed : int
        Points computed now.
    reused : int
        Points the store held, or that another sweep computed meanwhile.
    reasons : Counter
        Why points were computed: ``new``, ``solver version 1 -> 2``, ``data changed``, ``failed before``.
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
    """Compare a plan with the store, after storing what earlier runs finished and did not live to store.

    Parameters
    ----------
    plan : Plan
        What is wanted.
    store : Store
        What there is.
    rerun_failed : bool, optional
        Count points that failed as missing.

    Returns
    -------
    report : Report
        With the stored rows and the reasons for the missing ones.
    todo : dict of str to Point
        What has to be computed, in the order of the plan.
    """
    if not store.readonly:
        spool.harvest(store)
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


def _reason(row: Row | None, point: Point, store: Store) -> str:
    if row is not None:
        return f"{row.status} before"
    older = store.by_identity(point.identity)
    if not older:
        return "new"
    latest = older[-1]
    if latest.solver_version != SOLVER_VERSION:
        return f"solver version {latest.solver_version} -> {SOLVER_VERSION}"
    return "data changed"


def run(
    plan: Plan,
    store: Store,
    *,
    jobs: int,
    rerun_failed: bool = False,
    on_start: Callable[[Report, int], None] | None = None,
    on_row: OnRow | None = None,
) -> Report:
    """Compute what is missing and store each row as soon as it is there.

    Parameters
    ----------
    plan : Plan
        What is wanted; its configuration says where it runs and how long a point may take.
    store : Store
        Written by this process alone, one transaction a point.
    jobs : int
        Worker processes on this machine.
    rerun_failed : bool, optional
        Compute points again that failed before.
    on_start : callable, optional
        Called with the report and the number of points to compute.
    on_row : callable, optional
        Called with each new row.

    Returns
    -------
    Report
        With the rows of all points of the plan.

    Raises
    ------
    FracbenchError
        The store or its spool cannot be written, or workers do not come up.
    """
    report, todo = missing(plan, store, rerun_failed=rerun_failed)
    if on_start is not None:
        on_start(report, len(todo))
    if not todo:
        return report
    folder = spool.folder_of(store.path)
    with _claims(folder) as claims, closing(_crew(plan, jobs, folder)) as crew:
        for row, computed in _Sweep(todo, store, claims, crew, plan).rows():
            report.rows[row.key] = row
            report.computed += computed
            report.reused += not computed
            if on_row is not None:
                on_row(row)
    return report


def _claims(folder: Path) -> spool.Claims:
    try:
        return spool.Claims(folder)
    except OSError as exc:
        raise InputError(f"{folder}: {exc.strerror}; make it a folder that can be written to") from exc


def _crew(plan: Plan, jobs: int, folder: Path) -> Crew:
    parallel = plan.config.parallel
    if parallel.backend == "dask":
        from fracbench.harness.run.dask import DaskCrew

        return DaskCrew(parallel.address)
    return LocalCrew(jobs, folder)


class _Sweep:
    """One run over missing points: what waits, what is under way, what lost its worker."""

    def __init__(
        self,
        todo: Mapping[str, Point],
        store: Store,
        claims: spool.Claims,
        crew: Crew,
        plan: Plan,
    ) -> None:
        self._todo, self._store, self._claims, self._crew = todo, store, claims, crew
        self._spool = spool.folder_of(store.path)
        self._folder = None if plan.folder is None else plan.folder.resolve()
        self._timeout, self._commit = plan.config.parallel.timeout, provenance.commit()
        # The longest go first, so that no worker is left with one of them in the end.
        self._waiting = deque(sorted(todo, key=lambda key: -pixels(todo[key].spec)))
        self._retries: deque[str] = deque()
        self._attempts = Counter[str]()
        self._under_way: set[str] = set()
        self._before = store.get_many(todo)  # rows that are to be replaced

    def rows(self) -> Iterator[tuple[Row, bool]]:
        """Yield stored rows, and whether they were computed here."""
        while self._waiting or self._retries or self._under_way:
            yield from self._start()
            ended = self._crew.wait(_LOOK_SECONDS)
            self._under_way.difference_update(key for key, _ in ended)
            yield from self._start()  # before storing, so that no worker waits for the disk
            for key, row in ended:
                stored = self._settle(key, row)
                if stored is not None:
                    yield stored

    def _start(self) -> Iterator[tuple[Row, bool]]:
        """Give work to all that are free; yield what another sweep has finished instead."""
        for _ in range(len(self._waiting)):
            if not self._crew.free():
                return
            key = self._waiting.popleft()
            if not self._claims.take(key):
                self._waiting.append(key)
            elif (row := self._found(key)) is not None:
                self._claims.release(key)
                yield row, False
            else:
                self._give(key)
        while self._retries and self._crew.free():
            if self._crew.retry_alone and self._under_way:
                return
            self._give(self._retries.popleft())

    def _give(self, key: str) -> None:
        self._under_way.add(key)
        self._crew.start(self._job(key))

    def _job(self, key: str) -> Job:
        attempt = self._attempts[key] + 1
        return Job(key, self._todo[key], attempt, SOLVER_VERSION, self._commit, self._folder, self._timeout)

    def _found(self, key: str) -> Row | None:
        row = self._store.get(key)
        return None if row == self._before.get(key) else row

    def _settle(self, key: str, row: Row | None) -> tuple[Row, bool] | None:
        """Store the row of a job that ended; without one, try again or give it up."""
        if row is None and (row := self._found(key)) is None:
            if self._attempts[key] + 1 < MAX_ATTEMPTS:
                self._attempts[key] += 1
                self._retries.append(key)
                return None
            message = f"the worker process died {MAX_ATTEMPTS} times (out of memory, or a crash)"
            row = self._job(key).row(Outcome("crashed", message, {}, None, None, provenance.machine()))
        self._store.put(row)
        spool.remove(self._spool, key)
        self._claims.release(key)
        return row, True
