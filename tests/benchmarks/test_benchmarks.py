"""The scripts that measure the program itself; no test depends on a measured time."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import common
import elimination
import growth
import jobs
import lost_pairs
import numpy as np
import openpiv_images
import pandas as pd
import pytest
import roofline
import scaling

from fracbench import estimate_flow
from fracbench.data.files import read_image
from fracbench.harness.config.paths import checkout


def test_growth_reports_every_size(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(growth, "SHAPES", ((40, 48), (60, 64)))
    assert growth.main(["--repeats", "1", f"paths.results={tmp_path}"]) == 0
    assert "bytes_per_pixel" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "runs" / "bench" / "size_2_threads.csv")
    assert table[["boundary", "height", "width"]].values.tolist() == [
        ["reflect", 40, 48], ["reflect", 60, 64], ["zero", 40, 48],
    ]  # fmt: skip
    np.testing.assert_allclose(table["us_per_pixel"], 1e6 * table["seconds"] / table["height"] / table["width"])


def test_a_flow_takes_no_more_memory_than_is_told():
    frames = common.texture_pair((240, 320))
    estimate = partial(estimate_flow, *frames, boundary="reflect", **common.FIXED)
    estimate()
    assert growth.array_bytes(estimate) / (240 * 320) < 120.5


def test_bytes_are_those_of_the_arrays_that_live_at_once():
    def work():
        first = np.zeros(10**6, np.uint8)
        del first
        np.zeros(3 * 10**6, np.uint8)

    assert growth.array_bytes(work) == pytest.approx(3 * 10**6, rel=0.01)


def test_the_roofline_counts_flops_and_bytes(monkeypatch, tmp_path):
    monkeypatch.setattr(roofline, "SHAPES", ((32, 64), (64, 64)))
    assert roofline.main(["--repeats", "1", f"paths.results={tmp_path}"]) == 0
    row = pd.read_csv(tmp_path / "runs" / "bench" / "roofline.csv").iloc[1]
    assert row["mflop"] == pytest.approx(2e-6 * 64 * 64 * (14 * 2.5 * 6 + 90))  # log2(64) = 6 along both axes
    assert row["mbyte"] == pytest.approx(4e-6 * 64 * 64 * 113)
    assert row["ms_by_bytes"] == pytest.approx(row["mbyte"] / row["gbyte_s"]) and row["ms"] > 0


def test_jobs_compare_whole_sweeps(tmp_path):
    sweep = ["sequence=synthetic_corner", "alpha=1,1.2,1.4", "n_scales=1", "n_warps=1", "max_iter=1"]
    assert jobs.main([*sweep, "method=tvl1_sb_alpha", "--repeats", "1", f"paths.results={tmp_path}"]) == 0
    row = pd.read_csv(tmp_path / "runs" / "bench" / "jobs_2.csv").iloc[0]
    assert (row["points"], row["jobs"]) == (3, 2) and row["overhead_ms"] > 0
    assert row["speed_up"] == pytest.approx(row["seconds_1"] / row["seconds_n"])


def test_elimination_and_products_take_turns(tmp_path):
    sweep = ["sequence=synthetic_corner", "alpha=1,1.2", "boundary=zero", "method=tvl1_sb_alpha", "max_iter=2"]
    before = dict(vars(elimination.ZeroGradient))
    assert elimination.main([*sweep, "--repeats", "1", f"paths.results={tmp_path}"]) == 0
    table = pd.read_csv(tmp_path / "runs" / "bench" / "elimination.csv")
    assert list(table["alpha"]) == ["1.0", "1.2", "all"]
    assert (table[["elimination", "products"]] > 0.0).to_numpy().all()
    assert dict(vars(elimination.ZeroGradient)) == before  # nothing stays replaced


def test_the_texture_moves_as_it_says():
    frame0, frame1 = common.texture_pair((30, 40))
    assert frame0.dtype == np.uint8 and frame0.min() == 0 and frame0.max() == 255
    np.testing.assert_array_equal(frame1[1:, 2:], frame0[:-1, :-2])


@pytest.mark.parametrize(
    ("script", "option"), [(growth, "--repeats"), (growth, "--threads"), (jobs, "--jobs"), (roofline, "--repeats")]
)
def test_numbers_below_one_are_refused(script, option, capsys):
    assert script.main([option, "0"]) == 2
    assert capsys.readouterr().err.splitlines() == [f"fracbench: {option} must be at least 1, got 0"]


def test_a_word_that_is_no_option_is_refused(capsys):
    assert growth.main(["--repeat", "1"]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "fracbench: unexpected argument '--repeat': did you mean --repeats?"
    ]


@pytest.mark.parametrize("script", [growth, jobs, roofline, scaling])
def test_each_script_says_how_it_is_called(script):
    environment = {**os.environ, "PYTHONPATH": str(checkout())}
    said = subprocess.check_output([sys.executable, script.__file__, "--help"], text=True, env=environment)
    assert Path(script.__file__).name in said and script.__doc__.split()[0] in said


def test_real_images_are_compared_with_openpiv_on_its_grid(monkeypatch, tmp_path, capsys):
    """The pair that its package holds twice gives the difference of the two flows by hand."""
    pytest.importorskip("openpiv", reason="needs the extra `piv`")
    monkeypatch.setattr(openpiv_images, "SIDE", 168)
    name, files = next(iter(openpiv_images.PAIRS.items()))
    monkeypatch.setattr(openpiv_images, "PAIRS", {name: files, "gone": ("a.tif", "b.tif")})
    assert openpiv_images.main([f"paths.results={tmp_path}"]) == 0
    out, err = capsys.readouterr()
    assert "agreement only" in out and "no truth is known" in out
    assert "gone: skipped: OpenPIV's package does not hold a.tif and b.tif" in err
    row = pd.read_csv(tmp_path / "runs" / "bench" / "openpiv_images.csv").iloc[0]
    assert (row["pair"], row["height"], row["width"]) == (name, 168, 168)
    frames = [openpiv_images.central(read_image(openpiv_images.pictures() / file)) for file in files]
    ours, theirs = (estimate_flow(*frames, **by).flow for by in ({"protocol": "fluid"}, {"method": "openpiv"}))
    distances = [np.hypot(*(ours - theirs)[:, y, x]) for y in range(8, 161, 8) for x in range(8, 161, 8)]
    assert row["difference"] == pytest.approx(np.median(distances), abs=2e-4)
    assert row["openpiv"] == pytest.approx(5.0, abs=1.0) and row["difference"] < 0.5
    assert (tmp_path / "runs" / "bench" / f"openpiv_images_{name}.png").stat().st_size > 10_000


def test_without_openpiv_its_images_are_skipped_with_the_reason(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(openpiv_images, "pictures", lambda: None)
    assert openpiv_images.main([f"paths.results={tmp_path}"]) == 0
    assert "skipped: OpenPIV, whose pictures these are, is not installed: pip install" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_check_notices_a_flow_that_lost_pairs_broke(monkeypatch, tmp_path):
    monkeypatch.setattr(lost_pairs, "FLOWS", ("lamb_oseen",))
    monkeypatch.setattr(lost_pairs, "SHARES", (0.05, 0.6))
    monkeypatch.setattr(lost_pairs, "SEEDS", (0,))
    assert lost_pairs.main([f"paths.results={tmp_path}"]) == 0
    few, many = pd.read_csv(tmp_path / "runs" / "bench" / "lost_pairs.csv").to_dict("records")
    assert few["agree"] > 0.99 and few["aepe"] < 0.1
    assert many["agree"] < 0.9 and many["aepe"] > 1.0
