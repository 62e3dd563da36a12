"""Artefacts: the files of an experiment, their names, and their appearance as whole files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.figures import curves, style
from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.run.plan import make_plan, plan_experiment
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import best_values, file_stem
from fracbench.studies.paper import table2
from fracbench.studies.registry import render, require_renderer
from fracbench.studies.sweep import split_varying

FLAT = "sequence=synthetic_flat"


def plan(*tokens):
    return make_plan(tokens, allow_download=False)


def valley(labels, params):
    """Errors that are smallest at alpha 1.2 (AAE) and at 0.6 (AEPE)."""
    alpha = float(params["alpha"])
    return 0.1 + (alpha - 1.2) ** 2, 0.2 + (alpha - 0.6) ** 2, 0.3


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def sweep(*tokens, name="s", title="A sweep"):
    return Experiment(name, title, "sweep", {"main": tokens})


@pytest.fixture
def drawn(monkeypatch):
    """Figures are not drawn but listed: the function's name, its table and its arguments."""
    calls = []

    def pretend(name):
        def draw(table, **arguments):
            calls.append((name, table, arguments))
            return name

        return draw

    for name in ("alpha_curves", "heat_map"):
        monkeypatch.setattr(curves, name, pretend(name))
    monkeypatch.setattr(style, "save_figure", lambda figure, stem: [stem.with_name(f"{stem.name}.png")])
    return calls


# -- sweeps --------------------------------------------------------------------------------------


