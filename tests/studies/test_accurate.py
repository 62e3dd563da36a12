"""The ablation of the accurate preset and the choice of its weights, on made-up tables."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run.plan import plan_experiment
from fracbench.studies import registry
from fracbench.studies.accurate import (
    ablation_sentences,
    ablation_table,
    accurate_study,
    choice_sentences,
    choice_table,
)

#: AEPE by setting (lambda, edge_decay) and sequence. The third is the best on all, the first without b.
SETTINGS = {(0.1, 0.1): (1.0, 9.0, 1.0), (0.1, 0.2): (4.0, 4.0, 4.0), (0.3, 0.1): (2.0, 2.0, 2.0)}


@pytest.fixture
def grid():
    records = [
        {
            "part": "choice",
            "sequence": sequence,
            "lambda": one,
            "edge_decay": other,
            "theta": 0.4,
            "aepe": error,
            "aae": error / 100,
        }
        for (one, other), errors in SETTINGS.items()
        for sequence, error in zip("abc", errors, strict=True)
    ]
    return pd.DataFrame(records)


@pytest.fixture
def ablated():
    factors = {"plain": 1.0, "plain/x": 0.8, "plain/y": 1.1, "accurate": 0.5, "accurate/x": 0.6, "accurate+y": 0.5}
    factors["accurate/z"] = 0.4
    records = [
        {"part": part, "sequence": sequence, "aepe": factor * base, "aae": 0.1 * factor * base, "seconds": base}
        for part, factor in factors.items()
        for sequence, base in (("a", 1.0), ("b", 3.0))
    ]
    return pd.DataFrame(records)


def test_each_sequence_is_scored_with_what_the_others_choose(grid):
    """The definition: the setting with the best mean on two of three, scored on the third."""
    table = choice_table(grid)
    errors = np.array(list(SETTINGS.values()))
    for row, left in zip(table.itertuples(), range(3), strict=False):
        chosen = int(np.argmin(np.delete(errors, left, axis=1).mean(axis=1)))
        assert row.sequence == "abc"[left]
        assert pytest.approx(errors[chosen, left]) == row.AEPE
        assert pytest.approx(math.degrees(errors[chosen, left] / 100)) == row.AAE
    assert table["setting"].tolist()[:3] == [
        "lambda=0.3, edge_decay=0.1",
        "lambda=0.1, edge_decay=0.1",
        "lambda=0.3, edge_decay=0.1",
    ]
    left_out, all_in = table.iloc[3], table.iloc[4]
    assert (left_out["sequence"], left_out["AEPE"]) == ("left out", pytest.approx((2.0 + 9.0 + 2.0) / 3))
    assert (all_in["setting"], all_in["AEPE"]) == ("lambda=0.3, edge_decay=0.1", pytest.approx(2.0))


def test_whole_parts_are_settings_too(grid):
    """A setting that is best by far on a and b, and worst by far on c, is chosen for c."""
    other = [("a", 0.01), ("b", 0.01), ("c", 99.0)]
    rows = pd.DataFrame([{"part": "accurate/x", "sequence": s, "aepe": e, "aae": e / 100} for s, e in other])
    table = choice_table(pd.concat([grid, rows], ignore_index=True)).set_index("sequence")
    assert table.loc["c", "setting"] == "accurate/x" and table.loc["c", "AEPE"] == pytest.approx(99.0)
    assert "accurate/x" not in table.loc[["a", "b"], "setting"].tolist()


def test_the_error_on_a_sequence_has_no_part_in_its_choice(grid):
    """A sequence's own errors, however changed, do not change the setting chosen for it."""
    chosen = choice_table(grid).set_index("sequence")["setting"]
    rng = np.random.default_rng(0)
    for sequence in "abc":
        changed = grid.copy()
        own = changed["sequence"] == sequence
        changed.loc[own, "aepe"] = rng.uniform(0.0, 100.0, own.sum())
        assert choice_table(changed).set_index("sequence")["setting"][sequence] == chosen[sequence]


def test_a_failed_point_leaves_no_choice(grid):
    grid.loc[0, "aepe"] = math.nan
    table = choice_table(grid)
    assert table["sequence"].tolist() == ["a", "b", "c", "left out", "all in"]
    assert table["AEPE"].isna().all() and (table["setting"] == "").all()
    assert choice_sentences(table) == []


