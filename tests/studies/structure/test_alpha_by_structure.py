"""The structure experiment: its figures and files, and its tables of made-up errors with a known best alpha."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pandas as pd
import pytest

from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run.plan import plan_experiment
from fracbench.model.structure import CLASSES, structure_classes
from fracbench.studies.structure.artefact import alpha_by_structure
from fracbench.studies.structure.figures import class_overlay, structure_panels
from fracbench.studies.structure.tables import (
    AGREES,
    DIFFERS,
    NEAR,
    best_table,
    curve_table,
    long_table,
    sentences,
)

ALPHAS = np.round(np.arange(0.0, 2.01, 0.2), 1)
BEST = {"lone_flat": 0.2, "lone_edge": 1.2, "lone_corner": 0.8}


def box(point):
    return None if point.region is None else (*point.region.rows, *point.region.cols)


def long(best=BEST, spread=0.02, n=20, depth=0.3, seed=0) -> pd.DataFrame:
    """Errors with a valley at a known alpha, all of one seed multiplied by one large factor."""
    rng = np.random.default_rng(seed)
    records = []
    for (name, place), boundary, unit in itertools.product(best.items(), ("zero", "reflect"), range(n)):
        factor = math.exp(rng.normal())
        for alpha in ALPHAS:
            error = factor * math.exp(depth * (alpha - place) ** 2 + rng.normal(0.0, spread))
            keys = {"part": "scenes", "structure": name, "noise": "1", "boundary": boundary, "unit": str(unit)}
            records.append({**keys, "alpha": alpha, "aepe": error, "aae": 0.5 * error})
    return pd.DataFrame(records)


class TestTables:
    def test_ratios_take_the_seeds_own_factor_out(self):
        curves = curve_table(long())
        chosen = curves[(curves["structure"] == "lone_edge") & (curves["metric"] == "aepe")]
        expected = np.exp(0.3 * ((chosen["alpha"] - 1.2) ** 2 - 0.2**2))
        np.testing.assert_allclose(chosen["ratio"], expected, rtol=0.03)
        assert (chosen["low"] <= chosen["ratio"]).all() and (chosen["ratio"] <= chosen["high"]).all()
        assert (chosen["high"] / chosen["low"]).max() < 1.05  # though errors differ tenfold between seeds
        at_one = chosen[chosen["alpha"] == 1.0]
        assert (at_one[["ratio", "low", "high"]] == 1.0).all(axis=None)

    def test_the_best_alpha_its_gain_and_the_verdicts(self):
        paper = {"lone_flat": (0.0, 0.3), "lone_corner": (1.5, 2.0)}
        best = best_table(long(), paper).set_index(["structure", "boundary", "metric"])
        for (name, place), boundary in itertools.product(BEST.items(), ("zero", "reflect")):
            row = best.loc[name, boundary, "aepe"]
            assert row["best"] == place
            assert row["best_low"] <= place <= row["best_high"]
            gain = 100 * (1 - math.exp(-0.3 * (place - 1.0) ** 2))
            assert row["gain"] == pytest.approx(gain, abs=1.5)
            assert row["gain_low"] < row["gain"] < row["gain_high"]
        assert best.loc["lone_flat", "zero", "aepe"]["verdict"] == AGREES
        corner = best.loc["lone_corner", "zero", "aepe"]
        assert corner["verdict"] == DIFFERS
        assert corner["costs"] == pytest.approx(100 * math.expm1(0.3 * 0.8**2), abs=2.0)
        assert best.loc["lone_edge", "zero", "aepe"]["verdict"] == ""

    def test_a_range_that_costs_next_to_nothing_is_near(self):
        best = best_table(long({"lone_corner": 1.0}, spread=1e-4, depth=0.01), {"lone_corner": (1.5, 2.0)})
        assert set(best["verdict"]) == {NEAR}
        assert 0 < best["costs"].max() < 2.0

    def test_noise_alone_gains_nothing(self):
        made = [long({"lone_edge": 1.0}, spread=0.1, depth=0.0, seed=seed) for seed in range(20)]
        gains = pd.concat([best_table(table, {}) for table in made])["gain"]
        assert abs(gains.mean()) < 2.0  # the smallest of the means themselves would gain 3 to 4

    def test_a_seed_with_a_failed_point_is_left_out(self):
        table = long({"lone_edge": 1.2})
        table.loc[(table["unit"] == "3") & (table["alpha"] == 2.0), "aepe"] = np.nan
        curves = curve_table(table)
        assert set(curves.loc[curves["metric"] == "aepe", "n"]) == {19}
        assert set(curves.loc[curves["metric"] == "aae", "n"]) == {20}

    def test_a_single_seed_has_no_interval(self):
        best = best_table(long(n=1), {})
        assert best[["gain", "gain_low", "gain_high"]].isna().all(axis=None)
        assert curve_table(long(n=1))["low"].isna().all()

    def test_without_alpha_1_there_is_nothing_to_compare_with(self):
        table = long()
        with pytest.raises(InputError, match="alpha = 1"):
            curve_table(table[table["alpha"] != 1.0])

    def test_the_sentences_count_settings(self):
        lines = sentences(best_table(long(), {"lone_flat": (0.0, 0.3)}))
        assert len(lines) == 3
        assert lines[0].startswith("lone_flat (scenes): best alpha 0.2 to 0.2 over 2 settings")
        assert "the paper's 0 to 0.3 agrees in 2" in lines[0]
        assert "paper" not in lines[1]


class TestFigures:
    def test_a_panel_a_structure_in_order_with_both_boundaries(self):
        curves = curve_table(long()).query("metric == 'aepe'")
        fig = structure_panels(curves, {"lone_edge": (1.0, 1.5)}, "title")
        assert [ax.get_title() for ax in fig.axes] == ["flat", "edge", "corner"]
        labels = [text.get_text() for text in fig.legends[0].get_texts()]
        assert sorted(labels) == [
            "best in the paper",
            "boundary reflect, with 95 % interval",
            "boundary zero, with 95 % interval",
        ]
        stars = [line.get_xdata()[0] for line in fig.axes[1].lines if line.get_marker() == "*"]
        assert stars == pytest.approx([1.2, 1.2])

    def test_the_veil_has_a_colour_for_each_class(self):
        frame = np.full((40, 40), 100.0)
        frame[:20, :20] = 200.0
        picture, classes = class_overlay(frame), structure_classes(frame)
        assert picture.shape == (40, 40, 3)
        assert picture.dtype == np.uint8
        colours = {
            name: {tuple(c) for c in picture[(classes == i) & (frame == 100)]} for i, name in enumerate(CLASSES)
        }
        found = [colour for colour in colours.values() if colour]
        assert all(len(colour) == 1 for colour in found)
        assert len(set.union(*found)) == len(found) == 3


@pytest.fixture
def small(fake_rows):
    """The experiment's small form with made-up errors: flat ground is best at 0, everything else at 1."""
    experiment = load_experiment("alpha_by_structure")
    plan = plan_experiment(experiment.grids, ["dataset=synthetic"], allow_download=False, small=True)
    rows = {}
    for key, row in fake_rows(plan).items():
        alpha, rough = float(row.spec["params"]["alpha"]), 1.0 + (row.spec.get("seed", 0) % 7) / 70
        errors = dict(
            zip(("aepe", "aae", "sdae"), rough * np.array([1.0, 2.0, 3.0]) * (1 + (alpha - 1) ** 2), strict=True)
        )
        classes = {}
        if row.spec.get("score") == "structure":
            flat = {"aepe": rough * (1 + alpha), "aae": 0.1 * (1 + alpha), "sdae": 0.2}
            classes = {"classes": {"flat": flat, "edge": errors}}
        rows[key] = dataclasses.replace(row, result={**row.result, **errors, **classes})
    return experiment, plan, rows


