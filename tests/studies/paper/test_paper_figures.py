"""Table 1 and Figures 1 to 5: their content, their files, and the complete grid."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.data.datasets.synthetic.scenes import scene
from fracbench.errors import InputError
from fracbench.figures import curves, pictures
from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.run.plan import plan_experiment
from fracbench.model.params import FlowParams
from fracbench.studies.paper.table1 import parameter_table
from fracbench.studies.registry import render

SCENES = ["dataset=synthetic"]


def files(folder: Path) -> list[str]:
    """Files below a folder, without the records of what was drawn."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("[!.]*") if path.is_file())


def on_scenes(name: str, **options):
    experiment = load_experiment(name)
    return experiment, plan_experiment(experiment.grids, SCENES, allow_download=False, **options)


@pytest.fixture
def found(monkeypatch):
    """Middlebury data that seem to be present, with a digest each, and are never read."""
    place = middlebury_data.Location(Path("m"), "test", 24)
    monkeypatch.setattr(middlebury_data, "_look_up", lambda explicit: place)
    monkeypatch.setattr(middlebury_data, "digest", lambda sequence, folder: sequence)
    yield


def whole(*names: str):
    """The plans of experiments as they are run on Middlebury."""
    return [plan_experiment(load_experiment(name).grids) for name in names]


# -- the grids -----------------------------------------------------------------------------------

POINTS = {
    "table1": 0,
    "fig1": 0,
    "fig2": 3 * 6 * 13,
    "fig3": 3 * 2 * 5 * 11,
    "fig4": 3 * 2 * 6 * 9,
    "fig5": 0,
    "fig6": 3 * (10 * 21 + 25 * 11 + 21 + 2 * 21),
    "fig7": 3 * (10 * 21 + 25 * 11 + 21 + 2 * 21),
}


@pytest.mark.parametrize(("name", "count"), POINTS.items())
def test_the_grids_are_the_captions(found, name, count):
    assert len(whole(name)[0].points) == count


def test_points_that_figures_share_are_computed_once(found):
    """Figures 3 and 4 have four theta, five lambda, two methods and three protocols in common."""
    theta, weight = whole("fig3", "fig4")
    shared = theta.unique().keys() & weight.unique().keys()
    assert len(shared) == 4 * 5 * 2 * 3
    assert len({*theta.unique(), *weight.unique()}) == 330 + 324 - 120


def test_the_box_in_the_middle_of_the_shifted_ones_is_the_region(found):
    (made,) = whole("fig6")
    keys = {
        part: {
            p.point.key for p in made.points if p.labels["part"] == part and p.labels.get("shift", "12") == "12"
        }
        for part in ("main", "band")
    }
    assert len(keys["band"]) == 3 * 11 and keys["band"] <= keys["main"]
    assert len(made.unique()) == len(made.points) - 3 * 11


def test_the_curves_of_the_regions_are_those_of_the_figures(found):
    regions, *drawn = whole("regions", "fig6", "fig7")
    assert regions.unique().keys() <= drawn[0].unique().keys() | drawn[1].unique().keys()


# -- table 1 -------------------------------------------------------------------------------------


def test_table_1_has_the_papers_rows_and_every_other_parameter():
    table = parameter_table().set_index("parameter")
    paper = {  # typed from the paper
        "lambda": (r"\lambda", "[0.1, 1]"),
        "theta": (r"\theta", "[0.1, 1]"),
        "epsilon": (r"\epsilon", "0.01"),
        "eta": (r"\eta", "0.5"),
        "n_scales": ("N_{scales}", "[3, 5] (Table 2: 4 to 6)"),
        "n_warps": ("N_{warps}", "[3, 5]"),
        "lambda_sb": (r"\lambda_{SB}", "[1, 10]"),
        "alpha": (r"\alpha", "[0, 2]"),
    }
    assert table.loc[list(paper), ["symbol", "paper"]].apply(tuple, axis=1).to_dict() == paper
    assert tuple(table.index) == FlowParams.names()
    assert table["meaning"].ne("").all() and table["allowed"].ne("").all()


def test_what_table_1_allows_is_what_the_program_allows():
    table = parameter_table().set_index("parameter")
    for name, allowed in table["allowed"].items():
        words = re.fullmatch(r"[a-z_0-9, ]+", allowed) and [word.strip() for word in allowed.split(",")]
        for word in words or ():
            assert FlowParams().replace({name: word}).as_dict()[name] is not None
        if bounds := re.search(r"([\[(])([\d.]+), ([\d.]+)\]", allowed):
            ends = {bounds[2]: bounds[1] == "[", bounds[3]: True}
        elif bound := re.search(r"(>=?) ([\d.]+)", allowed):
            ends = {bound[2]: bound[1] == ">="}
        else:
            assert words
            continue
        for end, included in ends.items():
            if included:
                FlowParams().replace({name: end})
            else:
                with pytest.raises(InputError, match=f"`{name}` must be"):
                    FlowParams().replace({name: end})
        FlowParams().replace({name: table.loc[name, "default"]})


