"""Figures 6 and 7: the curves in front, the points of the band, and complete tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.figures.style import BEHIND, PALETTE
from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.run.plan import plan_experiment
from fracbench.studies.paper import alpha_regions
from fracbench.studies.paper.alpha_regions import captions
from fracbench.studies.registry import render

SCENES = ["dataset=synthetic"]
FILES = ["fig6", "fig6_context", "fig6_protocols"]


def files(folder: Path) -> list[str]:
    """Files below a folder, without the records of what was drawn."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("[!.]*") if path.is_file())


def on_scenes(name="fig6", **options):
    experiment = load_experiment(name)
    return experiment, plan_experiment(experiment.grids, SCENES, allow_download=False, **options)


def errors(labels, params):
    """AAE is smallest at lambda_sb 4, alpha 1.2; AEPE at lambda_sb 8, alpha 0.8."""
    alpha, weight = float(params["alpha"]), float(params["lambda_sb"])
    protocol = {"reference": 1.0, "published": 3.0, "as_printed": 5.0}[labels["protocol"]]
    aae = 0.1 + (alpha - 1.2) ** 2 + 0.005 * (weight - 4) ** 2
    aepe = 0.2 + (alpha - 0.8) ** 2 + 0.01 * (weight - 8) ** 2
    return protocol * aae, protocol * aepe, 0.3


@pytest.fixture
def drawn(monkeypatch, unwritten):
    """Figures are not drawn; their panels are kept by figure, region and error."""
    figures = []

    def pretend(regions, compose, *, x, title, note=""):
        panels = {(region, metric): compose(region, metric) for region in regions for metric in ("aae", "aepe")}
        figures.append({"panels": panels, "title": title, "note": note})
        return len(figures) - 1

    monkeypatch.setattr(alpha_regions, "panel_grid", pretend)
    return figures


def labelled(panel):
    return {curve.label: curve for curve in panel.curves}


# -- files ---------------------------------------------------------------------------------------


