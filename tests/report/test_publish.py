"""Git ignores the outputs of commands; only the maintainer's command changes the committed copies."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.paths import checkout
from fracbench.harness.run.store import STORE
from fracbench.report.page.exhibits import figure_files, place
from fracbench.report.sources import COMMITTED, Sources, homes

ROOT = checkout()
pytestmark = pytest.mark.skipif(ROOT is None, reason="the committed copies are those of a checkout")
if ROOT is not None:
    publish = pytest.importorskip("tools.publish", reason="tests are run from the top of the checkout")

WRITTEN = (
    *("tables/table2.csv", "tables/claims_small.md", "tables/.table1.made"),
    *("figures/fig2_reference.png", "figures/.answer.made", "private/fig1_synthetic.pdf"),
    *("sweeps/alpha.csv", str(STORE), "runs/report.html", "runs/flows/a.flo"),
)


def git(*arguments: str) -> list[str]:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        pytest.skip("there is no git")
    if done.returncode == 128:
        pytest.skip("the checkout is no git repository")
    return done.stdout.split()


def test_git_ignores_all_that_a_command_computes():
    files = [f"results/{name}" for name in WRITTEN]
    assert git("check-ignore", "--no-index", *files) == files
    assert (
        git("ls-files", *(f"results/{name}" for name in ("tables", "figures", "private", "sweeps", "runs"))) == []
    )


def test_git_keeps_the_committed_and_the_stored_tables():
    kept = [
        f"{COMMITTED}/tables/table2.csv",
        f"{COMMITTED}/figures/answer.png",
        "results/reference/new_synthetic.csv",
    ]
    assert git("check-ignore", "--no-index", *kept) == []


def test_the_users_own_figures_come_before_the_committed_ones(tmp_path):
    source = SimpleNamespace(experiment=load_experiment("fig2"), suffix="")
    copies = figure_files(tmp_path, source)
    assert set(copies) == {"reference", "published", "as_printed"}
    assert {path.parent for path in copies.values()} == {ROOT / COMMITTED / "figures"}
    said = place(copies["reference"], tmp_path)
    assert said == "Committed copy: `results/committed/figures/fig2_reference.png`"
    (tmp_path / "figures").mkdir()
    own = tmp_path / "figures/fig2_reference.png"
    own.touch()
    assert figure_files(tmp_path, source) == {"reference": own}
    assert place(own, tmp_path) == "File `figures/fig2_reference.png`"


def test_a_table_is_the_users_own_else_the_committed_copy_else_none(tmp_path):
    sources = Sources(tmp_path, ("dataset=synthetic",))
    assert homes(tmp_path) == (tmp_path, ROOT / COMMITTED)
    assert sources.find("tables/table2.md") == ROOT / COMMITTED / "tables/table2.md"
    assert sources.find("tables/table2_small.md") is None
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables/table2.md").touch()
    assert sources.find("tables/table2.md") == tmp_path / "tables/table2.md"


# -- make publish --------------------------------------------------------------------------------


@pytest.fixture
def folders(tmp_path) -> tuple[Path, Path]:
    """Results that are complete, beside older copies of them."""
    results, committed = tmp_path / "results", tmp_path / "results/committed"
    for home, text in ((results, "new"), (committed, "old")):
        for name in ("tables/table2.md", "figures/fig2_reference.png"):
            (home / name).parent.mkdir(parents=True, exist_ok=True)
            (home / name).write_text(text)
    (committed / "figures/readme_flow.png").touch()
    for name in ("tables/table2_small.md", "figures/.answer.made", "tables/mine.csv", "figures/fig20.csv"):
        (results / name).touch()
    return results, committed


def stored(*, stand_in: bool = False, n_missing: int = 0, dirty: bool = False) -> SimpleNamespace:
    """Sources of one experiment, Table 2."""
    rows = {"key": SimpleNamespace(provenance={"dirty": dirty})}
    source = SimpleNamespace(n_missing=n_missing, n_points=3, rows=rows, command="fracbench table 2")
    whole = SimpleNamespace(n_missing=0, rows={})
    return SimpleNamespace(stand_in=stand_in, get=lambda name: source if name == "table2" else whole)


def test_the_copies_are_renewed_and_nothing_else_is_copied(folders):
    results, committed = folders
    assert publish.problems(results, committed, stored()) == []
    assert publish.publish(results, committed) == 2
    assert publish.publish(results, committed) == 0
    files = {str(path.relative_to(committed)) for path in committed.rglob("*") if path.is_file()}
    assert files == {"tables/table2.md", "figures/fig2_reference.png", "figures/readme_flow.png"}
    assert (committed / "tables/table2.md").read_text() == "new"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stand_in": True}, "the tables would be of synthetic scenes"),
        ({"n_missing": 2}, "table2: 2 of 3 points are missing: fracbench table 2"),
        ({"dirty": True}, "table2: 1 points were computed from a commit with local changes"),
    ],
)
def test_points_that_cannot_be_published(folders, changes, message):
    (said,) = publish.problems(*folders, stored(**changes))
    assert message in said


def test_files_that_cannot_be_published(folders):
    results, committed = folders
    (results / "figures/fig2_reference.png").unlink()
    (results / "tables/table2.md").write_text("computed with numpy 2.0, commit abc with local changes.")
    missing, dirty = publish.problems(results, committed, stored())
    assert "lacks figures/fig2_reference.png; run make paper, make beyond and make fluids" in missing
    assert "table2.md: was computed from a commit with local changes" in dirty


def test_some_experiments_are_published_alone(folders):
    results, committed = folders
    for home, text in ((results, "new"), (committed, "old")):
        (home / "tables/fluids_flows.csv").write_text(text)
    sources = stored(n_missing=2)
    assert publish.problems(results, committed, sources, ["fluids"]) == []
    assert publish.publish(results, committed, ["fluids"]) == 1
    assert (committed / "tables/fluids_flows.csv").read_text() == "new"
    assert (committed / "tables/table2.md").read_text() == "old"


def test_an_unknown_experiment_is_not_published(monkeypatch):
    with pytest.raises(publish.InputError, match="fluid_s is not published"):
        publish.main(["fluid_s"])


def test_what_takes_long_is_published_where_it_was_computed_and_kept_else(folders):
    results, committed = folders
    name = "tables/protocol_search_trials.csv.gz"
    (committed / name).write_text("old")
    assert publish.problems(results, committed, stored()) == []
    assert publish.publish(results, committed) == 2
    assert (committed / name).read_text() == "old"
    (results / name).write_text("new")
    (results / "tables/protocol_search_trials_synthetic.csv.gz").touch()
    assert publish.publish(results, committed) == 1
    assert (committed / name).read_text() == "new"
    assert len([*committed.rglob("protocol_search*")]) == 1
