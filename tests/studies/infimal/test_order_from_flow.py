"""The study of the flow in two parts: its tables of made-up errors with known ratios, its files and pictures."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pandas as pd
import pytest

from fracbench.data.datasets.synthetic.mixed_structure import MIXED_STRUCTURE
from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run.plan import plan_experiment
from fracbench.studies.infimal.artefact import order_from_flow
from fracbench.studies.infimal.figures import parts_panel, share_of_change
from fracbench.studies.infimal.tables import ALL, MIXED, frame_table, scene_table, sentences

#: The best order of each scene, and the error of the flow in two parts relative to alpha = 1.
BEST = {"lone_edge": (1.0, 1.1), "lone_affine": (1.6, 0.5), "mixed_patch": (1.2, 0.8)}
ALPHAS = (0.8, 1.0, 1.2, 1.4, 1.6)


def scene_runs(n=20, spread=0.01):
    """Errors with a valley at a known order; seeds differ by a factor of their own."""
    rng = np.random.default_rng(0)
    records = []
    for (scene, (place, ratio)), seed in itertools.product(BEST.items(), range(n)):
        factor = math.exp(rng.normal())
        common = {"sequence": f"synthetic_{scene}", "noise": "1", "seed": str(seed), "status": "done"}

        def add(part, error, common=common, factor=factor, **setting):
            error *= factor * math.exp(rng.normal(0.0, spread))
            records.append({**common, "part": part, "aepe": error, "aae": 0.1 * error, **setting})

        for alpha in ALPHAS:
            add("scenes/single", math.exp((alpha - place) ** 2 - (1.0 - place) ** 2), alpha=alpha)
        add("scenes/parts", ratio, alpha=1.0, alpha_smooth=1.5, smooth_weight=2.0)
    return pd.DataFrame(records)


class TestScenes:
    def test_ratios_are_those_of_the_errors(self):
        table = scene_table(scene_runs()).query("metric == 'aepe'").set_index("scene")
        assert [*table.index] == [*BEST, ALL, MIXED]
        np.testing.assert_allclose(table.loc[[*BEST], "parts"], [ratio for _, ratio in BEST.values()], rtol=0.01)
        own = [math.exp(-((1.0 - place) ** 2)) for place, _ in BEST.values()]
        np.testing.assert_allclose(table.loc[[*BEST], "own"], own, rtol=0.01)
        # One order for the edge and the slanted plane is half way between them.
        assert table.loc["lone_affine", "one"] == pytest.approx(math.exp(0.2**2 - 0.6**2 + 0.1**2), rel=0.1)
        both = table.loc[["lone_edge", "lone_affine"]]
        for name in ("one", "own", "parts", "oracle"):
            assert table.loc[ALL, name] == pytest.approx(math.sqrt(both[name].prod()), rel=1e-6)
        assert (table["parts_low"] < table["parts"]).all() and (table["parts"] < table["parts_high"]).all()
        assert (table["oracle"] <= table["own"] + 1e-12).all()
        assert set(table["n"]) == {20}

    def test_the_scenes_that_mix_have_one_order_for_them_all(self):
        runs = scene_runs()
        other = runs[runs["sequence"] == "synthetic_mixed_patch"].assign(sequence="synthetic_mixed_vortex")
        other["aepe"] *= np.exp(other["alpha"] * -1.2)  # its valley is at 1.8, and that of both at 1.5
        parts = other["part"] == "scenes/parts"
        other.loc[parts, "aepe"] *= math.exp(1.2)
        table = scene_table(pd.concat([runs, other])).query("metric == 'aepe'").set_index("scene")
        both = table.loc[["mixed_patch", "mixed_vortex"]]
        assert table.loc[MIXED, "parts"] == pytest.approx(math.sqrt(both["parts"].prod()), rel=1e-6)
        # 1.4 and 1.6 are as good: e^(0.1^2 - 0.5^2)
        assert table.loc[MIXED, "own"] == pytest.approx(math.exp(0.1**2 - 0.5**2), rel=0.02)
        assert table.loc[MIXED, "own"] > math.sqrt(both["own"].prod()) + 0.01

    def test_several_settings_are_one_for_all_scenes_chosen_on_other_seeds(self):
        runs = scene_runs()
        worse = runs[runs["part"] == "scenes/parts"].assign(smooth_weight=3.0)
        worse["aepe"] *= np.where(worse["sequence"] == "synthetic_lone_edge", 0.9, 1.3)  # better there alone
        both = scene_table(pd.concat([runs, worse])).query("metric == 'aepe'").set_index("scene")
        plain = scene_table(runs).query("metric == 'aepe'").set_index("scene")
        np.testing.assert_allclose(both["parts"], plain["parts"])

    def test_without_a_whole_seed_there_are_no_rows(self):
        assert scene_table(scene_runs(2).assign(status="failed")).empty

    def test_a_seed_with_a_failed_point_is_left_out(self):
        runs = scene_runs()
        runs.loc[runs["seed"] == "3", "aepe"] = runs["aepe"].where(runs["part"] == "scenes/single")
        table = scene_table(runs)
        assert set(table.query("metric == 'aepe'")["n"]) == {19}
        assert set(table.query("metric == 'aae'")["n"]) == {20}

    def test_alpha_1_must_be_there(self):
        runs = scene_runs()
        with pytest.raises(InputError, match="alpha = 1"):
            scene_table(runs[(runs["alpha"] != 1.0) | (runs["part"] == "scenes/parts")])


class TestSequences:
    def runs(self):
        records = []
        settings = [("single", {"alpha": a}, e) for a, e in ((1.0, 0.3), (1.2, 0.2))]
        settings += [
            ("parts", {"alpha": 1.0, "alpha_smooth": b, "smooth_weight": 2.0}, 0.1 * b) for b in (1.4, 1.6)
        ]
        for sequence, (kind, setting, error) in itertools.product(("A", "B", "C"), settings):
            aepe = error - 0.15 * (sequence == "C" and setting["alpha"] == 1.0 and kind == "single")
            records.append({"part": f"plain/{kind}", "sequence": sequence, "aepe": aepe, "aae": 0.1, **setting})
        return pd.DataFrame(records)

    def test_settings_are_chosen_on_the_other_sequences(self):
        table = frame_table(self.runs()).set_index("sequence")
        assert table["single"].tolist() == ["1.2", "1.2", "1.2", ""]
        assert table["parts"].tolist() == ["(1, 1.4) 2"] * 3 + [""]
        assert table.loc["mean", "single_aepe"] == pytest.approx(0.2)
        assert table.loc["mean", "parts_aae"] == pytest.approx(math.degrees(0.1))
        assert table.loc["mean", "gain"] == pytest.approx(30.0)
        (line,) = sentences(pd.DataFrame(), table.reset_index())
        assert "0.1400 px in two parts, 0.2000 px with one order; better on 3 of 3 sequences" in line


class TestPictures:
    def test_the_share_is_that_of_the_steeper_part(self):
        parts = np.zeros((2, 2, 6, 7))
        parts[0, 0, :, 4:] = 1.0
        parts[1, 1] = 0.5 * np.arange(6)[:, None] * (np.arange(7) < 3)
        share = share_of_change(parts)
        assert (share[:, :2] == 1.0).all() and (share[:, 4] == 0.0).all() and np.isnan(share[:, 6]).all()

    def test_a_row_a_flow(self):
        parts = np.random.default_rng(0).normal(size=(2, 2, 8, 9)).astype(np.float32)
        fig = parts_panel([("one", parts), ("two", parts)], "title")
        assert [ax.get_ylabel() for ax in fig.axes[:8]] == ["one", "", "", "", "two", "", "", ""]
        assert [ax.get_title()[:2] for ax in fig.axes[:3]] == ["p:", "q:", "u "]


@pytest.fixture
def small(fake_rows):
    experiment = load_experiment("order_from_flow")
    plan = plan_experiment(experiment.grids, ["dataset=synthetic"], allow_download=False, small=True)
    return experiment, plan, fake_rows(plan)


def test_the_experiment_asks_what_the_issue_asks():
    grids = load_experiment("order_from_flow").grids
    points = [p.point for p in plan_experiment({"a": grids["scenes/parts"]}, allow_download=False).points]
    assert {point.sequence for point in points} == {*SINGLE_STRUCTURE, *MIXED_STRUCTURE}
    assert {point.noise for point in points} == {1.0, 3.0} and {point.seed for point in points} == set(range(20))
    assert {point.canonical["boundary"] for point in points} == {"reflect"}
    assert parse_overrides(grids["scenes/single"]).size == 2 * 2 * 20 * 9  # globs count once


def test_files_tables_and_sentences(small, tmp_path):
    experiment, plan, rows = small
    made = order_from_flow(experiment, plan, rows, tmp_path)
    ending = "_synthetic_small"
    expected = [f"tables/order_from_flow{ending}.csv", f"tables/order_from_flow{ending}.md"]
    expected += [f"tables/order_from_flow{ending}_frames.csv"]
    expected += [f"figures/order_from_flow_parts{ending}.{suffix}" for suffix in ("png", "pdf")]
    assert sorted(path.relative_to(tmp_path).as_posix() for path in made.files) == sorted(expected)
    assert all(path.is_file() for path in made.files)
    text = (tmp_path / f"tables/order_from_flow{ending}.md").read_text(encoding="utf-8")
    assert all(line in text for line in made.lines)


def test_missing_points_leave_gaps(small, tmp_path):
    experiment, plan, rows = small
    failed = next(p.point.key for p in plan.points if p.labels["part"] == "accurate/parts")
    rows[failed] = dataclasses.replace(rows[failed], status="failed", result={}, error="made up")
    order_from_flow(experiment, plan, rows, tmp_path)
    frames = pd.read_csv(tmp_path / "tables/order_from_flow_synthetic_small_frames.csv")
    assert frames[frames["sequence"] == "mean"]["gain"].notna().any()
