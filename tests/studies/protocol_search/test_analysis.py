"""What a search tells: on studies whose answer is known."""

import itertools
import math

import numpy as np
import pytest

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import make_plan
from fracbench.studies.protocol_search import analysis
from fracbench.studies.protocol_search.artefact import printed_numbers, questions, tellings
from fracbench.studies.protocol_search.picture import value_grid
from fracbench.studies.protocol_search.records import NUMBERS, Trial
from fracbench.studies.protocol_search.space import settings_of

pytest.importorskip("optuna")

GRID = ("protocol=published", "sequence=synthetic_edge,synthetic_flat", "method=tvl1", "lambda_sb=10")
SEQUENCES = ["synthetic_edge", "synthetic_flat"]
SPACE = {
    "shared": {
        "n_warps": [1, 2, 4],  # trades off with max_iter: their product should be 4
        "max_iter": [1, 2, 4],
        "warp": ["bicubic", "bilinear"],  # told: bilinear is far off
        "stencil": ["central", "forward"],  # open: no difference
        "intensity": ["joint", "each"],  # likely: each is farther by a tenth
    },
    "tvl1": {"tau": [0.1, 0.2, 0.25]},  # the first suits one sequence, the second the other, the last both fairly
}


def studied():
    options = {"space": SPACE, "stages": [{"methods": ["tvl1"], "trials": 1, "seeds": {"tpe": [1]}}]}
    plan = make_plan(GRID)
    return settings_of(Experiment("s", "S", "protocol_search", {"main": GRID}, options), plan), plan


def log_of(values, sequence):
    off = 0.3 * abs(math.log(values["n_warps"] * values["max_iter"] / 4.0)) + 0.3 * (values["warp"] == "bilinear")
    tau = {0.1: (0.02, 0.2), 0.2: (0.2, 0.02), 0.25: (0.05, 0.05)}[values["tvl1.tau"]]
    return (tau[SEQUENCES.index(sequence)] + off) * (1.4 if values["intensity"] == "each" else 1.0)


def planted(settings, but=lambda values: False):
    """Return a trial for each configuration; the SDAE of the edge is never met; some end after the flat scene."""
    names = [switch.name for switch in settings.switches]
    trials = []
    for number, chosen in enumerate(itertools.product(*(switch.values for switch in settings.switches))):
        values = dict(zip(names, chosen, strict=True))
        if but(values):
            continue
        logs = {("tvl1", sequence, n): log_of(values, sequence) for sequence in SEQUENCES for n in NUMBERS}
        logs["tvl1", "synthetic_edge", "sdae"] = -0.2
        trials.append(Trial("tvl1", "1-tvl1-tpe-1", number, values, logs, stopped=False))
    return trials


def test_switches_are_told_likely_or_open_as_planted():
    settings, _ = studied()
    asked = analysis.question(planted(settings), settings, ["tvl1"])
    assert len(asked.places) == 3 * 3 * 2 * 2 * 2 * 3 and asked.whole.all()
    table = analysis.switch_table(asked).set_index("switch")
    assert dict(table["verdict"]) == {
        "warp": "told", "tvl1.tau": "told", "intensity": "likely", "n_warps": "open", "max_iter": "open",
        "stencil": "open",
    }  # fmt: skip
    assert asked.least == pytest.approx(math.sqrt((5 * 0.05**2 + 0.2**2) / 6))
    each = math.sqrt((5 * 0.07**2 + 0.2**2) / 6)
    assert table.loc["intensity", "least distance with another"] == pytest.approx(each)
    assert table.loc["stencil", "not excluded"] == "central, forward"
    assert table.loc["warp", "not excluded"] == "bicubic" and table.loc["warp", "excluded"] == 1
    assert table["importance"].sum() == pytest.approx(1.0)
    assert table["importance"].idxmax() == "warp"
    assert table.loc["stencil", "importance"] == pytest.approx(0.0, abs=1e-6)


