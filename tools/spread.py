"""Measure how far the stored numbers move although nothing has changed: the basis of the tolerances.

The tool computes a stored table under circumstances that must not matter: more threads, double precision, BLAS
kernels and compiled loops for other processors, a parameter moved by some units in its last place. Each has a
process of its own, since libraries choose their kernels when they are loaded. A table that another processor has
stored is one circumstance more.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_info, threadpool_limits

from fracbench.commands import console
from fracbench.commands.parser import Parser
from fracbench.commands.run import require_workers
from fracbench.errors import FracbenchError, InputError
from fracbench.evaluation.metrics import flow_errors
from fracbench.harness.check import regression, tolerances
from fracbench.harness.check.regression import by_label, key_columns, plan_of
from fracbench.harness.check.tolerances import MEASURED
from fracbench.harness.config.paths import asset
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.provenance import machine
from fracbench.harness.run.store import Row
from fracbench.methods.registry import get_method
from fracbench.model import SOLVER_VERSION
from fracbench.model.kernels.threads import use_threads

Results = Mapping[str, Mapping[str, Any]]
#: The cells of a table by row, then by column, as text.
Cells = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class Circumstance:
    """A property of the computer or of the arithmetic that a result must not depend on."""

    name: str
    environment: Mapping[str, str] = field(default_factory=dict)
    threads: int = 1  #: of the solver; BLAS has one
    dtype: str = ""  #: empty: the points' own
    kernel: str = ""  #: the OpenBLAS kernel that must be at work; empty: any
    nudge: float = 0.0  #: relative change of theta


_ANSWER = "--answer"  # in a process of a circumstance
#: The circumstances of `fracbench check`.
USUAL = Circumstance("usual")
CIRCUMSTANCES = (
    Circumstance("two threads", threads=2),
    Circumstance("float64", dtype="float64"),
    *(
        Circumstance(f"BLAS for {core}", {"OPENBLAS_CORETYPE": core}, kernel=core)
        for core in ("Nehalem", "Haswell", "SkylakeX")
    ),
    Circumstance("loops for a generic processor", {"NUMBA_CPU_NAME": "generic"}),
    # no other processor computes in quite this order: several draws of a rounding error everywhere
    *(Circumstance(f"theta {nudge:+.0e}", nudge=nudge) for nudge in (-2e-6, -1e-6, 1e-6, 2e-6)),
)


def measure(
    names: Sequence[str], *, jobs: int, on_done: Callable[[Any], None] | None = None
) -> dict[str, pd.DataFrame]:
    """Measure the spreads of stored tables (see `load_spreads` of ``tolerances``), `jobs` processes at a time.

    A circumstance that this machine does not offer is left out. `on_done` is called with each finished pair of
    table and circumstance.
    """
    plans = {name: require_plan(name) for name in names}
    pairs = [(name, circumstance) for name in names for circumstance in (USUAL, *CIRCUMSTANCES)]

    def work(pair: tuple[str, Circumstance]) -> Cells | None:
        results = _in_a_process(*pair)
        if on_done is not None:
            on_done(pair)
        return None if results is None else _labelled(plans[pair[0]], results)

    with ThreadPoolExecutor(jobs) as pool:
        done = list(zip(pairs, pool.map(work, pairs), strict=True))
    return {
        name: spreads(
            {one.name: table for (which, one), table in done if which == name and table is not None},
            stored_elsewhere(name),
        )
        for name in names
    }


def stored_elsewhere(name: str) -> dict[str, Cells]:
    """Return a stored table, under the name of its circumstance, if another processor has computed it."""
    entries = regression.history(name)
    if not entries or entries[-1]["solver_version"] != SOLVER_VERSION or entries[-1]["cpu"] == machine()["cpu"]:
        return {}
    table = regression.read_table(asset("results/reference") / f"{name}.csv")
    return {f"as stored from {entries[-1]['cpu']}": by_label(table, key_columns(table))}


def spreads(tables: Mapping[str, Cells], elsewhere: Mapping[str, Cells] | None = None) -> pd.DataFrame:
    """Compare a table under each circumstance with the table under the usual ones.

    Both arguments are by circumstance; tables of other processors (`elsewhere`) are left out if their rows differ.
    The result has the columns ``row``, ``column``, and the relative difference under each circumstance, infinite
    where a cell is missing or not finite.
    """
    if USUAL.name not in tables:
        raise FracbenchError("a table cannot be computed even under the usual circumstances; try fracbench check")
    usual, records = tables[USUAL.name], []
    tables = {**tables, **{name: rows for name, rows in (elsewhere or {}).items() if rows.keys() == usual.keys()}}
    for row, cells in usual.items():
        for column in MEASURED:
            others = {name: rows.get(row, {}) for name, rows in tables.items() if name != USUAL.name}
            found = {name: _relative(cells[column], other.get(column, "")) for name, other in others.items()}
            records.append({"row": row, "column": column, **found})
    return pd.DataFrame(records)


def _relative(usual: str, other: str) -> float:
    try:
        reference, difference = float(usual), abs(float(other) - float(usual))
    except ValueError:
        return math.inf
    if difference == 0.0:
        return 0.0
    relative = difference / abs(reference) if math.isfinite(difference) and reference else math.inf
    return float(f"{relative:.3g}")  # as it is written, so that the tolerances follow from the file


def summary(name: str, table: pd.DataFrame) -> list[dict[str, str]]:
    """Return the largest spread of each column per circumstance, as text."""
    worst = table.drop(columns="row").groupby("column", sort=False).max()
    return [
        {"table": name, "under": under, **{column: f"{worst.loc[column, under]:.1e}" for column in MEASURED}}
        for under in worst.columns
    ]


def require_plan(name: str) -> Plan:
    """Return the plan behind a stored table; refuse a table whose data cannot be had."""
    plan = plan_of(name)
    if plan is None:
        raise InputError(f"{name}: the Middlebury data cannot be had here; name the tables to be measured")
    return plan


def _labelled(plan: Plan, results: Results) -> Cells:
    """Return the cells of a table under the labels that `fracbench check` gives its rows."""
    rows = {
        key: Row(
            key=key,
            identity=point.identity,
            spec=point.spec,
            solver_version=SOLVER_VERSION,
            status="done",
            result=results[key],
        )
        for key, point in plan.unique().items()
    }
    table = regression.reference_table(plan, rows)
    return by_label(table, key_columns(table))


def _in_a_process(name: str, circumstance: Circumstance) -> Results | None:
    """Return the results of a table's points by key, or None where the circumstance cannot be had."""
    limits = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    words = [_ANSWER, name, str(circumstance.threads), circumstance.dtype, str(circumstance.nudge)]
    command = [sys.executable, str(Path(__file__).resolve()), *words]
    environment = {**os.environ, **limits, **circumstance.environment}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode != 0:  # kernels for a processor that this one is not end the process
        return None
    answer: dict[str, Any] = json.loads(done.stdout)
    if circumstance.kernel and circumstance.kernel not in answer["kernels"]:
        return None
    return answer["results"]


