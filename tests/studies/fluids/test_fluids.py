"""The study of fluids: its tables of made-up errors with known means, its verdicts, its files and pictures."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest

from fracbench.figures.style import save_figure
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run.compute_point import run_point
from fracbench.harness.run.plan import plan_experiment
from fracbench.harness.run.point import Job
from fracbench.model import SOLVER_VERSION
from fracbench.studies.fluids.artefact import fluids
from fracbench.studies.fluids.figures import flow_panels, order_panels, setting_panels
from fracbench.studies.fluids.sentences import sentences
from fracbench.studies.fluids.tables import (
    ALPHA_1,
    MEAN,
    OPENPIV,
    OURS,
    SCORES,
    flow_table,
    gradient_table,
    order_table,
    setting_table,
    with_names,
)

#: Errors of each method on two flows; a seed adds a hundredth of a pixel.
ERRORS = {"ours": (0.04, 0.08), "openpiv": (0.10, 0.30), "opencv_dis": (0.15, 0.25), "skimage_ilk": (0.03, 0.50)}
DIS, ILK = "OpenCV DIS", "scikit-image iLK"


def row(part, method, sequence, seed, error, **more):
    common = {"dataset": "particles", "status": "done", "passes": 3.0, "deformation": "second_image"}
    scores = {score: error * (i + 1) for i, score in enumerate(SCORES)}
    return {**common, "part": part, "method": method, "sequence": sequence, "seed": str(seed), **scores, **more}


def flow_runs():
    records = []
    for (method, errors), (i, flow), seed in itertools.product(
        ERRORS.items(), enumerate(("jet", "shear")), range(3)
    ):
        name = {"ours": "flows/ours", "openpiv": "flows/openpiv"}.get(method, "flows/peers")
        own = "tvl1_sb_alpha_map" if method == "ours" else method
        records.append(row(name, own, flow, seed, errors[i] + 0.01 * (seed - 1)))
    return records


def order_runs():
    """An order of 2 is best with the protocol's weight; with weight 0.1, alpha = 1 has half its error."""
    records = []
    for alpha, flow, seed in itertools.product((1.0, 2.0, 3.0), ("jet", "shear"), range(2)):
        error = 0.05 + 0.1 * abs(alpha - 2.0)
        records.append(row("orders", "tvl1_sb_alpha_map", flow, seed, error, alpha_flat=alpha, **{"lambda": 0.03}))
        weight = {"alpha_flat": alpha, "lambda": 0.1}
        part = "orders/lambda"
        records.append(row(part, "tvl1_sb_alpha_map", flow, seed, error * (0.5 if alpha == 1 else 2.0), **weight))
    return records


def setting_runs():
    records = []
    for value, seed in itertools.product((2, 10), range(2)):
        for part, method, error in (
            ("displacement/ours", "tvl1_sb_alpha_map", 0.02 * value),
            ("displacement/alpha 1", "tvl1_sb_alpha_map", 0.03 * value),
            ("displacement/openpiv", "openpiv", 0.1),
        ):
            records.append(row(part, method, "jet", seed, error, displacement=str(value)))
    return records


def runs(*parts):
    return with_names(pd.DataFrame([record for part in parts for record in part]))


def test_methods_go_by_their_names():
    made = runs(
        [
            row("flows/ours", "tvl1_sb_alpha_ic", "jet", 0, 1.0),
            row("noise/alpha 1", "tvl1_sb_alpha_map", "jet", 0, 1.0),
            row("flows/openpiv", "openpiv", "jet", 0, 1.0, passes=2.0),
            row("piv flows/openpiv", "openpiv", "jet", 0, 1.0, deformation="symmetric"),
            row("flows/peers", "opencv_dis", "jet", 0, 1.0),
        ]
    )
    windows = f"{OPENPIV}, windows to 32 px"
    assert [*made["name"]] == [OURS, ALPHA_1, windows, f"{OPENPIV}, symmetric", DIS]
    assert [*made["topic"]] == ["flows", "noise", "flows", "flows", "flows"]


def test_means_and_intervals_are_over_seeds():
    table = flow_table(runs(flow_runs())).set_index(["flow", "method"])
    ours = table.loc[("jet", OURS)]
    half = 4.302653 * 0.01 / math.sqrt(3)  # Student's quantile of two degrees of freedom
    assert (ours["n"], ours["aepe"]) == (3, pytest.approx(0.04))
    assert (ours["aepe_low"], ours["aepe_high"]) == (pytest.approx(0.04 - half), pytest.approx(0.04 + half))
    # all flows share the seed's hundredth of a pixel, so that their mean is no more certain than one of them
    mean = table.loc[(MEAN, OURS)]
    assert (mean["aepe"], mean["aepe_high"]) == (pytest.approx(0.06), pytest.approx(0.06 + half))
    assert table.loc[(MEAN, DIS), "vorticity_grid"] == pytest.approx(0.2 * (1 + SCORES.index("vorticity_grid")))


def test_a_point_that_failed_leaves_no_mean_of_its_method():
    records = flow_runs()
    records[0]["status"] = "failed"
    table = flow_table(runs(records)).set_index(["flow", "method"])["aepe"]
    assert math.isnan(table[("jet", OURS)]) and math.isnan(table[(MEAN, OURS)])
    assert table[("shear", OURS)] == pytest.approx(0.08)
    lines = " ".join(sentences(flow_table(runs(records)), pd.DataFrame(), setting_table(runs(records))))
    assert "not known for ours" in lines and "jet, where ours failed" in lines


