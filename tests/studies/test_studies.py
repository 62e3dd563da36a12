"""The two studies: distances, best alphas and sentences on made-up tables, and the files written."""

from __future__ import annotations

import dataclasses
import math
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.paths import asset
from fracbench.harness.run.grid_points import PlannedPoints
from fracbench.harness.run.plan import plan_artefact, plan_experiment
from fracbench.studies import registry
from fracbench.studies.protocols import protocol_study, switch_dots, switch_sentences, switch_table
from fracbench.studies.solvers.solver_study import (
    printed_alphas,
    solver_sentences,
    solver_study,
    solver_summary,
    spectra_table,
    spectrum_points,
)
from fracbench.studies.solvers.solver_study_figure import solver_panels
from fracbench.studies.solvers.spectral_radius import jacobi_limit, spectrum

METRICS = ["aae", "aepe", "sdae"]
GRIDS = {
    "reference": ["a=1", "b=1"],
    "reference/gain": ["a=1", "b=1", "gain=0.5"],
    "reference/inner": ["a=1", "b=1", "inner=cold", "tol=0.1"],
    "reference/gain+inner": ["a=1", "b=1", "gain=0.5", "inner=cold"],
    "published": ["a=1", "b=2"],
    "published/gain": ["a=1", "b=2", "gain=none"],
}
FACTORS = dict(zip(GRIDS, (0.1, 0.5, 0.11, 1.02, 1.0, 0.2), strict=True))


@pytest.fixture
def published():
    return pd.read_csv(asset("results/published/table2.csv"))


@pytest.fixture
def switches(published):
    """Each part is the printed table times a factor of its own."""
    parts = [published.assign(part=part, **{m: published[m] * f for m in METRICS}) for part, f in FACTORS.items()]
    return pd.concat(parts, ignore_index=True)


# -- protocol study --------------------------------------------------------------------------------


def test_distances_are_those_of_the_factors(switches, published):
    table = switch_table(switches, published, GRIDS)
    assert table["protocol"].tolist() == ["reference"] * 4 + ["published"] * 2
    assert table["switch"].tolist() == ["", "gain", "inner", "gain+inner", "", "gain"]
    assert table["set to"].tolist() == [
        "",
        "gain=0.5",
        "inner=cold, tol=0.1",
        "gain=0.5, inner=cold",
        "",
        "gain=none",
    ]
    expected = [abs(math.log(factor)) for factor in FACTORS.values()]
    for column in ("distance", "distance tvl1", "distance tvl1_sb"):
        np.testing.assert_allclose(table[column], expected, atol=1e-12)
    assert table["within 5 %"].tolist() == [0, 0, 0, 48, 48, 0]
    assert table["SB better, AEPE"].tolist() == [8] * 6
    means = published.groupby("method")["aepe"].mean()
    np.testing.assert_allclose(table["AEPE tvl1"], [means["tvl1"] * f for f in FACTORS.values()])


def test_one_methods_numbers_move_its_own_distance(switches, published):
    rows = (switches["part"] == "published") & (switches["method"] == "tvl1_sb")
    switches.loc[rows, METRICS] *= 3.0
    row = switch_table(switches, published, GRIDS).query("protocol == 'published' and switch == ''").iloc[0]
    assert row["distance tvl1"] == pytest.approx(0.0, abs=1e-12)
    assert row["distance tvl1_sb"] == pytest.approx(math.log(3.0))
    assert row["distance"] == pytest.approx(math.log(3.0) / math.sqrt(2.0))
    assert (row["within 10 %"], row["SB better, AAE"]) == (24, 0)


def test_sentences_name_the_switch_that_moves_most(switches, published):
    first, second = switch_sentences(switch_table(switches, published, GRIDS))
    assert first == (
        "From reference (distance 2.303), gain=0.5 alone leads to 0.693, each other switch alone to between 2.207 "
        "and 2.207; gain=0.5, inner=cold together lead to 0.020."
    )
    assert second == "From published (distance 0.000), gain=none alone leads to 1.609."


