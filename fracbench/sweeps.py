"""The Python interface for sweeps: `sweep`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fracbench.errors import InputError
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import STORE, Store
from fracbench.harness.run.sweep import run
from fracbench.harness.run.tidy import tidy
from fracbench.methods.registry import get_method
from fracbench.methods.warmup import variant, warm_up

if TYPE_CHECKING:
    import pandas as pd


def sweep(*overrides: str, jobs: int | None = None, rerun_failed: bool = False) -> pd.DataFrame:
    """Compute all points of a grid of parameters, as ``fracbench sweep`` does, and return their table.

    Finished points are kept in ``results/runs/store.sqlite`` below the working folder (``paths.results=FOLDER``
    chooses another one), so that the same call computes nothing the second time and resumes after an interruption.

    Parameters
    ----------
    *overrides : str
        Keys with their grids, as on the command line: ``"alpha=0:2:0.1"``, ``"region=grove2_A"``.
    jobs : int, optional
        Worker processes on this machine; by default the number in the configuration, 2.
    rerun_failed : bool, optional
        Compute points that failed before once more.

    Returns
    -------
    DataFrame
        One row a point: labels, parameters, the errors ``aae`` and ``sdae`` (radians) and ``aepe`` (pixels),
        counts of pixels and iterations, ``status`` and ``error``. A point that fails is a row.
        ``attrs["notices"]`` lists notices, e.g. that rendered scenes stand in for missing data.

    Raises
    ------
    InputError
        An unknown key or name, a malformed grid, a value outside its range, fewer than one process.

    Examples
    --------
    >>> from fracbench import sweep
    >>> table = sweep("alpha=1,1.2", "sequence=synthetic_flat", "boundary=reflect", jobs=1)
    >>> table[["alpha", "aepe", "status"]].round(3)
       alpha   aepe status
    0    1.0  0.029   done
    1    1.2  0.010   done
    """
    plan = make_plan(overrides)
    workers = plan.config.parallel.jobs if jobs is None else jobs
    if workers < 1:
        raise InputError(f"`jobs` must be at least 1, got {jobs}")
    with Store(plan.config.results / STORE) as store:
        if plan.config.parallel.backend != "dask":
            settings = {variant(p.point.method, p.point.params): p.point for p in plan.points}
            for point in settings.values():  # worker processes would compile the same at once
                warm_up(get_method(point.method), point.params)
        report = run(plan, store, jobs=workers, rerun_failed=rerun_failed)
    table = tidy(plan, report.rows)
    table.attrs["notices"] = list(plan.notices)
    return table
