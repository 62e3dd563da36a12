"""The search for the run behind Table 2: its order, its resumption, and its configurations."""

import gzip
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

from fracbench.commands.cli import main
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import STORE, Row, Store
from fracbench.report import sources
from fracbench.report.sources import COMMITTED
from fracbench.studies.paper.table2 import distance
from fracbench.studies.protocol_search.artefact import printed_numbers
from fracbench.studies.protocol_search.records import Trial, TrialTable, compressed
from fracbench.studies.protocol_search.search import best_values, run_search, take_over
from fracbench.studies.protocol_search.space import settings_of

pytest.importorskip("optuna")

GRID = ("protocol=published", "sequence=synthetic_edge,synthetic_flat", "method=tvl1,tvl1_sb", "lambda_sb=10")
SPACE = {
    "shared": {"n_warps": [1, 2, 3, 5], "max_iter": [1, 2, 3], "warp": ["bicubic", "bilinear"], "margin": [0, 4]},
    "tvl1": {"tau": [0.05, 0.1, 0.2, 0.25]},
    "tvl1_sb": {"tol": [0.01, 0.1], "lambda_l": [None, 3]},
}
STAGES = [
    {"methods": ["tvl1"], "trials": 130, "seeds": {"tpe": [1]}},
    {"methods": ["tvl1_sb"], "given": 3, "trials": 15, "seeds": {"tpe": [2]}},
    {"methods": ["tvl1", "tvl1_sb"], "trials": 60, "seeds": {"nsga2": [3]}},
]
PLANTED = {"n_warps": 3, "max_iter": 2, "warp": "bilinear", "tau": 0.2, "tol": 0.1, "lambda_l": 3.0}


def settings(**options):
    """Return the settings of a small search; whatever is within 0.9 runs to its end."""
    usual = {"space": SPACE, "stages": STAGES, "first": ["synthetic_flat"], "stop_above": 0.9, "stop_within": 1e9}
    options = {**usual, **options}
    plan = make_plan(GRID)
    return settings_of(Experiment("s", "S", "protocol_search", {"main": GRID}, options), plan), plan


def table(chosen, folder):
    return TrialTable(folder / "trials.csv", chosen)


class Pretended:
    """Rows whose errors are off by a factor that grows with the number of switches that are not as planted."""

    def __init__(self, plan, dies_after=None, least=0.0):
        self.printed = printed_numbers(plan)
        self.rows, self.calls, self._dies_after, self._least = {}, 0, dies_after, least

    def __call__(self, points):
        for key, point in points.items():
            if key in self.rows:
                continue
            self.calls += 1
            if self.calls == self._dies_after:
                raise KeyboardInterrupt
            used = {name: value for name, value in vars(point.params).items() if name in PLANTED}
            if point.method == "tvl1":
                used = {name: used[name] for name in ("n_warps", "max_iter", "warp", "tau")}
            else:
                used.pop("tau")
            off = sum(PLANTED[name] != value for name, value in used.items()) + (point.context != 0)
            found = {
                metric: self.printed[point.method, f"synthetic_{point.sequence}", metric]
                * np.exp(0.3 * off + self._least)
                for metric in ("aae", "aepe", "sdae")
            }
            self.rows[key] = Row(key=key, identity="", spec={}, solver_version=2, status="done", result=found)
        return {key: self.rows[key] for key in points}