def test_a_failed_point_leaves_no_distance_and_no_sentence(switches, published):
    switches.loc[0, METRICS] = np.nan
    table = switch_table(switches, published, GRIDS)
    assert table["distance"].isna().tolist() == [True] + [False] * 5
    assert math.isnan(table["AEPE tvl1"][0]) and not math.isnan(table["AEPE tvl1_sb"][0])
    assert [sentence[:14] for sentence in switch_sentences(table)] == ["From published"]


def test_bars_and_dots_show_the_table(switches, published):
    table = switch_table(switches, published, GRIDS)
    left, right = switch_dots(table, "Title").axes[:2]
    np.testing.assert_allclose([bar.get_width() for bar in left.patches], table["distance"])
    for ax, columns in ((left, ("distance tvl1", "distance tvl1_sb")), (right, ("AEPE tvl1", "AEPE tvl1_sb"))):
        for line, column in zip(ax.lines, columns, strict=True):
            np.testing.assert_allclose(line.get_xdata(), table[column])
    labels = [text.get_text() for text in left.get_yticklabels()]
    assert labels[0] == "protocol reference" and "gain=0.5" in labels[1]


def test_the_experiment_turns_each_switch_in_which_the_protocols_differ():
    from fracbench.harness.config.compose import load_config

    grids = load_experiment("protocol_study").grids
    params = {name: load_config({"protocol": name}).params.as_dict() for name in ("reference", "published")}
    differ = {key for key in params["reference"] if params["reference"][key] != params["published"][key]}
    for base, other in (("reference", "published"), ("published", "reference")):
        turned = {}
        for part, tokens in grids.items():
            if part.startswith(f"{base}/") and "+" not in part:
                turned |= dict(token.split("=") for token in tokens if token not in grids[base])
        # A warm loop looks at neither `tol` nor `max_inner`, so turning `inner` back needs no other.
        needed = differ - ({"tol"} if base == "published" else set())
        assert set(turned) == needed
        target = load_config({"protocol": other}).override(turned).params.as_dict()
        assert {key: target[key] for key in turned} == {key: params[other][key] for key in turned}


# -- solver study ----------------------------------------------------------------------------------

PAIRS = pd.DataFrame(
    {"theta": [0.3, 0.7], "lambda_sb": [5.0, 1.0]}, index=pd.Index(["grove2_A", "urban3_A"], name="region")
)
PRINTED = {"grove2_A": {"aae": 1.2, "aepe": 1.4}, "urban3_A": {"aae": 1.5, "aepe": 1.5}}
LIMITS = {"grove2_A": 1.18, "urban3_A": 1.34}
BEST = {"jacobi": 0.6, "gauss_seidel": 1.2, "exact": 1.4}


def runs(best=BEST, alphas=(0.0, 0.6, 1.0, 1.2, 1.4, 2.0)):
    records = [
        {"region": region, "u_solver": solver, "alpha": alpha, "aae": 0.1 + (alpha - b) ** 2,
         "aepe": (2.0 if solver == "jacobi" and alpha > LIMITS[region] else 1.0) * (0.2 + (alpha - 1.0) ** 2)}
        for region in PAIRS.index for solver, b in best.items() for alpha in alphas
    ]  # fmt: skip
    return pd.DataFrame(records)


def test_the_summary_has_the_best_alpha_of_each_solver():
    table = solver_summary(runs(), PAIRS, PRINTED)
    assert table["region"].tolist() == ["grove2_A", "urban3_A"]
    np.testing.assert_allclose(table["limit"], [jacobi_limit(0.3, 5.0), jacobi_limit(0.7, 1.0)], atol=1e-4)
    assert table["aae paper"].tolist() == [1.2, 1.5] and table["aepe paper"].tolist() == [1.4, 1.5]
    for solver, best in BEST.items():
        assert table[f"aae {solver}"].tolist() == [best] * 2
        np.testing.assert_allclose(table[f"aae {solver} error"], 0.1)
        assert table[f"aepe {solver}"].tolist() == [1.0] * 2


