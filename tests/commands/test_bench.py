"""The benchmark: its methods, its counts and its files; no test depends on a measured time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fracbench.commands.cli import main
from fracbench.data.files import write_image
from fracbench.errors import InputError
from fracbench.harness.config.paths import checkout
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.point import canonical_value
from fracbench.studies.race import figures, measure

SCENE = "sequence=synthetic_corner"


def test_all_that_is_installed_runs_by_default(monkeypatch):
    monkeypatch.setattr(measure, "_installed", lambda method: not method.startswith("skimage"))
    names = [contender.name for contender in measure.contenders()]
    assert names[:2] == ["tvl1", "tvl1_sb"] and "opencv_tvl1" in names and "skimage_tvl1" not in names
    for boundary in ("reflect", "zero"):
        for alpha in ("1", "1.2", "1.7"):
            assert f"tvl1_sb_alpha {boundary} alpha {alpha}" in names
    assert {"tvl1_sb_alpha_map 2 orders", "tvl1_sb_alpha_ic", "accurate", "fast"} < set(names)


def test_a_contender_may_bring_a_protocol(monkeypatch):
    seen = []
    preset = make_plan([SCENE, "protocol=accurate"]).points[0].point.canonical

    def estimate(frame0, frame1, params):
        seen.append({name: canonical_value(value) for name, value in params.as_dict().items() if name in preset})
        return SimpleNamespace(flow=np.zeros((2, *frame0.shape)))

    monkeypatch.setattr(measure, "get_method", lambda name: SimpleNamespace(compute=estimate))
    measure.run([measure.Contender("a", "any", protocol="accurate")], [SCENE], repeats=1, threads=1, on_lap=list)
    assert seen == [preset, preset]


def test_contenders_by_beginning_of_name():
    names = [contender.name for contender in measure.contenders(["tvl1_sb_alpha zero"])]
    assert names == [f"tvl1_sb_alpha zero alpha {alpha}" for alpha in ("1", "1.2", "1.7")]
    with pytest.raises(InputError, match=r"contender.*'tvl2'.*did you mean 'tvl1'"):
        measure.contenders(["tvl2"])


def test_a_race_gives_a_record_for_each_contender_and_sequence():
    laps = []
    racers = measure.contenders(["tvl1_sb_alpha reflect alpha 1.2", "tvl1_sb_alpha reflect alpha 1.7"])
    tokens = ["sequence=synthetic_corner,synthetic_rotation"]
    records = measure.run(racers, tokens, repeats=2, threads=1, on_lap=lambda: laps.append(1))
    assert len(records) == 4 and len(laps) == 8
    assert all(record["seconds"] > 0 and 0 < record["aepe"] < 1 for record in records)
    assert all(20_000 < record["n_pixels"] <= 128 * 160 for record in records)  # known truth and unknown


def test_the_summary_is_relative_to_the_yardstick():
    records = [
        {"contender": name, "sequence": s, "seconds": t, "aae": 0.1, "aepe": e}
        for name, s, t, e in [("a", 1, 2.0, 0.3), ("a", 2, 4.0, 0.5), ("y", 1, 8.0, 1), ("y", 2, 4.0, 1)]
    ]
    table = figures.summarise(records, "y").set_index("contender")
    assert table.loc["a", ["seconds", "ratio", "aepe"]].tolist() == [3.0, 0.5, 0.4]
    assert list(table.index) == ["a", "y"] and table.loc["y", "ratio"] == 1.0
    assert np.isnan(figures.summarise(records, "absent")["ratio"]).all()


def test_the_picture_names_every_contender_once_and_tells_ours_from_peers():
    names = ["opencv_dis", "tvl1_sb_alpha zero alpha 1.2", "accurate", "tvl1_sb_alpha zero alpha 1"]
    summary = pd.DataFrame({"contender": names, "seconds": [0.1, 0.2, 0.3, 0.4], "aepe": [1.0, 0.9, 0.8, 0.7]})
    (axes,) = figures.error_against_time(summary, "").axes
    drawn = {line.get_label(): (line.get_marker(), list(line.get_xdata())) for line in axes.lines}
    assert drawn == {
        "opencv_dis": ("s", [0.1]),
        "tvl1_sb_alpha zero, alpha 1, 1.2": ("o", [0.4, 0.2]),
        "accurate": ("o", [0.3]),
    }
    assert len({(line.get_marker(), line.get_color()) for line in axes.lines}) == 3


def test_the_command_writes_table_and_picture(tmp_path, capsys):
    results = f"paths.results={tmp_path}"
    assert main(["bench", SCENE, results, "--repeats", "1", "--only", "tvl1"]) == 0
    out = capsys.readouterr().out
    assert "tvl1_sb_alpha" in out and "ratio" not in out
    table = pd.read_csv(tmp_path / "runs" / "bench" / "bench_1_threads_some.csv")
    assert len(table) == 10 and (table["seconds"] > 0).all()
    assert (tmp_path / "runs" / "bench" / "bench_1_threads_some.png").stat().st_size > 1000


def test_pairs_of_ones_own_have_a_file_of_their_own(tmp_path):
    (tmp_path / "pairs/a").mkdir(parents=True)
    for i in range(2):
        write_image(tmp_path / f"pairs/a/frame{i}.png", np.eye(16, dtype=np.uint8) * 80)
    words = ["dataset=folder", f"paths.data={tmp_path / 'pairs'}", f"paths.results={tmp_path}"]
    assert main(["bench", *words, "--repeats", "1", "--only", "tvl1_sb_alpha_ic"]) == 0
    assert (tmp_path / "runs/bench/bench_1_threads_some_folder.csv").is_file()


@pytest.mark.parametrize("option", ["--repeats", "--threads"])
def test_numbers_below_one_are_refused(option, capsys):
    assert main(["bench", SCENE, option, "0"]) == 2
    assert "must be at least 1" in capsys.readouterr().err


@pytest.mark.parametrize("study", ["size", "jobs", "roofline"])
def test_a_study_names_the_script_that_it_has_become(study, capsys):
    assert main(["bench", "--study", study]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    script = line.partition("python ")[2].partition(",")[0]
    assert (checkout() / script).is_file()