def test_the_search_finds_what_was_planted_stage_by_stage(tmp_path):
    chosen, plan = settings()
    trials = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan))
    assert [sum(trial.stage == name for trial in trials) for name in ("tvl1", "tvl1_sb", "tvl1+tvl1_sb")] == [
        130, 15, 60
    ]  # fmt: skip
    for stage in ("tvl1", "tvl1_sb", "tvl1+tvl1_sb"):
        assert min(trial.distance for trial in trials if trial.stage == stage) == pytest.approx(0.0, abs=1e-5)
    best = min(trials, key=lambda trial: (trial.distance, -len(trial.logs)))
    assert {name.rpartition(".")[2]: value for name, value in best.values.items()} == {**PLANTED, "margin": 0}
    best_three = best_values([trial for trial in trials if trial.stage == "tvl1"])[:3]
    given = {tuple(sorted(values.items())) for values in best_three}
    for trial in trials:
        if trial.stage == "tvl1_sb":
            shared = {n: v for n, v in trial.values.items() if not n.startswith("tvl1_sb.")}
            assert tuple(sorted(shared.items())) in given
    assert table(chosen, tmp_path).read() == trials


def test_a_search_from_its_seed_is_the_same_study_and_an_interrupted_one_goes_on_as_if_it_had_not_been(tmp_path):
    chosen, plan = settings()
    whole = run_search(chosen, table(chosen, made(tmp_path / "a")), printed_numbers(plan), Pretended(plan))
    again = run_search(chosen, table(chosen, made(tmp_path / "b")), printed_numbers(plan), Pretended(plan))
    assert again == whole
    compute = Pretended(plan, dies_after=9)
    with pytest.raises(KeyboardInterrupt):
        run_search(chosen, table(chosen, made(tmp_path / "c")), printed_numbers(plan), compute)
    assert table(chosen, tmp_path / "c").read() == []  # no part of a batch is kept
    run_search(chosen, table(chosen, tmp_path / "c"), printed_numbers(plan), compute, budget=50)
    assert len(table(chosen, tmp_path / "c").read()) == 60  # in whole batches
    with table(chosen, tmp_path / "c").path.open("a") as file:
        file.write("tvl1,1-tvl1-t")  # as a power failure would leave it
    assert run_search(chosen, table(chosen, tmp_path / "c"), printed_numbers(plan), compute) == whole
    other = replace(chosen, stages=(replace(chosen.stages[0], seeds={"tpe": [4]}),))
    assert (
        run_search(other, table(other, made(tmp_path / "d")), printed_numbers(plan), Pretended(plan))
        != whole[:130]
    )


def made(folder):
    folder.mkdir()
    return folder


def test_a_configuration_that_is_far_off_ends_early(tmp_path):
    chosen, plan = settings(stop_above=0.5)
    trials = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan, least=0.02))
    assert {trial.stopped for trial in trials} == {False, True}
    for trial in trials:
        methods = trial.stage.split("+")
        steps = [(sequence, m) for m in methods for sequence in ("synthetic_flat", "synthetic_edge")]
        found = list(dict.fromkeys((sequence, method) for method, sequence, _ in trial.logs))
        assert found == steps[: len(found)]
        assert trial.stopped == (len(found) < len(steps))
        for count in range(1, len(steps)):
            mine = [
                log for (method, sequence, _), log in trial.logs.items() if (sequence, method) in steps[:count]
            ]
            ends = distance(np.exp(mine)) > 0.5 * (len(steps) / count) ** 0.25
            assert count >= len(found) or not ends
            if count == len(found):
                assert ends
        assert trial.distance == pytest.approx(distance(np.exp(list(trial.logs.values()))), abs=1e-9)


def test_the_best_settings_are_those_of_all_studies_in_turn():
    def trial(study, number, size, **values):
        return Trial("tvl1", study, number, values, {("tvl1", "venus", "aae"): size}, stopped=size > 0.5)

    trials = [
        trial("a", 0, 0.1, x=1), trial("a", 1, 0.12, x=2), trial("a", 2, 0.9, x=3), trial("a", 3, 0.11, x=4),
        trial("b", 0, 0.3, x=5), trial("b", 1, 0.1, x=1), trial("b", 2, 0.2, x=6),
    ]  # fmt: skip
    assert [values["x"] for values in best_values(trials)] == [1, 6, 4, 5, 2]


