"""The convergence study on a small problem, and its table on made-up courses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run.plan import plan_artefact
from fracbench.model.params import FlowParams
from fracbench.studies.registry import render
from fracbench.studies.solvers.convergence_study import summarise
from fracbench.studies.solvers.linearised_problem import (
    DEFAULT,
    LITERAL,
    SOLVERS,
    course,
    courses,
    energy_at,
    linearised_problem,
    minimum,
)


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(4)
    frame0 = rng.uniform(0, 255, (24, 28))
    frame1 = np.roll(frame0, 1, axis=1)
    at = np.zeros((2, 24, 28))
    return linearised_problem(frame0, frame1, at, FlowParams(alpha=1.2, boundary="zero", lambda_sb=2.0))


def test_every_exact_and_gauss_seidel_solver_finds_one_minimum(problem):
    """The reference comes from the default alone; the paper's own alternation must agree with it."""
    least = minimum(problem, 800)
    for name in ("exact, warm", "exact, warm, multiplier", "Gauss-Seidel, warm", DEFAULT):
        solver = {**SOLVERS[name], "dtype": "float64"}
        records = course(problem, solver, least, gap=1e-7, seconds=60, iterations=3000)
        assert -1e-9 < records[-1][3] <= 1e-7, name


def test_a_course_counts_and_stops(problem):
    least = minimum(problem, 300)
    records = course(problem, SOLVERS[DEFAULT], least, gap=1e-3, seconds=60, iterations=200)
    iterations, u_steps, seconds, gaps = zip(*records, strict=True)
    assert iterations == tuple(range(len(records))) and u_steps == tuple(2 * i for i in iterations)
    assert list(seconds) == sorted(seconds) and gaps[-1] <= 1e-3 < min(gaps[:-1])
    assert gaps[0] == pytest.approx(energy_at(problem, problem.start) / least - 1.0)
    assert len(course(problem, SOLVERS[DEFAULT], least, gap=0.0, seconds=60, iterations=3)) == 4
    assert len(course(problem, SOLVERS[DEFAULT], least, gap=0.0, seconds=0.0, iterations=3)) == 1


def test_the_default_is_what_a_user_gets_and_needs_the_fewest_iterations(problem):
    assert SOLVERS[DEFAULT] == {}
    least = minimum(problem, 800)
    counts = {
        name: course(problem, SOLVERS[name], least, gap=1e-3, seconds=60, iterations=400)[-1][0]
        for name in ("Gauss-Seidel, warm", "exact, warm", "exact, warm, multiplier", DEFAULT)
    }
    assert min(counts, key=counts.__getitem__) == DEFAULT


def test_the_table_compares_at_the_gap_that_was_reached():
    slow = next(iter(LITERAL))
    rows = [(1.0, slow, i, 10 * i, 2.0 * i, gap) for i, gap in enumerate((1.0, 0.1, 0.02))]
    rows += [(1.0, DEFAULT, i, 2 * i, 0.5 * i, gap) for i, gap in enumerate((1.0, 0.015, 1e-4))]
    columns = ["alpha", "solver", "iteration", "u_steps", "seconds", "gap"]
    table = summarise(pd.DataFrame(rows, columns=columns), 1e-3, {1.0: 3.0}).set_index("solver")
    assert table.loc[DEFAULT, ["gap", "iterations", "seconds", "ratio"]].tolist() == [1e-3, 2, 1.0, 1.0]
    # the slow one came to 0.02 after 4 s and 20 u-steps, where the default was after 0.5 s
    assert table.loc[slow, ["gap", "iterations", "u-steps", "seconds", "ratio"]].tolist() == [
        0.0202,
        2,
        20,
        4.0,
        8.0,
    ]
    assert table.loc[LITERAL[slow], ["seconds", "ratio"]].tolist() == [64.0, 128.0]


def test_the_experiment_writes_its_artefact(tmp_path, fake_rows):
    experiment = load_experiment("convergence")
    few = {"alphas": [1.2], "seconds": 2, "iterations": 3, "reference_iterations": 20}
    experiment = replace(experiment, options={**experiment.options, **few})
    plan = plan_artefact(experiment, ("dataset=synthetic", f"paths.results='{tmp_path}'"))
    (planned,) = plan.points
    result = courses(planned.point, plan.folder)
    made = render(experiment, plan, fake_rows(plan, result=result), tmp_path)
    assert {path.suffix for path in made.files} == {".csv", ".md", ".png", ".pdf"}
    assert all(path.parent == tmp_path / "runs" / "convergence" for path in made.files)
    table = pd.read_csv(made.files[0])
    assert set(table["solver"]) == set(SOLVERS) and (table["iteration"] <= 3).all()
    failed = render(experiment, plan, fake_rows(plan, status="failed"), tmp_path)
    assert not failed.files and failed.lines == ["No point is done: there is nothing to draw."]
