"""The model of the cost of a large sweep, and the measurements behind it."""

from __future__ import annotations

import json

import pytest
import scaling

from fracbench.harness.run.plan import make_plan


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