def test_table_1_is_written_three_ways_under_one_name_whatever_the_data(tmp_path):
    written = []
    for small in (False, True):
        artefact = render(*on_scenes("table1", small=small), {}, tmp_path)
        written.append({path.name: path.read_text() for path in artefact.files})
    assert written[0] == written[1]
    assert files(tmp_path) == [f"tables/table1.{suffix}" for suffix in ("csv", "md", "tex")]
    table = pd.read_csv(tmp_path / "tables/table1.csv", dtype=str, keep_default_na=False)
    pd.testing.assert_frame_equal(table, parameter_table(), check_dtype=False)
    assert r"| $\lambda_{SB}$" in written[0]["table1.md"]
    latex = written[0]["table1.tex"]
    assert (
        r"$\alpha$ & alpha & order of the fractional gradient; of the paper's method at most 2 & [0, 2] & [0, 4] &"
        in latex
    )
    body = re.sub(r"\$[^$]*\$", "", latex)
    assert r"lambda\_sb" in body and not re.search(r"(?<!\\)[_^%]", body)


# -- pictures ------------------------------------------------------------------------------------


@pytest.fixture
def shown(monkeypatch, unwritten):
    """Frames are not drawn but listed."""
    calls = []

    def pretend(items, **arguments):
        calls.append((items, arguments))
        return "a figure"

    monkeypatch.setattr(pictures, "frame_panel", pretend)
    return calls


def test_figure_1_on_the_scenes_goes_where_nothing_is_committed(tmp_path):
    artefact = render(*on_scenes("fig1"), {}, tmp_path)
    assert files(tmp_path) == ["private/fig1_synthetic.pdf", "private/fig1_synthetic.png"]
    assert [path.suffix for path in artefact.files] == [".png", ".pdf"]


def test_figure_1_shows_the_sequences_in_the_papers_order(tmp_path, shown):
    render(*on_scenes("fig1"), {}, tmp_path)
    ((items, arguments),) = shown
    order = ["Venus", "Urban2", "Urban3", "RubberWhale", "Grove3", "Grove2", "Hydrangea", "Dimetrodon"]
    assert [title.splitlines()[0] for title, _ in items] == order
    assert items[0][0] == "Venus\n(scene occlusion)" and arguments["columns"] == 4
    np.testing.assert_array_equal(items[0][1], scene("occlusion").frame0)


@pytest.mark.middlebury
def test_figure_1_shows_middleburys_frames_in_colour(tmp_path, shown, middlebury):
    experiment = load_experiment("fig1")
    made = plan_experiment(experiment.grids, ["dataset=middlebury", f"paths.data={middlebury}"])
    paths = render(experiment, made, {}, tmp_path).files
    assert paths == [tmp_path / "private" / "fig1.png", tmp_path / "private" / "fig1.pdf"]
    assert [title for title, _ in shown[0][0]][:2] == ["Venus", "Urban2"]
    assert shown[0][0][0][1].shape == (380, 420, 3)


@pytest.mark.middlebury
def test_figure_5_shows_our_boxes(tmp_path, shown, middlebury):
    experiment = load_experiment("fig5")
    made = plan_experiment(experiment.grids, ["dataset=middlebury", f"paths.data={middlebury}"])
    render(experiment, made, {}, tmp_path)
    ((items, arguments),) = shown
    assert [title for title, _ in items] == ["Grove2", "Urban3", "Hydrangea", "RubberWhale"]
    grove2, urban3, hydrangea, rubberwhale = arguments["boxes"]
    assert grove2 == {"A": (90, 250, 190, 390), "B": (360, 460, 60, 220)}
    assert urban3 == {"A": (130, 290, 220, 420)} and rubberwhale == {"A": (60, 190, 210, 370)}
    assert hydrangea == {"A": (150, 280, 130, 290), "B": (220, 350, 240, 400)}
    bounds = pd.read_csv(tmp_path / "figures/fig5.csv")
    assert bounds.loc[1].tolist() == ["grove2_B", "Grove2", 360, 460, 60, 220]


def test_figure_5_takes_the_scenes_as_a_whole(tmp_path, shown):
    artefact = render(*on_scenes("fig5"), {}, tmp_path)
    height, width = scene("parallax").shape
    assert shown[0][1]["boxes"][0] == {"A": (0, height, 0, width), "B": (0, height, 0, width)}
    assert files(tmp_path) == ["figures/fig5_synthetic.csv"]
    assert artefact.files[0] == tmp_path / "private/fig5_synthetic.png"


# -- families of curves --------------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch, unwritten):
    """Families are not drawn but listed."""
    calls = []

    def pretend(table, **arguments):
        calls.append((table, arguments))
        return "a figure"

    monkeypatch.setattr(curves, "line_family", pretend)
    return calls


def bowl(labels, params):
    """Errors that are smallest at lambda 0.3, theta 0.4; TV-L1's are larger throughout."""
    off = (float(params["lambda"]) - 0.3) ** 2 + (float(params["theta"]) - 0.4) ** 2
    extra = 0.01 if labels["method"] == "tvl1" else 0.0
    return 0.1 + off + extra, 0.2 + off + extra, 0.3