def test_shares_and_least_distances_of_values():
    settings, _ = studied()
    trials = planted(settings, but=lambda values: values["max_iter"] == 4 and values["n_warps"] != 1)
    asked = analysis.question(trials, settings, ["tvl1"])
    table = analysis.value_table(asked).set_index(["switch", "value"])
    tried = len(asked.places)
    assert tried == 24 * (9 - 2)
    assert table.loc[("max_iter", "4"), "tried"] == 24
    assert table.loc[("max_iter", "4"), "share of tried"] == pytest.approx(24 / tried)
    assert len(asked.best) == math.ceil(0.01 * tried) == 2
    for switch in ("warp", "n_warps"):
        assert table.loc[switch]["share of best"].sum() == pytest.approx(1.0)
    assert table.loc[("warp", "bicubic"), "share of best"] == 1.0
    for trial in trials:  # by hand
        value = str(trial.values["n_warps"])
        assert table.loc[("n_warps", value), "least distance"] <= trial.distance + 1e-12
    found = min(trial.distance for trial in trials if trial.values["warp"] == "bilinear")
    assert table.loc[("warp", "bilinear"), "least distance"] == pytest.approx(found)


def test_a_value_that_no_whole_run_has_is_infinitely_far():
    settings, _ = studied()
    trials = []
    for trial in planted(settings):
        if trial.values["warp"] == "bilinear":
            first = {number: log for number, log in trial.logs.items() if number[1] == "synthetic_edge"}
            trial = Trial("tvl1", trial.study, trial.number, trial.values, first, stopped=True)
        trials.append(trial)
    asked = analysis.question(trials, settings, ["tvl1"])
    table = analysis.value_table(asked).set_index(["switch", "value"])
    assert table.loc[("warp", "bilinear"), "least distance"] == math.inf
    assert table.loc[("warp", "bilinear"), "tried"] == 108
    assert analysis.switch_table(asked).set_index("switch").loc["warp", "verdict"] == "told"
    twice = analysis.question([*trials, *planted(settings)], settings, ["tvl1"])
    assert len(twice.places) == 216 and twice.whole.all()  # the trial that was computed further counts


def test_pairs_trade_off_as_planted_and_no_others():
    settings, _ = studied()
    asked = analysis.question(planted(settings), settings, ["tvl1"])
    table = analysis.pair_table(asked)
    assert list(zip(table["switch"], table["other switch"], strict=True)) == [("n_warps", "max_iter")]
    row = table.iloc[0]
    assert int(row["value"]) * int(row["other value"]) == 4
    assert row["both"] == pytest.approx(asked.least)
    start = asked.values(asked.order[0])

    def least(**wanted):
        values = {**start, **wanted}
        logs = [log_of(values, s) for s in SEQUENCES for _ in NUMBERS]
        logs[0] = -0.2
        return float(np.sqrt(np.mean(np.square(logs))))

    alone = least(n_warps=int(row["value"])), least(max_iter=int(row["other value"]))
    assert (row["first alone"], row["other alone"]) == pytest.approx(alone)
    assert row["gain"] == pytest.approx(math.log(min(alone) / asked.least))


def test_the_run_chosen_on_one_half_is_measured_on_the_other():
    settings, _ = studied()
    asked = analysis.question(planted(settings), settings, ["tvl1"])
    table = analysis.half_table(asked, SEQUENCES, settings.usual)
    assert list(table["chosen on"]) == SEQUENCES
    on_edge = math.sqrt((2 * 0.02**2 + 0.2**2) / 3)  # tau = 0.1, and the SDAE that nothing meets
    assert table["distance there"].tolist() == pytest.approx([on_edge, 0.02])
    on_flat = math.sqrt((2 * 0.2**2 + 0.2**2) / 3)
    assert table["distance on the others"].tolist() == pytest.approx([0.2, on_flat])
    assert table["least on the others"].tolist() == pytest.approx([0.02, on_edge])
    assert table["ratio"].tolist() == pytest.approx([0.2 / on_edge, on_flat / 0.02])
    assert table["grid's run on the others"].isna().all()  # n_warps=5 is not among the values
    grid = {**settings.usual, "n_warps": 2, "max_iter": 2, "tvl1.tau": 0.25}
    usual = analysis.half_table(asked, SEQUENCES, grid)["grid's run on the others"]
    assert usual.tolist() == pytest.approx([0.05, math.sqrt((2 * 0.05**2 + 0.2**2) / 3)])


