"""The whole paper in one command, on experiments that are small enough for a test."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from fracbench.commands import paper as reproduce
from fracbench.data.files import write_image
from fracbench.harness.run import sweep
from fracbench.harness.run.point import Outcome
from fracbench.harness.run.store import encode
from fracbench.report.page import beyond, html

TINY = "n_scales=1, n_warps=1, max_iter=1, sequence=synthetic_flat"


@pytest.fixture
def paper(work, monkeypatch):
    """A paper of three experiments: the second needs a point of the first, and the third does not exist yet."""
    folder = work / "experiments"
    folder.mkdir()
    (folder / "one.yaml").write_text(f"grid: [{TINY}, 'alpha=0,1,1.5,2']\n")
    (folder / "two.yaml").write_text(f"grids:\n  a: [{TINY}, 'alpha=1']\n  b: [{TINY}, 'theta=0.1,0.2']\n")
    monkeypatch.setattr(reproduce, "PAPER", ("one", "none", "two"))
    monkeypatch.setattr(html, "write_report", lambda sources: sources.results / "page.html")
    return work


def test_what_is_missing_is_computed_once_and_said_in_a_line_each(paper, cli):
    done = cli("report", "dataset=synthetic", "paths.results=out")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines[:3] == [
        "6 points, 6 computed",
        "one: 4 points, wrote 3 files in out/sweeps",
        "two: 3 points, wrote 3 files in out/sweeps",
    ]
    assert lines[-1] == "wrote out/page.html"
    assert {"wrote out/tables/claims_synthetic.csv", "wrote out/tables/answer_synthetic.md"} < set(lines)
    assert (paper / "out/sweeps/one.csv").is_file()
    again = cli("report", "dataset=synthetic", "paths.results=out")
    assert again.out.splitlines() == ["6 points, 0 computed", *lines[1:]]


def test_a_small_paper_is_thinned_and_overwrites_nothing(paper, cli):
    done = cli("report", "--small", "--jobs", "1", "dataset=synthetic")
    assert done.out.startswith("6 points, 6 computed\none: 3 points, wrote")
    assert (paper / "results/sweeps/one_small.csv").is_file()
    assert not (paper / "results/sweeps/one.csv").exists()
    single = cli("experiment", "one", "--small", "--dry-run", "dataset=synthetic")
    assert single.out.startswith("3 points, 3 stored")


def test_points_that_fail_are_told_and_the_rest_goes_on(paper, cli, monkeypatch):
    class Failing:
        """A pool whose points all fail."""

        retry_alone = False
        ahead = 1

        def __init__(self, store):
            self.store = store

        def compute(self, jobs):
            for job in jobs:
                row = job.row(Outcome("failed", "made up", {}, None, None, {}))
                self.store.put(row)
                yield job.key, encode(row)

        def close(self):
            pass

    monkeypatch.setattr(sweep, "_pool", lambda plan, jobs, store: Failing(store))
    done = cli("report", "dataset=synthetic")
    assert done.code == 3
    assert "two: 3 points, wrote" in done.out and "wrote results/page.html" in done.out
    assert "6 of 6 points are not done (first: made up)" in done.err


def test_a_process_that_dies_while_it_draws_is_one_line(paper, cli, monkeypatch):
    def draw(experiment, plan, folder):
        import os

        os._exit(9)

    monkeypatch.setattr(reproduce, "_draw", draw)
    done = cli("report", "dataset=synthetic")
    assert done.code != 0 and done.out == "6 points, 6 computed\n"
    assert "a worker process died (out of memory, or a crash); all points are stored" in done.err
    assert "Traceback" not in done.err


def test_data_that_cannot_be_had_are_looked_for_once(paper, cli, no_middlebury, monkeypatch):
    asked = []

    def noting(plan):
        return lambda *a, **k: asked.append(list(a[1])) or plan(*a, **k)

    for name in ("plan_experiment", "plan_artefact"):
        monkeypatch.setattr(reproduce, name, noting(getattr(reproduce, name)))
    done = cli("report", "--dry-run", "paths.results=out")
    assert asked == [["paths.results=out"], *[["paths.results=out", "dataset=synthetic"]] * 2]
    assert done.out.startswith("6 points, 0 stored, 6 to compute")
    assert done.err.count("using the synthetic scenes in place of Middlebury") == 1


def test_beyond_the_paper_its_own_experiments_are_run_and_no_claim_is_judged(paper, cli, monkeypatch):
    monkeypatch.setattr(beyond, "EXPERIMENTS", ("two", "unwritten"))
    done = cli("report", "--beyond", "dataset=synthetic", "paths.results=out")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines == ["3 points, 3 computed", "two: 3 points, wrote 3 files in out/sweeps", "wrote out/page.html"]
    assert not (paper / "out/tables").exists()


def test_chosen_experiments_run_on_the_pairs_of_another_dataset(paper, cli):
    for name in ("a", "b"):
        (paper / "pairs" / name).mkdir(parents=True)
        for k in range(2):
            write_image(paper / "pairs" / name / f"frame{k}.png", np.eye(24, dtype=np.uint8) * 255)
    done = cli("report", "--only", "two", "dataset=folder", "paths.data=pairs", "paths.results=out")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines == ["6 points, 6 computed", "two: 6 points, wrote 3 files in out/sweeps", "wrote out/page.html"]
    assert len(list((paper / "out/sweeps").glob("two__folder*"))) == 3
    assert not (paper / "out/tables").exists()  # no claim is judged


def test_the_experiments_beyond_the_paper_are_not_the_papers():
    assert not set(beyond.EXPERIMENTS) & set(reproduce.PAPER)
    told = {"alpha_by_structure", "adaptive_alpha", "order_from_flow"}
    assert told <= set(beyond.EXPERIMENTS) & set(reproduce.list_experiments())


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["report", "alpha=1"], "report: an experiment fixes its own grid"),
        (["report", "--jobs", "0", "dataset=synthetic"], "--jobs must be at least 1, got 0"),
        (["report", "--smoll"], "unexpected argument '--smoll': did you mean --small?"),
        (["report", "--smal"], "unexpected argument '--smal': did you mean --small?"),
        (["report", "--job", "2"], "unexpected argument '--job': did you mean --jobs?"),
    ],
)
def test_mistakes_are_one_line(paper, cli, argv, message):
    done = cli(*argv)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
    assert not (paper / "results").exists()


def test_the_experiments_of_the_paper_are_all_there():
    assert [name for name in reproduce.PAPER if name not in reproduce.list_experiments()] == []
    assert reproduce.PAPER[:4] == ("table1", "table2", "fig1", "fig2") and len(reproduce.PAPER) == 12


# -- the real thing --------------------------------------------------------------------------------

STUDIES = (
    "figures/protocol_study.png",
    "figures/solver_study.pdf",
    "tables/protocol_study.md",
    "tables/solver_study.md",
)
FIGURES = [f"fig{number}{kind}" for number in (2, 3, 4) for kind in ("_reference", "_published", "_as_printed")]
FIGURES += [f"fig{number}{kind}" for number in (6, 7) for kind in ("", "_context", "_protocols")]
TABLES = ["fig2", "fig3", "fig4", "fig5", "fig6", "fig7", "fig6_band", "fig7_band"]


@pytest.mark.slow
def test_the_whole_paper_in_small_leaves_every_artefact(work, cli):
    """On the rendered scenes and without a store: all is drawn, no claim about Middlebury, no work done twice."""
    done = cli("report", "--small", "dataset=synthetic")
    assert done.code == 0, done.err
    expected = [f"figures/{name}.{suffix}" for name in FIGURES for suffix in ("png", "pdf")]
    expected += [f"figures/{name}.csv" for name in TABLES]
    expected += [f"private/{name}.{suffix}" for name in ("fig1", "fig5") for suffix in ("png", "pdf")]
    expected += [f"tables/{name}" for name in ("table2.csv", "table2.md", "table2.tex", "claims.csv", "claims.md")]
    expected += ["runs/report.html", "tables/answer.md", *STUDIES]
    names = [name.replace(".", "_synthetic_small.") for name in expected]
    assert [name for name in [*names, "tables/table1.csv"] if not (work / "results" / name).is_file()] == []
    verdicts = pd.read_csv(work / "results/tables/claims_synthetic_small.csv")["verdict"]
    assert set(verdicts) == {"cannot be judged"}
    page = work / "results/runs/report_synthetic_small.html"
    before = page.read_bytes()
    assert set(re.findall(rb"Not computed yet:</strong> the (\w+)", before)) == {b"experiment"}  # beyond the paper
    again = cli("report", "--small", "dataset=synthetic")
    assert again.code == 0 and " points, 0 computed\n" in again.out
    assert page.read_bytes() == before