def test_each_order_has_the_protocols_weight_and_its_best():
    table = order_table(runs(order_runs()))
    jet = table[table["flow"] == "jet"].set_index("alpha")
    assert jet["aepe"].to_dict() == pytest.approx({1.0: 0.15, 2.0: 0.05, 3.0: 0.15})
    assert jet["best_aepe"].to_dict() == pytest.approx({1.0: 0.075, 2.0: 0.05, 3.0: 0.15})
    assert jet["best_lambda"].to_dict() == {1.0: 0.1, 2.0: 0.03, 3.0: 0.03}
    assert set(table["flow"]) == {"jet", "shear", MEAN}


def test_the_verdicts_are_those_of_the_errors():
    every = runs(flow_runs(), order_runs(), setting_runs())
    lines = sentences(flow_table(every), order_table(every), setting_table(every))
    assert "AEPE: 0.0600 px, 0.30 times that of OpenPIV (0.2000); goal: at most 0.4, reached." in lines[0]
    assert "0.30 times that of the best of the others, OpenCV DIS (0.2000)" in lines[2]
    assert "goal: at most 0.5, reached" in lines[3]
    # beside alpha = 1 with weight 0.1, of 0.075 px: 0.04 and 0.08 px
    assert "0.53 to 1.07 times" in lines[4] and "missed: shear (1.07 times)" in lines[4]
    assert "by flow: jet 2, shear 2." in lines[5]
    assert "10 px: AEPE 0.200 px, OpenPIV 0.100 px; goal: below it, missed." in lines[6]
    assert "jet (scikit-image iLK 0.030 px, ours 0.040)" in lines[7]
    assert "displacement 10 (OpenPIV 0.100 px, ours 0.200)" in lines[7] and "shear (" not in lines[7]


def test_settings_are_numbers_and_averaged_over_flows():
    table = setting_table(runs(setting_runs())).set_index(["setting", "value", "method"])
    assert table.loc[("displacement", 10.0, ALPHA_1), "aepe"] == pytest.approx(0.3)
    assert table.index.get_level_values("value").dtype.kind == "f"


def test_figures_have_a_panel_for_each_flow_and_setting(tmp_path):
    every = runs(flow_runs(), order_runs(), setting_runs())
    flows, orders, settings = flow_table(every), order_table(every), setting_table(every)
    gradients = pd.DataFrame({"gradient": [0.0, 0.1], "method": OURS, "aepe": [0.01, 0.1]}).assign(
        aepe_low=0.01, aepe_high=0.2
    )
    figures = order_panels(orders, flows, "a"), setting_panels(settings, gradients, "b"), flow_panels(flows, "c")
    titles = [[ax.get_title() for ax in figure.axes if ax.axison] for figure in figures]
    assert titles[0] == ["jet", "shear", "mean, particles"]
    assert [ax.get_xlabel() for ax in figures[1].axes][:1] == ["largest displacement [px]"]
    assert len(titles[1]) == 2 and len(titles[2]) == 2
    orders[["aepe", "best_aepe", "aepe_low", "aepe_high"]] = np.nan  # of points that all failed
    save_figure(order_panels(orders, flows.iloc[:0], "d"), tmp_path / "failed")


GRID = {
    "orders": ["alpha_flat=1,3", "method=tvl1_sb_alpha_map"],
    "orders/lambda": ["alpha_flat=1,3", "method=tvl1_sb_alpha_map", "lambda=0.1"],
    "flows/ours": [],
    "displacement/ours": ["displacement=5,10"],
}


def test_from_points_to_files(work, tmp_path):
    """Each point is computed as a sweep does; two seeds of a flow that is everywhere alike."""
    fixed = ["dataset=particles", "sequence=shear", "seed=0,1", "margin=64", "score=fluid", "protocol=fluid"]
    quick = ["n_warps=1", "max_iter=2", "n_scales=3"]
    plan = plan_experiment({part: [*fixed, *quick, *tokens] for part, tokens in GRID.items()})
    rows = {}
    for key, point in plan.unique().items():
        rows[key] = Job(key, point, 1, SOLVER_VERSION, {}, None, None).row(run_point(point, None))
    gradients = gradient_table(plan, rows)
    # the rate of shear is the displacement at the upper edge by half the height
    assert [*gradients["gradient"]] == [0.02, 0.05] and set(gradients["n_pixels"]) == {2 * 128 * 128}
    done = fluids(load_experiment("fluids"), plan, rows, tmp_path)
    names = {path.relative_to(tmp_path).as_posix() for path in done.files}
    tables = {f"tables/fluids{ending}.csv" for ending in ("", "_orders", "_settings", "_gradients")}
    figures = {
        f"figures/fluids{ending}.{kind}" for ending in ("", "_settings", "_flows") for kind in ("png", "pdf")
    }
    assert names == tables | figures | {"tables/fluids.md"}
    text = (tmp_path / "tables/fluids.md").read_text(encoding="utf-8")
    assert text.startswith("# Fluids") and "nan" not in text
    orders = pd.read_csv(tmp_path / "tables/fluids_orders.csv")
    assert len(orders) == 2 * 2 and orders["aepe"].notna().all() and (orders["best_aepe"] <= orders["aepe"]).all()
