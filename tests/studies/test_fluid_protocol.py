"""The choice of protocol=fluid, on made-up tables whose choices are known."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run.plan import plan_experiment
from fracbench.studies import registry
from fracbench.studies.fluid_protocol import (
    choice_by_flow,
    flow_errors,
    fluid_protocol,
    sentences,
    settings_table,
)

#: AEPE by setting (order, lambda) on the pairs a and b, and on the flows x, y and z.
ERRORS = {
    (1.0, 0.1): (9.0, 9.0, 0.2, 0.2, 0.2),
    (2.0, 0.1): (1.0, 1.0, 0.1, 0.1, 0.7),
    (3.0, 0.1): (0.5, 1.2, 0.3, 0.3, 0.3),
}


@pytest.fixture
def runs():
    """Rendered flows have two displacements, whose errors differ by half of their mean."""
    records = []
    for (order, weight), errors in ERRORS.items():
        common = {"part": "single", "alpha": math.nan, "alpha_flat": order, "lambda": weight}
        for name, error in zip("ab", errors[:2], strict=True):
            pair = {"dataset": "piv", "sequence": name, "displacement": "", "aepe": error}
            records.append(common | pair)
        for name, error in zip("xyz", errors[2:], strict=True):
            for px, factor in (("1", 0.5), ("5", 1.5)):
                flow = {"dataset": "particles", "sequence": name, "displacement": px, "aepe": factor * error}
                records.append(common | flow)
    return pd.DataFrame(records)


def test_errors_of_a_flow_are_means_over_its_images(runs):
    table = flow_errors(runs)
    assert table.index.tolist() == ["1, 0.1", "2, 0.1", "3, 0.1"]
    assert table.columns.tolist() == [("piv", "a"), ("piv", "b"), *(("particles", name) for name in "xyz")]
    np.testing.assert_allclose(table.to_numpy(), list(ERRORS.values()))


def test_each_flow_has_the_setting_that_is_best_on_the_others(runs):
    """The definition: the mean over pairs plus the mean over flows, without the one that is left out."""
    table = choice_by_flow(runs)
    errors = np.array(list(ERRORS.values()))
    weighted = errors / [2, 2, 3, 3, 3]
    for k, (dataset, flow) in enumerate((*(("piv", n) for n in "ab"), *(("particles", n) for n in "xyz"))):
        best = int(np.delete(weighted, k, axis=1).sum(axis=1).argmin())
        row = table.iloc[k]
        assert (row["dataset"], row["flow"], row["setting"]) == (dataset, flow, f"{best + 1}, 0.1")
        assert row["AEPE"] == pytest.approx(errors[best, k]) and row["order 1"] == pytest.approx(errors[0, k])
    assert len(set(table["setting"][:5])) == 2  # the flows do not agree
    left_out = table[table["flow"] == "left out"].set_index("dataset")["AEPE"]
    assert left_out["piv"] == pytest.approx(table["AEPE"][:2].mean())
    assert left_out["particles"] == pytest.approx(table["AEPE"][2:5].mean())
    all_in = table[table["flow"] == "all in"].set_index("dataset")
    assert set(all_in["setting"]) == {"3, 0.1"} and all_in.loc["piv", "AEPE"] == pytest.approx(0.85)


def test_the_error_on_a_flow_has_no_part_in_its_choice(runs):
    chosen = choice_by_flow(runs).set_index("flow")["setting"]
    rng = np.random.default_rng(0)
    for flow in "abxyz":
        changed = runs.copy()
        own = changed["sequence"] == flow
        changed.loc[own, "aepe"] = rng.uniform(0.0, 100.0, own.sum())
        assert choice_by_flow(changed).set_index("flow")["setting"][flow] == chosen[flow]


def test_settings_are_told_best_first(runs):
    table = settings_table(runs)
    assert table["setting"].tolist() == ["3, 0.1", "2, 0.1", "1, 0.1"]
    best = table.iloc[0]
    assert (best["piv"], best["particles"]) == (pytest.approx(0.85), pytest.approx(0.3))
    assert (best["both"], best["1 px"], best["5 px"]) == (
        pytest.approx(0.575),
        pytest.approx(0.15),
        pytest.approx(0.45),
    )


def test_sentences_name_the_flows_on_which_order_1_is_better(runs):
    lines = sentences(choice_by_flow(runs))
    assert "piv: AEPE 0.8500 px chosen on all (3, 0.1)." in lines
    flows = choice_by_flow(runs)[:5]
    worse = flows[flows["AEPE"] > flows["order 1"]]["flow"].tolist()
    assert worse and lines[-1] == f"The chosen error is larger on {', '.join(worse)} than that of order 1."
    runs.loc[runs["alpha_flat"] == 1.0, "aepe"] = 100.0
    assert sentences(choice_by_flow(runs))[-1] == "The chosen error is on no flow larger than that of order 1."


def test_a_setting_that_failed_is_never_chosen(runs):
    runs.loc[(runs["alpha_flat"] == 3.0) & (runs["sequence"] == "x"), "aepe"] = math.nan
    assert "3, 0.1" not in choice_by_flow(runs)["setting"].tolist()
    runs["aepe"] = math.nan
    with pytest.raises(InputError, match="no setting has an error on every flow"):
        choice_by_flow(runs)


def test_the_preset_is_among_its_candidates_and_the_study_leaves_its_files(tmp_path, fake_rows):
    experiment = load_experiment("fluid_protocol")
    rendered = {part: grid for part, grid in experiment.grids.items() if part.startswith("particles")}
    plan = plan_experiment(rendered, allow_download=False)
    images = ("dataset=", "noise=", "lost=", "displacement=", "margin=", "protocol=", "normalisation=")
    own = [token for token in rendered["particles/single"] if token.startswith(images)]
    preset = plan_experiment({"own": own}, allow_download=False)
    assert preset.unique().keys() < plan.unique().keys()
    rows = fake_rows(plan, lambda labels, params: (0.1, 0.2 + float(params["lambda"]), 0.3))
    drawn = fluid_protocol(experiment, plan, rows, tmp_path)
    assert sorted(path.name for path in drawn.files) == [
        "fluid_protocol.csv",
        "fluid_protocol.md",
        "fluid_protocol_settings.csv",
    ]
    assert drawn.lines[0] == "particles: AEPE 0.2150 px chosen on the other flows."
    assert registry.require_renderer(experiment) is fluid_protocol