def test_the_limit_follows_the_best_of_the_study(tmp_path):
    chosen, plan = settings(stop_above=5.0, stop_within=1.5, stages=STAGES[:1], batch=10)
    trials = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan, least=0.1))
    for first in range(0, len(trials), 10):
        whole = [trial.distance for trial in trials[:first] if not trial.stopped]
        limit = min([5.0, *(1.5 * distance for distance in whole)]) * 2**0.25
        for trial in trials[first : first + 10]:
            assert trial.stopped == (trial.distance > limit)
    assert any(trial.stopped for trial in trials)


def test_trials_that_optuna_would_not_propose_are_refused(tmp_path):
    chosen, plan = settings(stages=STAGES[:1])
    kept = table(chosen, tmp_path)
    trials = run_search(chosen, kept, printed_numbers(plan), Pretended(plan), budget=20)
    trials[3] = replace(trials[3], values={**trials[3].values, "tvl1.tau": 0.05, "n_warps": 1, "max_iter": 1})
    kept.path.write_text(kept.text(trials))
    with pytest.raises(InputError, match="is not what this release of Optuna proposes"):
        run_search(chosen, kept, printed_numbers(plan), Pretended(plan))


def test_the_table_gives_the_trials_back_compressed_or_not(tmp_path):
    chosen, plan = settings(stop_above=0.5)
    kept = table(chosen, tmp_path)
    trials = run_search(chosen, kept, printed_numbers(plan), Pretended(plan, least=0.02))
    packed = TrialTable(tmp_path / "t.csv.gz", chosen)
    packed.path.write_bytes(compressed(kept.text(trials)))
    assert kept.read() == packed.read() == trials
    assert compressed(kept.text(trials)) == packed.path.read_bytes()
    kept.path.write_text(kept.path.read_text().replace("bilinear", "trilinear"))
    with pytest.raises(InputError, match=r"trials\.csv: is no table of a search's trials"):
        kept.read()
    kept.path.write_text("a,b\n")
    with pytest.raises(InputError, match=r"trials\.csv: holds a search with other settings"):
        kept.read()


def test_neighbours_reach_what_was_planted_one_switch_at_a_time(tmp_path):
    stages = [{"methods": ["tvl1", "tvl1_sb"], "trials": 100, "begin": [{}], "seeds": {"neighbours": [1]}}]
    chosen, plan = settings(stages=stages, stop_above=9.0, batch=7)
    trials = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan, least=0.02))
    first = trials[0].values
    assert first["n_warps"] == 5 and first["max_iter"] == 3 and first["tvl1.tau"] == 0.25  # the protocol's
    for trial in trials[1:13]:
        assert sum(trial.values[name] != value for name, value in first.items()) == 1
    best = min(trials, key=lambda trial: trial.distance)
    assert best.distance == pytest.approx(0.02) and best.values["tvl1.tau"] == PLANTED["tau"]
    assert len({trial.configuration for trial in trials}) == len(trials)
    again = run_search(
        chosen, table(chosen, made(tmp_path / "b")), printed_numbers(plan), Pretended(plan, least=0.02)
    )
    assert again == trials


def test_neighbours_of_a_small_space_are_repeated(tmp_path):
    space = {"shared": {"warp": ["bilinear", "bicubic"]}, "tvl1": {"tau": [0.1, 0.25]}}
    stages = [{"methods": ["tvl1"], "trials": 7, "begin": [{}], "seeds": {"neighbours": [5]}}]
    chosen, plan = settings(stages=stages, space=space, batch=3, stop_above=9.0)
    trials = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan))
    assert len(trials) == 7 and len({trial.configuration for trial in trials}) == 4


def test_a_point_that_failed_is_far_from_the_table(tmp_path):
    chosen, plan = settings(stages=[{**STAGES[0], "trials": 2}])

    def compute(points):
        return {key: Row(key=key, identity="", spec={}, solver_version=2, status="failed") for key in points}

    for trial in run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), compute):
        assert trial.stopped and trial.distance == pytest.approx(np.log(100.0), abs=1e-4)