def test_the_experiment_asks_what_the_issue_asks():
    grid = parse_overrides(load_experiment("alpha_by_structure").grids["scenes"])
    assert grid.size == 3 * 20 * 11 * 2
    one = [f"{axis.keys[0]}={axis.values[-1][0]}" for axis in grid.axes]
    points = [planned.point for planned in plan_experiment({"scenes": one}, allow_download=False).points]
    assert {point.sequence for point in points} == set(SINGLE_STRUCTURE)
    assert {(point.seed, point.noise, point.canonical["alpha"]) for point in points} == {(19, 3.0, "2")}
    assert {(point.method, box(point)) for point in points} == {("tvl1_sb_alpha", (24, 72, 24, 72))}


def test_classes_are_those_of_whole_frames():
    grids = {"classes": load_experiment("alpha_by_structure").grids["classes"]}
    points = [p.point for p in plan_experiment(grids, ["dataset=synthetic"], allow_download=False).points]
    assert len(points) == len({point.key for point in points}) == 8 * 2 * 10
    assert {(box(point), point.context, point.score) for point in points} == {(None, 0, "structure")}
    assert {point.canonical["boundary"] for point in points} == {"zero", "reflect"}
    assert sorted({float(point.canonical["alpha"]) for point in points}) == pytest.approx(np.arange(1, 11) / 5)