def results_of(plan: Plan, threads: int, dtype: str, nudge: float = 0.0) -> dict[str, dict[str, Any]]:
    """Compute the points of a plan in this process, as a `Circumstance` says; return errors and counts by key."""
    found = {}
    with use_threads(threads), threadpool_limits(1):  # as `estimate_flow` does
        for key, point in plan.unique().items():
            frame0, frame1, truth, inner = point_arrays(point, plan.folder)
            params = point.params.replace({"dtype": dtype} if dtype else {})
            params = params.replace({"theta": params.theta * (1.0 + nudge)})
            flow = get_method(point.method).estimate(frame0, frame1, params).flow
            errors = flow_errors(flow[(slice(None), *inner)], truth[(slice(None), *inner)])
            found[key] = asdict(errors)
    return found


def _answer(name: str, threads: str, dtype: str, nudge: str) -> None:
    """Print the results of a stored table under the circumstances of this process."""
    results = results_of(require_plan(name), int(threads), dtype, float(nudge))
    print(json.dumps({"kernels": [pool.get("architecture") for pool in threadpool_info()], "results": results}))


def report(arguments: argparse.Namespace) -> None:
    """Measure stored tables and print their spreads; with ``--update``, write them and the tolerances."""
    require_workers(arguments.jobs)
    if arguments.update:
        regression.require_checkout()
    names = regression.wanted_tables(arguments.names)
    if not arguments.names:
        names = [name for name in names if plan_of(name)]
    with console.progress(len(names) * (len(CIRCUMSTANCES) + 1), "spread") as advance:
        measured = measure(names, jobs=arguments.jobs, on_done=advance)
    records = [record for name, table in measured.items() for record in summary(name, table)]
    console.show_table(pd.DataFrame(records), "largest relative differences")
    for path in tolerances.write(measured, regression.origin()) if arguments.update else ():
        console.say(f"wrote {path}")


def main(argv: list[str]) -> int:
    """Run the tool and return its exit code: 0 done, 2 bad input."""
    if argv[:1] == [_ANSWER]:
        _answer(*argv[1:])
        return 0
    parser = Parser(description=__doc__)
    parser.set_defaults(parser=parser)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="stored tables (default: all whose data are at hand)"
    )
    parser.add_argument("--update", action="store_true", help="write the spreads and the tolerances")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes at a time (default: 2)")
    try:
        report(parser.parse_words(argv))
    except FracbenchError as exc:
        console.complain(str(exc))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