def test_the_first_configurations_are_those_that_are_named(tmp_path):
    stages = [{**STAGES[0], "trials": 2, "begin": [{}, {"tvl1.tau": 0.1, "warp": "bilinear"}]}]
    space = {"shared": {"n_warps": [3, 5], "warp": ["bilinear", "bicubic"]}, "tvl1": {"tau": [0.1, 0.25]}}
    chosen, plan = settings(stages=stages, space=space)
    first, second = run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan))
    assert first.values == {"n_warps": 5, "warp": "bicubic", "tvl1.tau": 0.25}  # the protocol's
    assert second.values == {"n_warps": 5, "warp": "bilinear", "tvl1.tau": 0.1}


def test_points_differ_from_the_grids_by_the_values_that_their_method_uses():
    chosen, _ = settings()
    base = chosen.points["tvl1_sb", "synthetic_flat"]
    values = {"n_warps": 2, "tvl1.tau": 0.1, "tvl1_sb.lambda_l": 3, "margin": 4, "score": "unknown_as_zero"}
    point = chosen.point("tvl1_sb", "synthetic_flat", values)
    words = (
        "sequence=synthetic_flat method=tvl1_sb lambda_sb=10 n_warps=2 lambda_l=3 margin=4 score=unknown_as_zero"
    )
    planned = make_plan(["protocol=published", *words.split()])
    assert point.key == planned.points[0].point.key != base.key
    assert chosen.point("tvl1_sb", "synthetic_flat", {"tvl1.tau": 0.1}).key == base.key


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"space": {"shared": {"n_warp": [1]}}}, "did you mean 'n_warps'"),
        ({"space": {"tvl": {"tau": [0.1]}}}, "did you mean 'tvl1'"),
        ({"space": {"shared": {"n_warps": [0, 1]}}}, "`n_warps` must be at least 1, got 0"),
        ({"space": {"shared": {"n_warps": [2, 2]}}}, "a list of different values"),
        ({"space": {"shared": [1]}}, "lists of values by switch"),
        ({"stages": []}, "needs `stages`"),
        ({"stages": [{"methods": ["tvl1_sb"], "trials": 5, "given": 2}]}, "the first stage has nothing"),
        ({"stages": [{"methods": ["tvl2"], "trials": 5}]}, "did you mean 'tvl1'"),
        ({"stages": [{"methods": ["tvl1"], "trials": 0}]}, "`trials` of at least 1"),
        ({"stages": [{"methods": ["tvl1"], "trials": 5, "seeds": {"tp": [1]}}]}, "unknown sampler 'tp'"),
        ({"stages": [{"methods": ["tvl1"], "trials": 5, "seeds": {"tpe": 1}}]}, "a list of whole numbers"),
        ({"stages": [{**STAGES[0], "begin": [{"n_warps": 4}]}]}, "n_warps=4 is not among the values"),
        ({"stages": [{**STAGES[0], "begin": [{"n_warp": 4}]}]}, "did you mean 'n_warps'"),
        ({"stages": [STAGES[0], {**STAGES[1], "seeds": {"neighbours": [1]}}]}, "by neighbours has no `given`"),
        ({"stop_within": 0.9}, "'stop_within' at least 1"),
        ({"batch": 0}, "'batch' must be at least 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        settings(**options)


def test_other_settings_do_not_go_on_with_the_same_journal(tmp_path):
    chosen, plan = settings(stages=STAGES[:1])
    run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan), budget=20)
    other, _ = settings(stages=STAGES[:1], stop_above=0.2)
    with pytest.raises(InputError, match=r"trials\.csv: 1-tvl1-tpe-1 has other settings; move the table away"):
        run_search(other, table(other, tmp_path), printed_numbers(plan), Pretended(plan))


