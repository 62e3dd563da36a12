"""Run the points of a plan that the store does not hold yet."""

from __future__ import annotations

import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fracbench.errors import FracbenchError
from fracbench.harness import provenance
from fracbench.harness.plan import Plan, Point
from fracbench.harness.store import Row, Store
from fracbench.model import SOLVER_VERSION

#: A point whose worker died is tried again so often, alone in a fresh process.
MAX_ATTEMPTS = 2

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
        Points the store held.
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
    """Compare a plan with the store.

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
        What is wanted.
    store : Store
        Written by this process alone, one transaction a point.
    jobs : int
        Worker processes.
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
    """
    report, todo = missing(plan, store, rerun_failed=rerun_failed)
    if on_start is not None:
        on_start(report, len(todo))
    commit = provenance.commit()
    with closing(outcomes(todo, plan.folder, jobs)) as results:
        for key, outcome, attempts in results:
            row = _row(key, todo[key], outcome, attempts, commit)
            store.put(row)
            report.rows[key] = row
            report.computed += 1
            if on_row is not None:
                on_row(row)
    return report


def _row(key: str, point: Point, outcome: Any, attempts: int, commit: Mapping[str, Any]) -> Row:
    return Row(
        key=key,
        identity=point.identity,
        spec=point.spec,
        solver_version=SOLVER_VERSION,
        status=outcome.status,
        error=outcome.error,
        result=outcome.result,
        seconds=outcome.seconds,
        peak_mib=outcome.peak_mib,
        provenance={**outcome.machine, "threads": 1, **commit, "data": point.data_digest},
        attempts=attempts,
    )


def outcomes(
    todo: Mapping[str, Point], folder: Path | None, jobs: int
) -> Generator[tuple[str, Any, int], None, None]:
    """Compute points in worker processes, in any order; a worker's death costs no other point.

    Parameters
    ----------
    todo : mapping of str to Point
        By key.
    folder : Path or None
        Where the Middlebury data are.
    jobs : int
        Worker processes.

    Yields
    ------
    key : str
        The point's key.
    outcome : fracbench.harness.task.Outcome
        How it ended.
    attempts : int
        How often it was started.

    Raises
    ------
    FracbenchError
        Workers die, again and again, before they have begun with a point.
    """
    if not todo:
        return
    from fracbench.harness.task import Outcome

    pending, attempts, deaths_at_rest = dict(todo), Counter[str](), 0
    with tempfile.TemporaryDirectory(prefix="fracbench-") as name:
        started = Path(name)
        while pending:
            # Those that were under way when a worker died run alone: a second death then tells whose it was.
            suspects = [key for key in pending if attempts[key]]
            batch = {suspects[0]: pending[suspects[0]]} if suspects else pending
            before = len(pending)
            with closing(_until_death(batch, folder, 1 if suspects else jobs, started)) as results:
                for key, outcome in results:
                    del pending[key]
                    yield key, outcome, attempts[key] + 1
            under_way = [key for key in pending if (started / key).exists()]
            deaths_at_rest = 0 if under_way or len(pending) < before else deaths_at_rest + 1
            if deaths_at_rest == MAX_ATTEMPTS:
                raise FracbenchError("worker processes die before they begin with a point (out of memory?)")
            for key in under_way:
                (started / key).unlink()
                attempts[key] += 1
                if attempts[key] == MAX_ATTEMPTS:
                    del pending[key]
                    message = f"the worker process died {MAX_ATTEMPTS} times (out of memory, or a crash)"
                    yield key, Outcome("crashed", message, {}, None, None, provenance.machine()), MAX_ATTEMPTS


def _until_death(
    batch: Mapping[str, Point], folder: Path | None, jobs: int, started: Path
) -> Generator[tuple[str, Any], None, None]:
    """Yield outcomes until the batch is through or a worker dies."""
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with parallel_config(backend="loky", inner_max_num_threads=1):
        # With n_jobs=1 joblib computes in this process, which a crash would take along: there are two
        # workers at least, and pre_dispatch says how many of them have work at a time.
        workers = max(2, min(jobs, len(batch)))
        pool = Parallel(workers, return_as="generator_unordered", pre_dispatch=jobs, batch_size=1)
        results = pool(delayed(_marked)(key, point, folder, started) for key, point in list(batch.items()))
        try:
            for key, outcome in results:
                (started / key).unlink()
                yield key, outcome
        except TerminatedWorkerError:
            return
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that points under way are given up: the caller has said why
                results.close()


def _marked(key: str, point: Point, folder: Path | None, started: Path) -> tuple[str, Any]:
    """Leave a mark while the point is under way, so that the parent knows whom a death concerns."""
    (started / key).touch()
    from fracbench.harness.task import run_point

    return key, run_point(point, folder)