def test_a_curve_with_a_failed_point_has_no_best():
    table = runs()
    table.loc[0, ["aae", "aepe"]] = np.nan
    summary = solver_summary(table, PAIRS, PRINTED)
    assert summary["aae jacobi"].isna().tolist() == [True, False]
    said = solver_sentences(table, summary)
    assert any("With Jacobi (printed), the best alpha is not known by AAE" in sentence for sentence in said)


def test_sentences_compare_with_the_limit_and_with_the_paper():
    made = runs()
    said = solver_sentences(made, solver_summary(made, PAIRS, PRINTED))
    assert said[0] == (
        "The printed sweep stops converging at alpha 1.18 to 1.34, by region; the paper's best alpha is beyond "
        "that on 2 of 2 by AAE, on 2 by AEPE."
    )
    assert said[1] == (
        "In the paper, the best alpha is by AAE within 0.2 of the limit on 2 of 2 regions, with a rank "
        "correlation of +1.00; by AEPE within 0.2 of the limit on 1 of 2 regions, with a rank correlation of "
        "+1.00."
    )
    assert said[2].startswith(
        "With Jacobi (printed), the best alpha is by AAE within 0.2 of the limit on 0 of 2 regions, with a rank "
        "correlation of none, and within 0.1 of the paper's on 0; by AEPE within 0.2 of the limit on 1 of 2"
    )
    assert "and within 0.1 of the paper's on 1" in said[4]  # 1.4 and 1.5 for urban3_A
    assert (
        said[5]
        == "AEPE with Jacobi against exact: 1.00 times from 1 to its limit, 2.00 times beyond (geometric means)."
    )


def spectra(**options):
    """The spectra of the systems of `PAIRS`, which have their regions' captions, by the worker's function."""
    experiment = dataclasses.replace(
        load_experiment("solver_study"), grids={"main": ["region=grove2_A,urban3_A"]}, options=options
    )
    plan = plan_experiment(experiment.grids, ["dataset=synthetic"], allow_download=False)
    points = spectrum_points(experiment, plan)
    rows = {each.point.key: SimpleNamespace(result=spectrum(each.point, None)) for each in points}
    return spectra_table(dataclasses.replace(plan, points=PlannedPoints(plan.points, points)), rows)


def test_spectra_are_those_of_each_regions_system():
    table = spectra(size=10, alpha_step=0.5, tol=1e-6, limit=500)
    assert table.drop_duplicates("region").set_index("region")[["theta", "lambda_sb"]].equals(PAIRS)
    assert table["region"].tolist() == ["grove2_A"] * 5 + ["urban3_A"] * 5
    assert table["alpha"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0] * 2
    first = table[table["region"] == "grove2_A"]
    assert (first["jacobi radius"] > 1.0).tolist() == [False] * 3 + [True] * 2
    assert first["jacobi sweeps"].isna().tolist() == [False] * 3 + [True] * 2
    assert first["gauss_seidel sweeps"].notna().all()
    assert (first["gauss_seidel radius"] < 1.0).all()
    assert first["jacobi sweeps"].iloc[0] == 1
    # A stronger coupling needs fewer sweeps, and the radius roughly predicts their number.
    radii = table.pivot_table("gauss_seidel radius", "alpha", "region").loc[0.5:]
    assert (radii["urban3_A"] < radii["grove2_A"]).all()
    rate = -math.log(first["gauss_seidel radius"].iloc[2])
    assert first["gauss_seidel sweeps"].iloc[2] * rate == pytest.approx(math.log(1e6), rel=0.35)


def test_panels_show_spectra_and_errors():
    made = runs()
    found = spectra(size=6, alpha_step=1.0, tol=1e-3, limit=50)
    summary = solver_summary(made, PAIRS, PRINTED)
    jacobi, _, counts, grove, urban = solver_panels(found, made, summary, "Title").axes
    np.testing.assert_allclose(jacobi.lines[0].get_ydata(), found["jacobi radius"][:3])
    assert len(counts.lines) == 4 and np.isnan(counts.lines[0].get_ydata()[-1])
    assert [ax.get_title() for ax in (grove, urban)] == ["grove2_A", "urban3_A"]
    verticals = {line.get_label(): line.get_xdata()[0] for line in urban.lines if len(line.get_xdata()) == 2}
    assert verticals == {"u-system alone: Jacobi diverges beyond": summary["limit"][1], "best in the paper": 1.5}
    curve = next(line for line in grove.lines if line.get_label() == "exact")
    part = made[(made["region"] == "grove2_A") & (made["u_solver"] == "exact")]
    np.testing.assert_allclose(curve.get_ydata(), part["aepe"])