@pytest.mark.parametrize(
    ("name", "x", "family", "axes"),
    [("fig2", "lambda_sb", "lambda", (1, 6, 13)), ("fig3", "theta", "lambda", (2, 5, 11)),
     ("fig4", "lambda", "theta", (2, 6, 9))],
)  # fmt: skip
def test_a_family_has_a_figure_a_protocol_and_a_table_of_all_its_points(
    tmp_path, fake_rows, drawn, name, x, family, axes
):
    experiment, made = on_scenes(name)
    artefact = render(experiment, made, fake_rows(made, bowl), tmp_path)
    kinds = ("reference", "published", "as_printed")
    names = [f"{name}_{protocol}_synthetic.{suffix}" for protocol in kinds for suffix in ("png", "pdf")]
    assert [path.name for path in artefact.files] == [*names, f"{name}_synthetic.csv"]
    table = pd.read_csv(tmp_path / f"figures/{name}_synthetic.csv")
    methods, members, places = axes
    assert len(table) == 3 * methods * members * places
    assert table.groupby(["protocol", "method", family])[x].nunique().eq(places).all()
    assert [len(part) for part, _ in drawn] == [len(table) // 3] * 3
    plotted = pd.concat(part for part, _ in drawn).reset_index(drop=True)
    pd.testing.assert_frame_equal(plotted, table, check_dtype=False)
    for (_, arguments), protocol in zip(drawn, ("reference", "published", "as_printed"), strict=True):
        assert (arguments["x"], arguments["family"]) == (x, family)
        assert arguments["title"].endswith(f"\nsynthetic_rotation, protocol {protocol}")


def test_figure_2_has_its_captions_styles_and_range(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes("fig2")
    render(experiment, made, fake_rows(made, bowl), tmp_path)
    looks = [{key: value for key, value in arguments.items() if key != "title"} for _, arguments in drawn]
    assert looks == 3 * [
        {"x": "lambda_sb", "family": "lambda", "logx": True, "shade": [3, 10],
         "styles": ["--*", "--o", "--x", "--", "-", "-."]}
    ]  # fmt: skip
    assert sorted(drawn[0][0]["lambda"].unique()) == [0.03, 0.05, 0.1, 0.3, 0.5, 1]


def test_the_terminal_shows_where_the_errors_are_smallest(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes("fig3")
    ((title, best),) = render(experiment, made, fake_rows(made, bowl), tmp_path).views
    assert title == "Where the errors are smallest: lambda, theta"
    assert len(best) == 3 * 2
    assert best.loc[1].to_dict() == {
        "protocol": "reference", "method": "tvl1_sb", "AAE best at": "0.3, 0.4", "AAE": "0.1000",
        "AEPE best at": "0.3, 0.4", "AEPE": "0.2000",
    }  # fmt: skip


def test_points_that_failed_are_gaps_in_the_figure_and_rows_in_the_table(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes("fig3", small=True)
    rows = fake_rows(made, bowl)
    key = made.points[3].point.key
    rows[key] = fake_rows(made, status="failed")[key]
    artefact = render(experiment, made, rows, tmp_path)
    table = pd.read_csv(artefact.files[-1])
    assert table["status"].value_counts().to_dict() == {"done": len(table) - 1, "failed": 1}
    assert table.loc[table["status"] == "failed", ["aae", "aepe"]].isna().all(axis=None)
    assert drawn[0][0]["aae"].isna().sum() == 1


def test_a_small_run_overwrites_nothing(tmp_path, fake_rows):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures/fig4_synthetic.csv").write_text("of a whole run")
    experiment, made = on_scenes("fig4", small=True)
    render(experiment, made, fake_rows(made, bowl), tmp_path)
    assert (tmp_path / "figures/fig4_synthetic.csv").read_text() == "of a whole run"
    new = [name for name in files(tmp_path) if name != "figures/fig4_synthetic.csv"]
    assert len(new) == 3 * 2 + 1 and all(Path(name).stem.endswith("_synthetic_small") for name in new)


@pytest.mark.parametrize(
    ("artefact", "option"), [("family", "x"), ("frames", "sequences"), ("region_boxes", "regions")]
)
def test_an_option_that_is_missing_is_named(tmp_path, artefact, option):
    experiment = Experiment("mine", "Mine", artefact, {})
    made = plan_experiment({}, SCENES)
    with pytest.raises(InputError, match=f"experiment mine: artefact {artefact} needs the option '{option}'"):
        render(experiment, made, {}, tmp_path)
    assert files(tmp_path) == []


def test_a_key_that_is_no_parameter_offers_the_nearest(tmp_path, fake_rows):
    experiment = Experiment("mine", "Mine", "family", {}, {"x": "thetta", "family": "lambda"})
    made = plan_experiment({"main": ["sequence=synthetic_flat", "theta=0.1,0.2"]})
    with pytest.raises(
        InputError, match="experiment mine, options: unknown parameter 'thetta': did you mean 'theta'"
    ):
        render(experiment, made, fake_rows(made), tmp_path)
    assert files(tmp_path) == []