@pytest.fixture
def small_search(tmp_path, monkeypatch):
    """A working folder with a search of six configurations on one rendered scene."""
    monkeypatch.chdir(tmp_path)
    stages = [{"methods": ["tvl1"], "trials": 6, "seeds": {"tpe": [1]}, "begin": [{}]}]
    options = {"space": {"shared": {"max_iter": [1, 2, 3], "n_warps": [1, 5]}}, "stages": stages, "batch": 3}
    grid = ["protocol=published", "sequence=synthetic_edge", "method=tvl1"]
    made(tmp_path / "experiments")
    text = yaml.safe_dump({"title": "T", "artefact": "protocol_search", "grid": grid, "options": options})
    (tmp_path / "experiments" / "mine.yaml").write_text(text)
    return tmp_path


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_the_command_computes_each_point_once_and_writes_the_same_files_again(small_search, capsys, jobs):
    command = ["experiment", "mine", "--jobs", jobs]
    assert main(command) == 0
    tables = small_search / "results" / "tables"
    files = {path: path.read_bytes() for path in tables.iterdir()}
    parts = [f"mine_{part}.csv" for part in ("halves", "numbers", "pairs", "switches", "values")]
    assert {path.name for path in files} == {"mine.csv", "mine.md", *parts, "mine_trials.csv.gz"}
    assert (small_search / "results" / "figures" / "mine.png").exists()
    assert len(gzip.decompress(files[tables / "mine_trials.csv.gz"]).splitlines()) == 7
    with Store(small_search / "results" / STORE, readonly=True) as store:
        rows = store.rows()
    assert 2 <= len(rows) <= 6  # of six possible configurations, some proposed twice
    assert main(command) == 0
    assert {path: path.read_bytes() for path in files} == files
    with Store(small_search / "results" / STORE, readonly=True) as store:
        assert store.rows() == rows
    assert main([*command, "--dry-run"]) == 0
    assert "search: 6 configurations of 2 switches, 6 done" in capsys.readouterr().out


def test_a_search_goes_on_from_the_committed_trials(small_search, monkeypatch, capsys):
    command = ["experiment", "mine", "--jobs", "1"]
    assert main(command) == 0
    results = small_search / "results"
    first = (results / "tables" / "mine_trials.csv.gz").read_bytes()
    committed = small_search / "checkout" / COMMITTED / "tables"
    committed.mkdir(parents=True)
    rows = gzip.decompress(first).decode().splitlines(keepends=True)
    (committed / "mine_trials.csv.gz").write_bytes(compressed("".join(rows[:4])))  # the first of two batches
    monkeypatch.setattr(sources, "checkout", lambda: small_search / "checkout")
    results.rename(small_search / "moved")
    capsys.readouterr()
    assert main(command) == 0
    assert "3 configurations taken from" in capsys.readouterr().err
    assert (results / "tables" / "mine_trials.csv.gz").read_bytes() == first


def test_trials_of_other_settings_are_not_taken_over(tmp_path):
    chosen, plan = settings()
    run_search(chosen, table(chosen, tmp_path), printed_numbers(plan), Pretended(plan), budget=140)
    kept = table(chosen, tmp_path).path
    other, _ = settings(stages=[STAGES[0], {**STAGES[1], "given": 2}])
    new = TrialTable(tmp_path / "new.csv", other)
    assert take_over(new, kept, other) == 130 and {trial.stage for trial in new.read()} == {"tvl1"}
    smaller, _ = settings(space={**SPACE, "tvl1": {"tau": [0.1, 0.25]}})
    new = TrialTable(tmp_path / "newer.csv", smaller)
    assert take_over(new, kept, smaller) == 0 and not new.path.exists()


def test_without_optuna_one_line_says_so(small_search, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert main(["experiment", "mine", "--jobs", "1"]) == 2
    assert "fracbench: a search needs Optuna: pip install 'fracbench[search]'\n" in capsys.readouterr().err