def test_a_sweep_writes_a_table_and_a_figure(tmp_path, fake_rows):
    made = plan("alpha=0:2:0.2", FLAT)
    rows = fake_rows(made, valley)
    artefact = render(sweep("alpha=0:2:0.2"), made, rows, tmp_path)
    assert files(tmp_path) == ["sweeps/s.csv", "sweeps/s.pdf", "sweeps/s.png"]
    assert artefact.files == [tmp_path / "sweeps" / f"s.{suffix}" for suffix in ("csv", "png", "pdf")]
    assert (tmp_path / "sweeps/s.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "sweeps/s.pdf").read_bytes().startswith(b"%PDF")
    read = pd.read_csv(tmp_path / "sweeps/s.csv")
    assert read["alpha"].tolist() == [k / 5 for k in range(11)]
    assert read["aae"].tolist() == pytest.approx(tidy(made, rows)["aae"].tolist(), rel=1e-15)  # pandas 2 rounds
    ((title, best),) = artefact.views
    assert title == "Best alpha (smaller errors are better)"
    assert best.loc[0, "AAE best at"] == "1.2" and best.loc[0, "AEPE best at"] == "0.6"


def test_the_same_rows_give_the_same_table(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1", FLAT)
    contents = []
    for _ in range(2):
        render(sweep(), made, fake_rows(made, valley), tmp_path)
        contents.append((tmp_path / "sweeps/s.csv").read_bytes())
    assert contents[0] == contents[1]


def test_one_number_is_a_curve_with_a_remark_on_zero(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1,2", FLAT)
    render(sweep(), made, fake_rows(made, valley), tmp_path)
    ((name, table, arguments),) = drawn
    assert name == "alpha_curves"
    assert (arguments["x"], arguments["hue"], arguments["logx"]) == ("alpha", None, False)
    assert arguments["title"] == "A sweep"
    assert "identity" in arguments["zero_note"]
    assert table["alpha"].tolist() == [0, 1, 2]


def test_another_number_has_no_remark_on_zero(tmp_path, fake_rows, drawn):
    made = plan("lambda=0.1,0.2", FLAT)
    render(sweep(), made, fake_rows(made), tmp_path)
    assert (drawn[0][2]["x"], drawn[0][2]["zero_note"]) == ("lambda", "")


def test_names_tell_the_curves_apart(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1", "protocol=reference,recommended", "boundary=zero,reflect", FLAT)
    render(sweep(), made, fake_rows(made, valley), tmp_path)
    ((_, table, arguments),) = drawn
    assert arguments["hue"] == "protocol / boundary"
    assert table[arguments["hue"]].tolist()[:2] == ["reference, zero", "reference, reflect"]


def test_two_numbers_are_a_map(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1", "lambda=0.1,0.2,0.3", FLAT)
    artefact = render(sweep(), made, fake_rows(made, valley), tmp_path)
    ((name, table, arguments),) = drawn
    assert name == "heat_map"
    assert (arguments["x"], arguments["y"], len(table)) == ("alpha", "lambda", 6)
    ((title, best),) = artefact.views
    assert title.startswith("Best alpha, lambda")
    assert best.loc[0, "AAE best at"] == "1, 0.1"
    assert not any("within" in column for column in best)


@pytest.mark.parametrize(
    "tokens",
    [
        ("protocol=reference,recommended",),
        ("alpha=0,1", "lambda=0.1,0.2", "theta=0.1,0.2"),
        ("alpha=0,1", "lambda=0.1,0.2", "boundary=zero,reflect"),
        ("alpha=1",),
    ],
)
def test_where_nothing_can_be_drawn_it_is_said(tmp_path, fake_rows, drawn, tokens):
    made = plan(*tokens, FLAT)
    artefact = render(sweep(), made, fake_rows(made), tmp_path)
    assert drawn == []
    assert files(tmp_path) == ["sweeps/s.csv"]
    assert any(line.startswith("no plot:") for line in artefact.lines)
    assert len(artefact.views) == 1


@pytest.mark.parametrize(
    ("grid", "logarithmic"),
    [
        ("lambda=log(0.01:1:7)", True),
        ("lambda=0.1,0.2,0.4,0.8", True),
        ("lambda=0.1:1:0.1", False),
        ("lambda=0.1,1", False),
        ("presmoothing=0,0.1,1", False),
        ("lambda=0.3", False),
    ],
)
def test_an_axis_is_logarithmic_if_the_values_are_evenly_spaced_there(
    tmp_path, fake_rows, drawn, grid, logarithmic
):
    made = plan(grid, "boundary=zero,reflect", FLAT)
    render(sweep(), made, fake_rows(made), tmp_path)
    assert [call[2]["logx"] for call in drawn] == ([] if grid == "lambda=0.3" else [logarithmic])


def test_a_method_that_does_not_depend_on_the_key_is_left_out_of_the_figure(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1,2", "method=tvl1,tvl1_sb_alpha", FLAT)
    rows = fake_rows(made, lambda labels, params: valley(labels, {"alpha": params.get("alpha", 5)}))
    artefact = render(sweep(), made, rows, tmp_path)
    ((_, table, arguments),) = drawn
    assert arguments["hue"] == "method"
    assert table["method"].tolist() == ["tvl1_sb_alpha"] * 3
    assert "not drawn: points that do not depend on alpha" in artefact.lines
    ((_, best),) = artefact.views
    assert best["method"].tolist() == ["tvl1", "tvl1_sb_alpha"]
    assert best["AAE best at"].tolist() == ["any", "1"]
    assert len(pd.read_csv(tmp_path / "sweeps/s.csv")) == 6


def test_a_key_that_no_method_depends_on_is_no_axis(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1", "lambda=0.1,0.2", "method=tvl1", FLAT)
    render(sweep(), made, fake_rows(made), tmp_path)
    ((_, table, arguments),) = drawn
    assert arguments["x"] == "lambda"
    assert table["lambda"].tolist() == [0.1, 0.2]


def test_points_that_failed_are_gaps(tmp_path, fake_rows, drawn):
    made = plan("alpha=0,1.2,2", FLAT)
    rows = fake_rows(made, valley)
    failed = made.points[1].point.key
    rows[failed] = fake_rows(made, status="failed")[failed]
    artefact = render(sweep(), made, rows, tmp_path)
    assert drawn[0][1]["aae"].isna().tolist() == [False, True, False]
    assert artefact.views[0][1].loc[0, "AAE best at"] == "2"
    all_failed = render(sweep(name="none"), made, fake_rows(made, status="failed"), tmp_path)
    assert len(drawn) == 1
    assert all_failed.views[0][1]["status"].tolist() == ["failed"] * 3
    assert files(tmp_path) == ["sweeps/none.csv", "sweeps/s.csv"]


# -- best values ---------------------------------------------------------------------------------


def test_best_values_and_how_flat_the_minimum_is():
    alpha = np.arange(0.0, 2.01, 0.25)
    aae = np.array([3.0, 2.0, 1.02, 1.01, 1.0, 1.0201, 2.0, 3.0, 4.0])
    aepe = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    best = best_values(pd.DataFrame({"alpha": alpha, "aae": aae, "aepe": aepe}), [], ["alpha"])
    assert best.to_dict("records") == [
        {
            "AAE best at": "1",
            "AAE": "1.0000",
            "AAE within 2%": "0.5 to 1",
            "AEPE best at": "0",
            "AEPE": "1.0000",
            "AEPE within 2%": "0 to 0",
        }
    ]


def test_best_values_for_each_combination_of_names():
    table = pd.DataFrame(
        {
            "region": ["a", "a", "b", "b"],
            "shift": ["", "", "1", "1"],
            "alpha": [1.0, 2.0, 1.0, 2.0],
            "aae": [1.0, 2.0, 4.0, 3.0],
            "aepe": [np.nan, np.nan, 6.0, 5.0],
        }
    )
    best = best_values(table, ["region", "shift"], ["alpha"])
    assert best["region"].tolist() == ["a", "b"]
    assert best["shift"].tolist() == ["", "1"]
    assert best["AAE best at"].tolist() == ["1", "2"]
    assert best["AEPE best at"].tolist() == ["none", "2"]
    assert best["AEPE"].tolist() == ["", "5.0000"]


def test_names_and_numbers_are_told_apart(fake_rows):
    made = plan(
        "alpha=0,1", "params.theta=0.1,0.2", "boundary=zero,reflect", "protocol=reference,recommended", FLAT
    )
    assert split_varying(tidy(made, fake_rows(made)), made) == (["boundary", "protocol"], ["alpha", "theta"])
    made = plan("n_scales=auto,2", "region=grove2_*", "dataset=synthetic")
    assert split_varying(tidy(made, fake_rows(made)), made) == (["n_scales", "region"], [])


# -- names of files ------------------------------------------------------------------------------


def test_what_stands_in_for_middlebury_says_so_and_overwrites_nothing(
    tmp_path, fake_rows, drawn, monkeypatch, no_middlebury
):
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps/s.csv").write_text("measured on Middlebury")
    made = plan("alpha=0,1", "sequence=grove2")
    artefact = render(sweep(), made, fake_rows(made, valley), tmp_path)
    assert files(tmp_path) == ["sweeps/s.csv", "sweeps/s_synthetic.csv"]
    assert (tmp_path / "sweeps/s.csv").read_text() == "measured on Middlebury"
    assert all("_synthetic" in path.name for path in artefact.files)


@pytest.mark.parametrize(
    ("tokens", "stem"),
    [
        (("sequence=grove2", "dataset=synthetic"), "s_synthetic"),
        (("sequence=synthetic_flat,grove2", "dataset=synthetic"), "s_synthetic"),
        (("region=all", "dataset=synthetic"), "s_synthetic"),
        ((FLAT,), "s"),
        ((FLAT, "dataset=synthetic"), "s"),
    ],
)
def test_stand_ins_are_in_the_name_and_scenes_asked_for_are_not(tmp_path, tokens, stem):
    assert file_stem("s", plan(*tokens), tmp_path) == tmp_path / stem


def test_a_thinned_grid_is_in_the_name(tmp_path):
    made = make_plan(["sequence=grove2", "alpha=0:2:0.1", "dataset=synthetic"], small=True)
    assert file_stem("s", made, tmp_path) == tmp_path / "s_synthetic_small"
    assert file_stem("s", make_plan([FLAT], small=True), tmp_path) == tmp_path / "s_small"


# -- table 2 -------------------------------------------------------------------------------------


def test_table_2_is_written_three_ways_for_every_protocol(tmp_path, fake_rows):
    experiment = load_experiment("table2")
    made = plan_experiment(experiment.grids, ["dataset=synthetic"])
    artefact = render(experiment, made, fake_rows(made), tmp_path)
    assert files(tmp_path) == [f"tables/table2_synthetic.{suffix}" for suffix in ("csv", "md", "tex")]
    assert len(pd.read_csv(tmp_path / "tables/table2_synthetic.csv")) == 3 * 8 * 2 * 3
    markdown = (tmp_path / "tables/table2_synthetic.md").read_text()
    latex = (tmp_path / "tables/table2_synthetic.tex").read_text()
    for protocol in ("reference", "published", "as_printed"):
        assert f"## Protocol `{protocol}`" in markdown
        assert f"protocol {protocol}".replace("_", r"\_") in latex
    assert latex.count(r"\begin{tabular}") == 3
    assert tables.CONVENTIONS in markdown and tables.CONVENTIONS in latex
    assert len(artefact.views) == 3
    assert all(len(view) == 16 for _, view in artefact.views)
    assert any(line.startswith("published: TV-L1-SB is better than TV-L1 on 0 of 8") for line in artefact.lines)


# -- when something goes wrong -------------------------------------------------------------------


def test_an_unknown_artefact_offers_the_nearest(tmp_path, fake_rows):
    experiment = Experiment("mine", "t", "sweeep", {})
    with pytest.raises(InputError, match="experiment mine: unknown artefact 'sweeep': did you mean 'sweep'"):
        require_renderer(experiment)
    made = plan("alpha=1", FLAT)
    with pytest.raises(InputError, match="unknown artefact"):
        render(experiment, made, fake_rows(made), tmp_path)
    assert files(tmp_path) == []


def fails(*_, **__):
    raise RuntimeError("no ink")


@pytest.mark.parametrize("where", ["figures.alpha_curves", "style.render", "tables.write_table"])
def test_a_sweep_that_cannot_be_drawn_leaves_no_file(tmp_path, fake_rows, monkeypatch, where):
    module, name = where.split(".")
    made = plan("alpha=0,1", FLAT)
    monkeypatch.setattr({"figures": curves, "style": style, "tables": tables}[module], name, fails)
    if module == "tables":
        monkeypatch.setattr(style, "save_figure", lambda figure, stem: [])
    with pytest.raises(RuntimeError, match="no ink"):
        render(sweep(), made, fake_rows(made, valley), tmp_path)
    assert files(tmp_path) == []


@pytest.mark.parametrize("name", ["to_markdown", "to_latex", "summary", "footnote"])
def test_a_table_that_cannot_be_laid_out_leaves_no_file(tmp_path, fake_rows, monkeypatch, name):
    experiment = load_experiment("table2")
    made = plan_experiment(experiment.grids, ["dataset=synthetic"])
    monkeypatch.setattr(table2 if name == "summary" else tables, name, fails)
    with pytest.raises(RuntimeError, match="no ink"):
        render(experiment, made, fake_rows(made), tmp_path)
    assert files(tmp_path) == []