def test_both_parts_become_one_form(small):
    from fracbench.harness.run.tidy import tidy

    _, plan, rows = small
    table = long_table(tidy(plan, rows))
    assert set(table["structure"]) == {"lone_affine", "lone_corner", "all", *CLASSES}
    flat = table[(table["structure"] == "flat") & (table["alpha"] == 2)]
    assert flat["aepe"].tolist() == pytest.approx([3.0] * 4)
    assert flat["unit"].nunique() == 2
    assert table.loc[table["structure"] == "corner", "aepe"].isna().all()
    assert len(table[table["part"] == "scenes"]) == 2 * 3 * 3 * 2 * 3


def test_files_tables_and_sentences(small, work, unwritten):
    experiment, plan, rows = small
    made = alpha_by_structure(experiment, plan, rows, work / "results")
    names = {path.relative_to(work / "results").as_posix() for path in made.files}
    ending = "_synthetic_small"
    expected = {f"tables/alpha_by_structure{kind}{ending}.csv" for kind in ("", "_curves")}
    expected |= {f"tables/alpha_by_structure{ending}.md"}
    for kind in ("", "_classes", "_scenes"):
        expected |= {f"figures/alpha_by_structure{kind}{ending}.{suffix}" for suffix in ("png", "pdf")}
    assert names == expected
    best = pd.read_csv(work / f"results/tables/alpha_by_structure{ending}.csv")
    flat = best[(best["structure"] == "flat") & (best["metric"] == "aepe")]
    assert flat["best"].tolist() == [0.2, 0.2]
    assert flat["verdict"].tolist() == [AGREES, AGREES]
    assert set(best.loc[best["structure"] == "lone_corner", "verdict"]) == {DIFFERS}
    text = (work / f"results/tables/alpha_by_structure{ending}.md").read_text(encoding="utf-8")
    for line in made.lines:
        assert line in text


def test_failed_points_are_left_out_and_the_rest_is_drawn(small, work, unwritten):
    experiment, plan, rows = small
    failed = next(key for key, row in rows.items() if row.spec["sequence"] == "lone_corner")
    rows[failed] = dataclasses.replace(rows[failed], status="failed", result={}, error="made up")
    alpha_by_structure(experiment, plan, rows, work / "results")
    curves = pd.read_csv(work / "results/tables/alpha_by_structure_curves_synthetic_small.csv")
    assert set(curves.loc[curves["structure"] == "lone_corner", "n"]) == {2, 3}
    assert set(curves.loc[curves["structure"] == "lone_affine", "n"]) == {3}


@pytest.mark.parametrize("paper", [{"flat": 3}, {"flat": [1, 2, 3]}, ["flat"], {"flat": ["a", "b"]}])
def test_what_the_paper_says_must_be_ranges(small, work, paper):
    experiment, plan, rows = small
    experiment = dataclasses.replace(experiment, options={"paper": paper})
    with pytest.raises(InputError, match="the option 'paper' must be"):
        alpha_by_structure(experiment, plan, rows, work)
