"""Measures are points: planned with their artefact, counted, stored, resumed, and rows also where they fail."""

from __future__ import annotations

import dataclasses
import pkgutil
from types import SimpleNamespace

import pytest

from fracbench.commands.cli import main
from fracbench.errors import FracbenchError, InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run import compute_point, dask, point, sweep
from fracbench.harness.run.grid_points import PlannedPoints
from fracbench.harness.run.plan import make_plan, plan_artefact
from fracbench.harness.run.store import STORE, Store
from fracbench.harness.run.tidy import tidy
from fracbench.studies.registry import render
from fracbench.studies.solvers.spectral_radius import spectrum

SCENES = ["dataset=synthetic"]
#: One cheap flow and three spectra.
SMALL = """
title: small
artefact: solver_study
grid: [region=grove2_A, u_solver=exact, n_scales=1, n_warps=1, max_iter=1, alpha=1]
options: {size: 6, alpha_step: 1, tol: 1.0e-3, limit: 20}
"""


@pytest.fixture
def small(work):
    """The working folder with an experiment of one flow and three spectra."""
    (work / "experiments").mkdir()
    (work / "experiments/small.yaml").write_text(SMALL)
    return load_experiment("small")


@pytest.fixture
def store(work):
    (work / STORE.parent).mkdir(parents=True, exist_ok=True)
    with Store(work / STORE) as opened:
        yield opened


def counts(capsys):
    assert main(["experiment", "small", *SCENES, "--dry-run"]) == 0
    return capsys.readouterr().out.partition(" on ")[0]


def test_they_are_counted_run_once_and_read_from_the_store(small, store, capsys, unwritten, monkeypatch):
    assert counts(capsys) == "4 points, 0 stored, 4 to compute"
    assert main(["status", "small", *SCENES]) == 0
    assert " 4 " in capsys.readouterr().out
    assert main(["experiment", "small", *SCENES, "--jobs", "1"]) == 0
    capsys.readouterr()
    assert counts(capsys) == "4 points, 4 stored, 0 to compute"
    monkeypatch.setattr(sweep, "_pool", lambda *_: pytest.fail("computed"))
    assert main(["experiment", "small", *SCENES, "--jobs", "1"]) == 0


def test_a_stored_value_is_that_of_the_direct_call(small, store):
    plan = plan_artefact(small, SCENES)
    report = sweep.run(plan, store, jobs=1)
    measured = [each.point for each in plan.points if each.point.score == "spectrum"]
    assert [each.params.alpha for each in measured] == [0.0, 1.0, 2.0]
    for each in measured:
        row = report.rows[each.key]
        assert row.result == spectrum(each, None) and row.seconds is not None
        assert row.spec["options"] == {"tol": "0.001", "limit": "20"} and row.spec["box"] == [0, 6, 0, 6]
    assert len(tidy(plan, report.rows)) == 1  # the flow


def test_what_was_finished_before_an_interrupt_is_kept(small, store):
    plan = plan_artefact(small, SCENES)

    def interrupt(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep.run(plan, store, jobs=1, on_row=interrupt)
    kept = len(store.rows("done"))
    assert 1 <= kept < 4
    assert sweep.run(plan, store, jobs=1).computed == 4 - kept


def test_a_measure_that_fails_is_a_row_and_an_empty_cell(small, store, unwritten):
    small = dataclasses.replace(small, options={**small.options, "alpha_step": 2.0})
    plan = plan_artefact(small, SCENES)
    broken = tuple(
        dataclasses.replace(
            each,
            point=dataclasses.replace(each.point, options=(("tol", 1e-3), ("limits", 1)))
            if each.point.params.alpha == 2.0
            else each.point,
        )
        for each in plan.points
    )
    plan = dataclasses.replace(plan, points=PlannedPoints(broken))
    report = sweep.run(plan, store, jobs=1)
    (failed,) = map(report.rows.__getitem__, report.failed)
    assert failed.status == "failed" and "unexpected keyword argument 'limits'" in failed.error
    made = render(small, plan, report.rows, plan.config.results)
    text = next(path for path in made.files if path.suffix == ".md").read_text(encoding="utf-8")
    assert "0.000 (1) / 0.000 (1)" in text and "nan" not in text


def test_a_refusal_of_a_measure_is_the_text_of_its_row(monkeypatch):
    (planned,) = make_plan(["sequence=synthetic_edge", "method=tvl1_sb_alpha", "n_scales=1"]).points
    monkeypatch.setitem(point.MEASURES, "oracle", "fracbench.studies.alpha_map.oracle:_refuse")

    def refuse(given, folder):
        raise FracbenchError("not today")

    monkeypatch.setattr("fracbench.studies.alpha_map.oracle._refuse", refuse, raising=False)
    outcome = compute_point.run_point(dataclasses.replace(planned.point, score="oracle"), None)
    assert (outcome.status, outcome.error) == ("failed", "not today")


def test_a_spectrum_needs_no_data_on_a_cluster(small):
    measured = [each.point for each in plan_artefact(small, SCENES).points if each.point.score == "spectrum"]
    assert dask._files(SimpleNamespace(point=measured[0], folder=None)) == {}


@pytest.mark.parametrize("step", [0, -1])
def test_a_step_that_leads_nowhere_is_refused(small, step):
    broken = dataclasses.replace(small, options={**small.options, "alpha_step": step})
    with pytest.raises(InputError, match="experiment small: option 'alpha_step' must be above 0"):
        plan_artefact(broken, SCENES)


def test_every_measure_has_a_place():
    assert all(callable(pkgutil.resolve_name(home)) for home in point.MEASURES.values())


@pytest.mark.parametrize(
    ("name", "score", "n"),
    [
        ("solver_study", "spectrum", 126),
        ("convergence", "convergence", 4),
        ("adaptive_alpha", "oracle", 8),
        ("sparsification", "confidence", 24),
    ],
)
def test_the_projects_experiments_plan_theirs(name, score, n):
    plan = plan_artefact(load_experiment(name), SCENES, allow_download=False)
    assert sum(each.point.score == score for each in plan.points) == n
