"""The model of the cost of a large sweep, and the measurements behind it."""

from __future__ import annotations

import json

import cluster
import pytest
import scaling
import soak

from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import STORE, Store


def test_the_workers_or_the_parent_set_the_pace():
    assert scaling.hours(3600, 10, 9.0, 1.0, 0.5) == pytest.approx(1.0)
    assert scaling.hours(3600, 1000, 9.0, 1.0, 0.5) == pytest.approx(0.5)


def test_rows_are_written_and_messages_weighed(tmp_path, monkeypatch, fake_rows):
    monkeypatch.chdir(tmp_path)
    plan = make_plan([*scaling.GRID], allow_download=False)
    rows = list(fake_rows(plan).values())
    assert len(rows) == 40
    seconds, size = scaling.write_seconds(rows)
    there, back = scaling.message_bytes(plan, rows[0])
    assert seconds > 0
    assert min(size, back) > len(json.dumps(rows[0].result))
    assert 50 < there < 10_000
    assert list(tmp_path.iterdir()) == []


def test_a_simulated_cluster_computes_all_points(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = cluster.simulated(200, 4, 0.01)
    assert record["points"] == len(make_plan(cluster.grid_of(200), allow_download=False).unique()) == 160
    assert 0.0 < record["busy"] <= 1.0
    assert record["parent_ms"] > 0.0


def test_sleeping_workers_compute_all_points(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra `dask`")
    monkeypatch.chdir(tmp_path)
    record = cluster.sleeping(200, 2, 0.01)
    assert record["points"] == 160
    assert 0.0 < record["busy"] <= 1.0
    assert record["scheduler_ms"] > 0.0


def test_a_point_that_is_computed_again_is_seen(tmp_path, fake_rows):
    one = soak.Soak(tmp_path / "sweep", tmp_path / "log", 40)
    rows = list(fake_rows(make_plan([*scaling.GRID], allow_download=False), created="2020-01-01").values())
    with Store(one.folder / "results" / STORE) as store:
        for row in rows[:2]:
            store.put(row)
    one.log.write_text("start a\nstart b\nend   a\nstart b\nend   b\n")  # b's worker was killed once
    assert one.check() == (2, 0, 2)
    one.log.write_text("start a\nend   a\nstart a\nend   a\n")
    assert one.check() == (2, 1, 2)
    assert one.ended() == 2


def test_growth_is_that_of_the_points_in_the_second_half(tmp_path):
    one = soak.Soak(tmp_path / "sweep", tmp_path / "log", 40)
    one.samples = [(0.0, 2, 900.0, 900.0), *((0.0, n, 100.0 + n / 1000, 50.0) for n in range(21, 40))]
    assert one.slopes() == pytest.approx((1.0, 0.0), abs=1e-9)
    assert one.grown() == pytest.approx(0.02)  # 20 points


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--points", "0"], "--points must be at least 1, got 0"),
        (["--sleepers", "-1"], "--sleepers must be at least 0, got -1"),
        (["--seconds", "0"], "--seconds must be greater than 0, got 0"),
    ],
)
def test_numbers_out_of_range_are_refused(capsys, words, named):
    assert cluster.main(words) == 2
    assert capsys.readouterr().err == f"fracbench: {named}\n"


def test_without_dask_the_other_workers_are_named(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert cluster.main([]) == 2
    assert "take --sleepers 0 --real 0" in capsys.readouterr().err