def test_the_printed_alphas_are_of_six_regions():
    printed = printed_alphas()
    assert len(printed) == 6
    assert printed["hydrangea_B"] == {"lambda_sb": 10, "aae": 0.9, "aepe": 1}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, ": `options` must have size, alpha_step, tol, limit as well"),
        ({"size": 8, "alpha_step": 1, "tol": 1e-3}, ": `options` must have limit as well"),
        ({"size": 8, "alpha_step": 1, "tol": "small", "limit": 5}, ", options: `tol` must be a number"),
        ({"sizes": 3}, ", options: unknown key 'sizes': did you mean 'size'?"),
    ],
)
def test_options_of_the_study_are_checked(options, message):
    experiment = dataclasses.replace(load_experiment("solver_study"), options=options)
    with pytest.raises(InputError, match=re.escape(f"experiment solver_study{message}")):
        solver_study(experiment, None, {}, None)


# -- files -----------------------------------------------------------------------------------------


def small_plan(experiment):
    return plan_artefact(experiment, ["dataset=synthetic"], allow_download=False, small=True)


def test_the_protocol_study_leaves_its_files(tmp_path, fake_rows, unwritten):
    experiment = load_experiment("protocol_study")
    plan = small_plan(experiment)
    artefact = protocol_study(experiment, plan, fake_rows(plan), tmp_path)
    assert sorted(str(path.relative_to(tmp_path)) for path in artefact.files) == [
        "figures/protocol_study_synthetic_small.pdf",
        "figures/protocol_study_synthetic_small.png",
        "tables/protocol_study_synthetic_small.csv",
        "tables/protocol_study_synthetic_small.md",
    ]
    table = pd.read_csv(tmp_path / "tables/protocol_study_synthetic_small.csv")
    assert len(table) == len(experiment.grids) and table["distance"].isna().all()
    text = (tmp_path / "tables/protocol_study_synthetic_small.md").read_text()
    assert all(
        token in text for token in ("upsample_gain=0.5", "inner=cold, tol=0.1", "upsample_gain=0.5, max_iter=3")
    )


def test_the_solver_study_leaves_its_files(tmp_path, fake_rows, unwritten):
    options = {"size": 6, "alpha_step": 1.0, "tol": 1e-3, "limit": 20}
    experiment = dataclasses.replace(load_experiment("solver_study"), options=options)
    plan = small_plan(experiment)
    artefact = solver_study(experiment, plan, fake_rows(plan), tmp_path)
    stems = {
        "figures/solver_study_synthetic_small": ("pdf", "png"),
        "tables/solver_study_synthetic_small": ("csv", "md"),
    }
    stems |= {f"tables/solver_study_{kind}_synthetic_small": ("csv",) for kind in ("runs", "spectra")}
    expected = sorted(f"{stem}.{suffix}" for stem, suffixes in stems.items() for suffix in suffixes)
    assert sorted(str(path.relative_to(tmp_path)) for path in artefact.files) == expected
    table = pd.read_csv(tmp_path / "tables/solver_study_spectra_synthetic_small.csv")
    assert table["alpha"].tolist() == [0, 1, 2] * 2 and table["jacobi radius"].isna().all()  # of made-up rows
    runs = pd.read_csv(tmp_path / "tables/solver_study_runs_synthetic_small.csv")
    assert len(runs) + len(table) == len(plan.points)
    text = (tmp_path / "tables/solver_study_synthetic_small.md").read_text()
    assert all(line in text for line in artefact.lines) and "6 x 6 pixels" in text


def test_both_are_registered():
    assert registry.RENDERERS["protocol_study"] is protocol_study
    assert registry.RENDERERS["solver_study"] is solver_study
