from __future__ import annotations

import pytest

from fracbench.errors import InputError
from fracbench.harness.config.experiment import MAIN, Experiment, list_experiments, load_experiment
from fracbench.harness.run.plan import plan_experiment
from fracbench.studies.registry import RENDERERS


def write(work, name, text):
    folder = work / "experiments"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.yaml").write_text(text)


def refusal(name):
    with pytest.raises(InputError) as caught:
        load_experiment(name)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


def test_the_projects_experiments_are_listed(work):
    assert {"table2", "regions"} <= set(list_experiments())


def scenes(name):
    """The plan of an experiment, on the rendered scenes."""
    return plan_experiment(load_experiment(name).grids, ["dataset=synthetic"], allow_download=False)


@pytest.mark.parametrize("name", list_experiments())
def test_every_experiment_can_be_drawn(name):
    experiment = load_experiment(name)
    assert experiment.name == name
    assert experiment.title != name
    assert experiment.artefact in RENDERERS


def of_its_own_data(name):
    grids = load_experiment(name).grids.values()
    return any(token.startswith("dataset=") for grid in grids for token in grid)


PLANNED = [name for name in list_experiments() if load_experiment(name).grids and not of_its_own_data(name)]


@pytest.mark.parametrize("name", PLANNED)
def test_every_experiment_can_be_planned(name):
    plan = scenes(name)
    assert {planned.labels["part"] for planned in plan.points} == set(load_experiment(name).grids)
    assert plan.dataset == "synthetic"


def test_the_experiment_of_fluids_has_its_own_data():
    """Its parts on rendered images by our own methods need nothing else."""
    plan = scenes("fluids")
    parts = {planned.labels["part"] for planned in plan.points}
    ours = {name for name in load_experiment("fluids").grids if not name.endswith(("/peers", "/openpiv"))}
    assert {name for name in ours if not name.startswith("piv ")} <= parts <= set(load_experiment("fluids").grids)
    assert {planned.point.score for planned in plan.points} == {"fluid"}
    assert {planned.labels["margin"] for planned in plan.points} == {"16"}
    assert len(parts) == len(load_experiment("fluids").grids) or plan.notices


def test_table_2_is_the_papers(work):
    """Eight sequences by two methods, under each protocol, in the paper's order."""
    plan = scenes("table2")
    labels = [planned.labels for planned in plan.points]
    assert len(labels) == 3 * 8 * 2
    assert [label["method"] for label in labels[:2]] == ["tvl1", "tvl1_sb"]
    assert list(dict.fromkeys(label["protocol"] for label in labels)) == ["reference", "published", "as_printed"]
    assert {planned.point.canonical.get("lambda_sb", "10") for planned in plan.points} == {"10"}


def test_ones_own_experiment_is_found_in_the_working_folder(work):
    write(
        work, "mine", "title: Mine\nartefact: sweep\ngrid: [alpha=0:1:0.5, region=all]\noptions: {highlight: a}\n"
    )
    assert "mine" in list_experiments()
    assert load_experiment("mine") == Experiment(
        "mine", "Mine", "sweep", {MAIN: ("alpha=0:1:0.5", "region=all")}, {"highlight": "a"}
    )


def test_an_experiment_may_have_several_grids(work):
    write(work, "mine", "grids:\n  a: [alpha=1]\n  b: [alpha=2, theta=0.1]\n")
    assert load_experiment("mine").grids == {"a": ("alpha=1",), "b": ("alpha=2", "theta=0.1")}


def test_ones_own_goes_before_the_projects(work):
    write(work, "table2", "grid: [alpha=1]\n")
    assert load_experiment("table2") == Experiment("table2", "table2", "sweep", {MAIN: ("alpha=1",)})


def test_an_unknown_experiment_offers_the_nearest(work):
    assert "unknown experiment 'tabel2': did you mean 'table2'?" in refusal("tabel2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: [alpha=1]\ntitel: x\n", "unknown key 'titel': did you mean 'title'?"),
        ("grid: [\n", "cannot be read as YAML"),
        ("- alpha=1\n", "must be a mapping with the keys artefact, grid, grids, options, title"),
        ("", "must be a mapping"),
        ("title: x\n", "one of `grid` (overrides) and `grids` (overrides by name) is needed"),
        ("grid: [alpha=1]\ngrids: {a: [alpha=1]}\n", "one of `grid` (overrides) and `grids`"),
        ("grid: alpha=1\n", "a grid must be a list of overrides"),
        ("grid: [alpha: 1]\n", "a grid must be a list of overrides"),
        ("grid: [1, 2]\n", "a grid must be a list of overrides"),
        ("grids: {a: [alpha=1], b: alpha=1}\n", "a grid must be a list of overrides"),
        ("grids: [alpha=1]\n", "a grid must be a list of overrides"),
        ("grid: [alpha=1]\noptions: [a]\n", "`options`: must be a mapping"),
    ],
)
def test_mistakes_are_one_line_that_names_the_file(work, text, message):
    write(work, "own", text)
    said = refusal("own")
    assert message in said
    assert "own.yaml" in said


def test_a_file_that_is_no_text_is_refused(work):
    (work / "experiments").mkdir()
    (work / "experiments" / "own.yaml").write_bytes(b"\xff\xfe\x00")
    assert "own.yaml: cannot be read as YAML" in refusal("own")
