"""Measure what elimination along the longer axis gives in the u-step under `zero`, beside products of matrices."""

from __future__ import annotations

import argparse
import sys
import time
from statistics import median
from typing import Any
from unittest import mock

import common
from threadpoolctl import threadpool_limits

from fracbench.commands.bench import results_stem, write_results
from fracbench.harness.run.compute_point import run_point
from fracbench.harness.run.plan import make_plan
from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.pointwise import divide_by_sum
from fracbench.model.operators import zero
from fracbench.model.operators.base import GradientOperator, System
from fracbench.model.operators.zero import ZeroGradient

SWEEP = ("region=grove2_A", "alpha=0:2:0.1")
_solve = ZeroGradient.solve


def solve_by_products(
    self: ZeroGradient, v: Array, w: Array, theta: float, mu: float, system: System, u: Array
) -> None:
    """Take the u-step in eigenbases along both axes, by four products of matrices, where lines are long."""
    if self._lines is None:
        _solve(self, v, w, theta, mu, system, u)
        return
    (_, qy, qy_back), (_, qx, qx_back) = self._basis(0), self._basis(1)
    y = w[0, 0]
    self._adjoints(w, u, y)
    zero._weigh_right_hand_side(v, theta, mu, y, u)
    zero._product(qy_back, u, y)
    zero._product(y, qx, u)
    divide_by_sum(u, *system)
    zero._product(qy, u, y)
    zero._product(y, qx_back, u)
    self.differentiate(u, w)


#: The two ways, by the methods of `ZeroGradient` that they replace.
WAYS: dict[str, dict[str, Any]] = {
    "elimination": {"solve": _solve, "factor": ZeroGradient.factor},
    "products": {"solve": solve_by_products, "factor": GradientOperator.factor},
}


def measure(arguments: argparse.Namespace) -> None:
    """Run each point with elimination and with products in turns; print and write the CPU seconds of both."""
    tokens = arguments.overrides or SWEEP
    plan = make_plan(tokens)
    rows: list[dict[str, Any]] = []
    for planned in plan.points:
        took: dict[str, list[float]] = {name: [] for name in WAYS}
        for _ in range(arguments.repeats + 1):
            for name, methods in WAYS.items():
                with mock.patch.multiple(ZeroGradient, **methods):
                    started = time.process_time()
                    run_point(planned.point, plan.folder)
                    took[name].append(time.process_time() - started)
        rows.append(
            {"alpha": planned.point.params.alpha, **{name: median(times[1:]) for name, times in took.items()}}
        )
    on, off = (sum(row[name] for row in rows) for name in ("elimination", "products"))
    rows.append({"alpha": "all", "elimination": on, "products": off})
    write_results(rows, results_stem(tokens, "elimination"), f"elimination saves {1 - on / off:.1%}")


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    with threadpool_limits(1):
        return common.run(measure, common.parser(__doc__, default=" ".join(SWEEP)), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