def test_there_are_three_figures_and_a_table_of_every_point(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    artefact = render(experiment, made, fake_rows(made, errors), tmp_path)
    assert [path.name for path in artefact.files] == [
        *(f"{name}_synthetic.{suffix}" for name in FILES for suffix in ("png", "pdf")),
        "fig6_synthetic.csv", "fig6_band_synthetic.csv",
    ]  # fmt: skip
    table = pd.read_csv(tmp_path / "figures/fig6_synthetic.csv")
    assert table["part"].value_counts().to_dict() == {
        "main": 3 * 10 * 21, "band": 3 * 25 * 11, "context": 3 * 21, "protocols": 3 * 2 * 21,
    }  # fmt: skip
    grid = ["part", "protocol", "region", "lambda_sb", "shift", "alpha"]
    assert not table.duplicated(grid).any()
    assert table.groupby(["part", "region"])["alpha"].nunique().to_dict() == {
        (part, region): 11 if part == "band" else 21
        for part in ("main", "band", "context", "protocols")
        for region in ("grove2_A", "grove2_B", "urban3_A")
    }


def test_a_small_run_draws_and_overwrites_nothing(tmp_path, fake_rows):
    experiment, made = on_scenes(small=True)
    render(experiment, made, fake_rows(made, errors), tmp_path)
    stems = [*FILES, "fig6_band"]
    assert {Path(name).stem for name in files(tmp_path)} == {f"{stem}_synthetic_small" for stem in stems}
    assert len(files(tmp_path)) == 3 * 2 + 2


def test_parts_may_be_left_out_but_not_the_main_one(tmp_path, fake_rows, drawn):
    grids = {"main": ["region=grove2_A", "alpha=0,1"], "other": ["region=grove2_A", "alpha=2"]}
    for name, chosen in (("main", {"main": grids["main"]}), ("other", {"other": grids["other"]})):
        experiment = Experiment("mine", "Mine", "alpha_regions", chosen)
        made = plan_experiment(chosen, SCENES)
        if name == "other":
            with pytest.raises(InputError, match="experiment mine: artefact alpha_regions needs the grid 'main'"):
                render(experiment, made, fake_rows(made), tmp_path)
        else:
            artefact = render(experiment, made, fake_rows(made, errors), tmp_path)
            assert [path.name for path in artefact.files] == [
                "mine_synthetic.png",
                "mine_synthetic.pdf",
                "mine_synthetic.csv",
            ]
            panel = drawn[0]["panels"]["grove2_A", "aae"]
            assert (panel.band, panel.published) == (None, None)


# -- what the paper says -------------------------------------------------------------------------


def test_the_captions_are_the_papers():
    said = {**captions(load_experiment("fig6")), **captions(load_experiment("fig7"))}
    assert {name: tuple(values[key] for key in ("lambda_sb", "aae", "aepe")) for name, values in said.items()} == {
        "grove2_A": (5, 1.2, 1.4), "grove2_B": (7, 0, 0), "urban3_A": (1, 1.5, 1.5),
        "hydrangea_A": (3, 1, 1), "hydrangea_B": (10, 0.9, 1), "rubberwhale_A": (2, 1.4, 1.4),
    }  # fmt: skip


@pytest.mark.parametrize(
    "paper", [["grove2_A"], {"grove2_A": 5}, {"grove2_A": {"aae": 1}}, {"grove2_A": {"aae": 1, "aepe": "x"}}]
)  # fmt: skip
def test_captions_that_cannot_be_read_are_refused(tmp_path, fake_rows, paper):
    grids = {"main": ["region=grove2_A", "alpha=0,1"]}
    made = plan_experiment(grids, SCENES)
    experiment = Experiment("mine", "Mine", "alpha_regions", grids, {"paper": paper})
    with pytest.raises(InputError, match="experiment mine: the option 'paper' must be a mapping of regions to"):
        render(experiment, made, fake_rows(made), tmp_path)
    assert files(tmp_path) == []


def test_a_region_of_the_captions_that_is_no_text_is_refused():
    experiment = Experiment("mine", "Mine", "alpha_regions", {}, {"paper": {1: {"aae": 1, "aepe": 1}}})
    with pytest.raises(InputError, match="unknown region '1'"):
        captions(experiment)


# -- panels --------------------------------------------------------------------------------------


def test_the_best_weight_is_in_front_by_each_error(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    render(experiment, made, fake_rows(made, errors), tmp_path)
    panels = drawn[0]["panels"]
    for metric, best, alpha in (("aae", 4, 1.2), ("aepe", 8, 0.8)):
        panel = panels["grove2_A", metric]
        *others, caption, front = panel.curves
        assert front.starred and front.look["color"] == PALETTE[0]
        assert front.points["lambda_sb"].unique().tolist() == [best]
        assert front.points.loc[front.points[metric].idxmin(), "alpha"] == alpha
        assert caption.points["lambda_sb"].unique().tolist() == [5] and not caption.starred
        assert sorted(curve.points["lambda_sb"].iloc[0] for curve in others) == sorted({*range(1, 11)} - {best, 5})
        assert {curve.look["color"] for curve in others} == {BEHIND}
        assert panel.heading == "grove2_A: synthetic_parallax\n" + rf"best $\lambda_{{SB}}$ = {best} (paper: 5)"
    assert (panels["grove2_A", "aae"].published, panels["grove2_A", "aepe"].published) == (1.2, 1.4)
    assert panels["grove2_B", "aae"].published == 0


def test_where_the_papers_weight_is_best_it_is_drawn_once(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    rows = fake_rows(made, lambda labels, params: (1 + abs(float(params["lambda_sb"]) - 5), 1.0, 0.3))
    render(experiment, made, rows, tmp_path)
    panel = drawn[0]["panels"]["grove2_A", "aae"]
    assert len(panel.curves) == 10
    assert [curve.label for curve in panel.curves[-2:]] == [
        r"other $\lambda_{SB}$ in 1 to 10", r"the $\lambda_{SB}$ with the smallest error",
    ]  # fmt: skip


@pytest.mark.middlebury
def test_the_band_spans_the_shifted_boxes(tmp_path, fake_rows, drawn, middlebury):
    """The scenes stand in as a whole, so only Middlebury's boxes differ from shift to shift."""
    experiment = load_experiment("fig6")
    made = plan_experiment(experiment.grids, [f"paths.data={middlebury}", "dataset=middlebury"])

    def shifted(labels, params):
        offset = 0.01 * int(labels.get("shift", 12))
        return 1 + offset + float(params["alpha"]), 2 + offset, 0.3

    points = [planned for planned in made.points if planned.labels["part"] != "main"]
    rows = fake_rows(made, shifted) | fake_rows(type(made)(**{**vars(made), "points": tuple(points)}), shifted)
    render(experiment, made, rows, tmp_path)
    band = pd.read_csv(tmp_path / "figures/fig6_band.csv")
    assert len(band) == 3 * 11
    np.testing.assert_allclose(band["aae_low"], 1 + band["alpha"])
    np.testing.assert_allclose(band["aae_high"], 1.24 + band["alpha"])
    np.testing.assert_allclose(band[["aepe_low", "aepe_high"]].drop_duplicates(), [[2.0, 2.24]])
    panel = drawn[0]["panels"]["urban3_A", "aepe"]
    assert len(panel.band) == 11 and "25 shifted boxes" in panel.band_label


def test_a_failed_point_is_never_the_best_and_leaves_a_gap(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    rows = fake_rows(made, errors)
    lost = next(
        planned.point.key
        for planned in made.points
        if planned.labels["region"] == "grove2_A" and planned.point.canonical["alpha"] == "1.2"
        and planned.point.canonical["lambda_sb"] == "4"
    )  # fmt: skip
    rows[lost] = fake_rows(made, status="diverged")[lost]
    render(experiment, made, rows, tmp_path)
    front = drawn[0]["panels"]["grove2_A", "aae"].curves[-1]
    assert front.points["lambda_sb"].iloc[0] in (3, 5)
    others = drawn[0]["panels"]["grove2_A", "aae"].curves
    assert sum(int(curve.points["aae"].isna().sum()) for curve in others) == 1


def test_context_is_drawn_before_the_region_alone_at_the_captions_weight(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    render(experiment, made, fake_rows(made, errors), tmp_path)
    figure = drawn[1]
    alone, context = figure["panels"]["grove2_B", "aepe"].curves
    assert alone.label == "boundary zero, the region alone" and not alone.starred
    assert alone.points["lambda_sb"].unique().tolist() == [7]
    assert context.starred and context.ringed and context.points["boundary"].unique().tolist() == ["reflect"]
    assert len(alone.points) == len(context.points) == 21
    assert "identity" in figure["note"]


def test_each_protocol_has_a_curve_of_its_own(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    render(experiment, made, fake_rows(made, errors), tmp_path)
    curves = labelled(drawn[2]["panels"]["urban3_A", "aae"])
    assert list(curves) == ["protocol reference", "protocol published", "protocol as_printed"]
    assert all(curve.starred and len(curve.points) == 21 for curve in curves.values())
    assert {curve.points["lambda_sb"].iloc[0] for curve in curves.values()} == {1}
    assert len({(curve.look["color"], curve.look["marker"]) for curve in curves.values()}) == 3


def test_the_terminal_shows_the_best_values_beside_the_papers(tmp_path, fake_rows, drawn):
    experiment, made = on_scenes()
    (_, swept), (_, fixed) = render(experiment, made, fake_rows(made, errors), tmp_path).views
    assert swept.loc[0].to_dict() == {
        "region": "grove2_A", "AAE best at": "4, 1.2", "AAE": "0.1000", "AAE paper at": "5, 1.2",
        "AEPE best at": "8, 0.8", "AEPE": "0.2000", "AEPE paper at": "5, 1.4",
    }  # fmt: skip
    assert len(fixed) == 3 * (1 + 1 + 2)
    assert set(fixed["AAE best at"]) == {"1.2"} and set(fixed["AEPE best at"]) == {"0.8"}
    first = fixed.loc[0]
    assert (first["region"], first["protocol"], first["boundary"]) == ("grove2_A", "reference", "zero")
