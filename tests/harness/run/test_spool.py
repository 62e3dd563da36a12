"""The spool: whole rows or none, and claims that end with their process (see also test_execute, test_faults)."""

from __future__ import annotations

import os
import time

import pytest

from fracbench.harness.run import spool
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.store import Store


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "store.sqlite") as opened:
        yield opened


@pytest.fixture
def folder(store):
    made = spool.folder_of(store.path)
    made.mkdir()
    return made


@pytest.fixture
def rows(fake_rows):
    return list(fake_rows(make_plan(["sequence=synthetic_flat", "alpha=0,1"], allow_download=False)).values())


def test_what_is_written_is_read_until_it_is_removed(folder, rows):
    spool.write(folder, rows[0])
    assert spool.read(folder, rows[0].key) == rows[0]
    assert spool.read(folder, rows[1].key) is None
    assert [path.name for path in folder.iterdir()] == [f"{rows[0].key}.json"]
    spool.remove(folder, rows[0].key)
    spool.remove(folder, rows[0].key)
    assert spool.read(folder, rows[0].key) is None


def test_a_row_under_another_name_is_none(folder, rows, store):
    spool.write(folder, rows[0])
    (folder / f"{rows[0].key}.json").rename(folder / f"{rows[1].key}.json")
    assert spool.read(folder, rows[1].key) is None
    assert spool.harvest(store) == 0
    assert store.rows() == []


def test_a_write_that_fails_leaves_nothing(folder, rows, monkeypatch):
    def full(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(folder), "replace", full)
    with pytest.raises(OSError, match="No space left"):
        spool.write(folder, rows[0])
    assert list(folder.iterdir()) == []


def test_the_harvest_is_stored_once_and_half_writes_are_swept_away(folder, rows, store):
    for row in rows:
        spool.write(folder, row)
    fresh, stale = folder / ".fresh-1", folder / ".stale-1"
    for path in (fresh, stale):
        path.write_text("{")
    os.utime(stale, (0, time.time() - 3600))
    assert spool.harvest(store) == 2
    assert store.rows() == sorted(rows, key=lambda row: row.key)
    assert list(folder.iterdir()) == [fresh]
    assert spool.harvest(store) == 0


def test_a_claim_is_refused_only_where_another_process_holds_it(folder, monkeypatch):
    with spool.Claims(folder) as claims:
        assert claims.take("ab" * 32) and claims.take("ab" * 32)
        claims.release("ab" * 32)

        class NoLocks:
            LOCK_EX = LOCK_NB = LOCK_UN = 0

            @staticmethod
            def lockf(*_):
                raise OSError(95, "not supported")

        for substitute in (NoLocks, None):
            monkeypatch.setattr(spool, "fcntl", substitute)
            assert claims.take("cd" * 32)
            claims.release("cd" * 32)