def test_the_ablation_holds_means_and_sequences(ablated):
    table = ablation_table(ablated).set_index("part")
    assert table.loc["plain/x", ["seconds", "AEPE", "AEPE a", "AEPE b"]].tolist() == pytest.approx(
        [2.0, 1.6, 0.8, 2.4]
    )
    assert table.loc["accurate", "AAE"] == pytest.approx(math.degrees(0.1))
    assert ablation_sentences(table.reset_index()) == [
        "x: added alone -20.0 %, taken from the whole +20.0 % AEPE.",
        "y: added alone +10.0 %, added to the whole +0.0 % AEPE.",
        "z: taken from the whole -20.0 % AEPE.",
    ]


def test_a_mean_over_fewer_sequences_is_none(ablated):
    ablated.loc[ablated["part"] == "plain/x", "aepe"] = [1.0, math.nan]
    table = ablation_table(ablated)
    assert math.isnan(table.set_index("part").loc["plain/x", "AEPE"])
    assert [sentence.partition(":")[0] for sentence in ablation_sentences(table)] == ["y", "z"]


@pytest.fixture
def study():
    experiment = load_experiment("accurate")
    return experiment, plan_experiment(experiment.grids, ["dataset=synthetic"], allow_download=False)


def test_the_experiment_adds_and_takes_away_each_ingredient():
    grids = load_experiment("accurate").grids
    alone, taken, more = (
        {p.removeprefix(start) for p in grids if p.startswith(start)}
        for start in ("plain/", "accurate/", "accurate+")
    )
    of_the_median = {"occlusion-aware median", "colour weights"}
    assert taken | more == alone | of_the_median and not taken & more and len(alone) == 10
    experiment = load_experiment("accurate")
    plan = plan_experiment(experiment.grids, ["dataset=synthetic"], allow_download=False)
    params: dict = {}
    for planned in plan.points:
        params.setdefault(planned.labels["part"], {"method": planned.point.method, **planned.point.canonical})

    def changed(part, whole):
        one, other = params[part], params[whole]
        return {name for name in one.keys() | other.keys() if one.get(name) != other.get(name)}

    assert changed("accurate/occlusion-aware median", "accurate") == {"occlusion"}
    for name in taken & alone:
        assert changed(f"plain/{name}", "plain") == changed(f"accurate/{name}", "accurate") != set()
    assert changed("accurate+colour weights", "accurate") == {"weighted_guide"}
    for name in more - of_the_median:
        assert changed(f"plain/{name}", "plain") == changed(f"accurate+{name}", "accurate") != set()
    ingredients = set.union(*(changed(f"plain/{name}", "plain") for name in taken & alone))
    assert changed("accurate", "plain") == ingredients


def test_the_preset_is_among_its_choices(study):
    _, plan = study
    parts: dict = {}
    for planned in plan.points:
        parts.setdefault(planned.labels["part"], set()).add(planned.point.key)
    assert parts["accurate"] < parts["choice"]


def test_the_study_leaves_its_files(study, tmp_path, fake_rows):
    experiment, plan = study
    rows = fake_rows(plan, lambda labels, params: (0.1, 0.2 + 0.1 * float(params["lambda"]), 0.3))
    drawn = accurate_study(experiment, plan, rows, tmp_path)
    assert sorted(path.name for path in drawn.files) == [
        "accurate_synthetic.csv",
        "accurate_synthetic.md",
        "accurate_synthetic_choice.csv",
    ]
    assert "seconds" not in pd.read_csv(drawn.files[0]).columns
    text = drawn.files[-1].read_text(encoding="utf-8")
    assert "Chosen on the other sequences: AEPE 0.2150 px" in text and experiment.title in text
    assert registry.require_renderer(experiment) is accurate_study


def test_a_study_without_its_parts_is_refused(study, tmp_path):
    experiment, plan = study
    without = dataclasses.replace(experiment, grids={k: v for k, v in experiment.grids.items() if k != "choice"})
    with pytest.raises(InputError, match="experiment accurate: the grid `choice` is missing"):
        accurate_study(without, plan, {}, tmp_path)


def test_the_preset_for_gray_frames_is_not_chosen_among_colours(study, tmp_path, fake_rows):
    experiment, plan = study
    rows = fake_rows(plan, lambda labels, params: (0.1, 0.1 if "color" in params.values() else 0.2, 0.3))
    drawn = accurate_study(experiment, plan, rows, tmp_path)
    choice = pd.read_csv(next(path for path in drawn.files if path.stem.endswith("_choice")))
    assert choice["AEPE"].to_numpy() == pytest.approx(0.2)
    assert "colour weights: added to the whole -50.0 % AEPE." in drawn.lines
