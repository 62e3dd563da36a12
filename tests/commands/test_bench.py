"""The benchmark: who runs, what is counted, what is written. No test asks how long anything takes."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fracbench import estimate_flow
from fracbench.commands.cli import main
from fracbench.errors import InputError
from fracbench.harness import growth
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.point import canonical_value
from fracbench.harness.run.provenance import array_bytes
from fracbench.studies.race import figures as benchmark
from fracbench.studies.race import measure as bench

SCENE = "sequence=synthetic_corner"


def test_all_that_is_installed_runs_by_default(monkeypatch):
    monkeypatch.setattr(bench, "_installed", lambda method: not method.startswith("skimage"))
    names = [contender.name for contender in bench.contenders()]
    assert names[:2] == ["tvl1", "tvl1_sb"] and "opencv_tvl1" in names and "skimage_tvl1" not in names
    for boundary in ("reflect", "zero"):
        for alpha in ("1", "1.2", "1.7"):
            assert f"tvl1_sb_alpha {boundary} alpha {alpha}" in names
    assert {"tvl1_sb_alpha_map 2 orders", "accurate"} < set(names)


def test_a_contender_may_bring_a_protocol(monkeypatch):
    seen = []
    preset = make_plan([SCENE, "protocol=accurate"]).points[0].point.canonical

    def estimate(frame0, frame1, params):
        seen.append({name: canonical_value(value) for name, value in params.as_dict().items() if name in preset})
        return SimpleNamespace(flow=np.zeros((2, *frame0.shape)))

    monkeypatch.setattr(bench, "get_method", lambda name: SimpleNamespace(estimate=estimate))
    bench.run([bench.Contender("a", "any", protocol="accurate")], [SCENE], repeats=1, threads=1)
    assert seen == [preset, preset]


def test_contenders_by_beginning_of_name():
    names = [contender.name for contender in bench.contenders(["tvl1_sb_alpha zero"])]
    assert names == [f"tvl1_sb_alpha zero alpha {alpha}" for alpha in ("1", "1.2", "1.7")]
    with pytest.raises(InputError, match=r"contender.*'tvl2'.*did you mean 'tvl1'"):
        bench.contenders(["tvl2"])


def test_a_race_gives_a_record_for_each_contender_and_sequence():
    laps = []
    racers = bench.contenders(["tvl1_sb_alpha reflect alpha 1.2", "tvl1_sb_alpha reflect alpha 1.7"])
    tokens = ["sequence=synthetic_corner,synthetic_rotation"]
    records = bench.run(racers, tokens, repeats=2, threads=1, on_lap=lambda: laps.append(1))
    assert len(records) == 4 and len(laps) == 8
    assert all(record["seconds"] > 0 and 0 < record["aepe"] < 1 for record in records)
    assert all(20_000 < record["n_pixels"] <= 128 * 160 for record in records)  # known truth and unknown


def test_the_summary_is_relative_to_the_yardstick():
    records = [
        {"contender": name, "sequence": s, "seconds": t, "aae": 0.1, "aepe": e, "peak_mib": m}
        for name, s, t, e, m in [
            ("a", 1, 2.0, 0.3, 5),
            ("a", 2, 4.0, 0.5, 9),
            ("y", 1, 8.0, 1, 1),
            ("y", 2, 4.0, 1, 1),
        ]
    ]
    table = benchmark.summarise(records, "y").set_index("contender")
    assert table.loc["a", ["seconds", "ratio", "aepe", "peak_mib"]].tolist() == [3.0, 0.5, 0.4, 9]
    assert list(table.index) == ["a", "y"] and table.loc["y", "ratio"] == 1.0
    assert np.isnan(benchmark.summarise(records, "absent")["ratio"]).all()


def test_the_picture_names_every_contender_once_and_tells_ours_from_peers():
    names = ["opencv_dis", "tvl1_sb_alpha zero alpha 1.2", "accurate", "tvl1_sb_alpha zero alpha 1"]
    summary = pd.DataFrame({"contender": names, "seconds": [0.1, 0.2, 0.3, 0.4], "aepe": [1.0, 0.9, 0.8, 0.7]})
    (axes,) = benchmark.error_against_time(summary, "").axes
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
    assert len(table) == 9 and (table["seconds"] > 0).all()
    assert (tmp_path / "runs" / "bench" / "bench_1_threads_some.png").stat().st_size > 1000


def test_growth_reports_every_size(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(growth, "SHAPES", ((40, 48), (60, 64)))
    assert main(["bench", "--study", "size", "--repeats", "1", f"paths.results={tmp_path}"]) == 0
    assert "bytes_per_pixel" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "runs" / "bench" / "size_2_threads.csv")
    assert table[["boundary", "height", "width"]].values.tolist() == [
        ["reflect", 40, 48], ["reflect", 60, 64], ["zero", 40, 48],
    ]  # fmt: skip
    np.testing.assert_allclose(table["us_per_pixel"], 1e6 * table["seconds"] / table["height"] / table["width"])


def test_a_flow_takes_no_more_memory_than_is_told():
    frames = growth.texture_pair((240, 320))
    estimate = partial(estimate_flow, *frames, boundary="reflect", **growth.FIXED)
    estimate()
    assert array_bytes(estimate) / (240 * 320) < 120.5


def test_bytes_are_those_of_the_arrays_that_live_at_once():
    def work():
        first = np.zeros(10**6, np.uint8)
        del first
        np.zeros(3 * 10**6, np.uint8)

    assert array_bytes(work) == pytest.approx(3 * 10**6, rel=0.01)


def test_the_roofline_counts_flops_and_bytes(monkeypatch, tmp_path):
    monkeypatch.setattr(growth, "SHAPES", ((32, 64), (64, 64)))
    assert main(["bench", "--study", "roofline", "--repeats", "1", f"paths.results={tmp_path}"]) == 0
    row = pd.read_csv(tmp_path / "runs" / "bench" / "roofline.csv").iloc[1]
    assert row["mflop"] == pytest.approx(2e-6 * 64 * 64 * (14 * 2.5 * 6 + 90))  # log2(64) = 6 along both axes
    assert row["mbyte"] == pytest.approx(4e-6 * 64 * 64 * 113)
    assert row["ms_by_bytes"] == pytest.approx(row["mbyte"] / row["gbyte_s"]) and row["ms"] > 0


def test_jobs_compare_whole_sweeps(tmp_path):
    sweep = [SCENE, "alpha=1,1.2,1.4", "n_scales=1", "n_warps=1", "max_iter=1", "method=tvl1_sb_alpha"]
    command = ["bench", *sweep, "--study", "jobs", "--repeats", "1", f"paths.results={tmp_path}"]
    assert main(command) == 0
    row = pd.read_csv(tmp_path / "runs" / "bench" / "jobs_2.csv").iloc[0]
    assert (row["points"], row["jobs"]) == (3, 2) and row["overhead_ms"] > 0
    assert row["speed_up"] == pytest.approx(row["seconds_1"] / row["seconds_n"])


def test_the_texture_moves_as_it_says():
    frame0, frame1 = growth.texture_pair((30, 40))
    assert frame0.dtype == np.uint8 and frame0.min() == 0 and frame0.max() == 255
    np.testing.assert_array_equal(frame1[1:, 2:], frame0[:-1, :-2])


@pytest.mark.parametrize("option", ["--repeats", "--threads"])
@pytest.mark.parametrize("study", [[], ["--study", "size"], ["--study", "jobs"], ["--study", "roofline"]])
def test_numbers_below_one_are_refused(option, study, capsys):
    assert main(["bench", SCENE, *study, option, "0"]) == 2
    assert "must be at least 1" in capsys.readouterr().err