def test_numbers_that_no_run_explains_are_named_with_their_floor():
    settings, plan = studied()
    asked = analysis.question(planted(settings), settings, ["tvl1"])
    printed = printed_numbers(plan)
    table = analysis.number_table(asked, printed).set_index(["sequence", "metric"])
    never = table.loc[("synthetic_edge", "sdae")]
    assert not never["explained"] and never["floor"] == pytest.approx(math.exp(0.2))
    assert never["best run"] == pytest.approx(printed["tvl1", "synthetic_edge", "sdae"] * math.exp(-0.2))
    others = table.drop(index=("synthetic_edge", "sdae"))
    assert not others["explained"].any()  # the best run is at exp(0.05), just outside 5 %
    assert others["floor"].to_numpy() == pytest.approx(math.exp(0.02))
    switches = analysis.switch_table(asked)
    lines = tellings(asked, switches, analysis.half_table(asked, SEQUENCES, settings.usual), table.reset_index())
    assert lines[0].startswith(f"The nearest run is at a distance of {asked.least:.4f}: of 6 numbers 0 are within")
    assert "warp=bicubic" in lines[1] and "tvl1.tau=0.25" in lines[1]
    assert "synthetic_edge tvl1 SDAE" in lines[-1]


def test_a_question_takes_the_switches_and_numbers_of_its_methods():
    grid = [*GRID[:2], "method=tvl1,tvl1_sb", GRID[3]]
    space = {"shared": {"n_warps": [1, 2]}, "tvl1": {"tau": [0.1, 0.2]}, "tvl1_sb": {"tol": [0.1, 0.2]}}
    stages = [
        {"methods": ["tvl1"], "trials": 1, "seeds": {"tpe": [1]}},
        {"methods": ["tvl1", "tvl1_sb"], "trials": 1, "seeds": {"tpe": [1]}},
    ]
    plan = make_plan(grid)
    options = {"space": space, "stages": stages}
    settings = settings_of(Experiment("s", "S", "protocol_search", {"main": grid}, options), plan)

    def trial(number, tau, tol, log):
        values = {"n_warps": 1, "tvl1.tau": tau, "tvl1_sb.tol": tol}
        logs = {(m, s, n): log for m in ("tvl1", "tvl1_sb") for s in SEQUENCES for n in NUMBERS}
        return Trial("tvl1+tvl1_sb", "2", number, values, logs, stopped=False)

    alone = {("tvl1", s, n): 0.3 for s in SEQUENCES for n in NUMBERS}
    trials = [
        Trial("tvl1", "1", 0, {"n_warps": 2, "tvl1.tau": 0.2}, alone, stopped=False),
        trial(0, 0.1, 0.1, 0.1), trial(1, 0.1, 0.2, 0.1), trial(2, 0.2, 0.1, 0.2),
    ]  # fmt: skip
    asked = questions(trials, settings)
    assert {name: len(each.places) for name, each in asked.items()} == {"tvl1": 3, "tvl1+tvl1_sb": 3}
    assert [switch.name for switch in asked["tvl1"].switches] == ["n_warps", "tvl1.tau"]
    assert len(asked["tvl1"].numbers) == 6 and len(asked["tvl1+tvl1_sb"].numbers) == 12


def test_the_picture_has_a_row_for_each_switch():
    settings, _ = studied()
    asked = analysis.question(planted(settings), settings, ["tvl1"])
    fig = value_grid(analysis.switch_table(asked), analysis.value_table(asked), asked.least)
    left = fig.axes[0]
    assert sorted(label.get_text() for label in left.get_yticklabels()) == sorted(
        s.name for s in settings.switches
    )
    assert sum(len(switch.values) for switch in settings.switches) == len(left.texts)
