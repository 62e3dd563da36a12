"""The store: what goes in comes out, whoever else writes, and whatever kills the writer."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fracbench.errors import FracbenchError, InputError
from fracbench.harness.run import sqlite
from fracbench.harness.run.sqlite import APPLICATION_ID, SCHEMA_VERSION, STATUSES, transaction
from fracbench.harness.run.store import Row, Store, StoredRows, StoreError, canonical_json, encode

NOBODY = 65534


def a_row(key: str = "k", **changes) -> Row:
    given = {
        "key": key,
        "identity": f"id-{key}",
        "spec": {"method": "tvl1_sb_alpha", "alpha": "1.2", "region": "grove2_A"},
        "solver_version": 3,
        "status": "done",
        "result": {"aae": 0.0395, "stop": "tolerance", "iterations": [[10, 3], [3, 2]], "truth": True},
        "seconds": 3.25,
        "peak_mib": 210.5,
        "provenance": {"host": "müller", "threads": 1, "dirty": False},
        "attempts": 2,
        "created": "2024-05-06T07:08:09+00:00",
    }
    return Row(**given | changes)


def a_failure(key: str = "k", **changes) -> Row:
    return a_row(key, **{"status": "crashed", "error": "worker died: signal 9", "result": {}} | changes)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "runs" / "store.sqlite"


@pytest.fixture
def store(path: Path):
    with Store(path) as opened:
        yield opened


def refusal(path: Path, **how) -> str:
    with pytest.raises(InputError) as caught:
        Store(path, **how)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert str(path) in message
    return message


# --- rows ---------------------------------------------------------------------------------------------


def test_round_trip_through_the_file(path: Path) -> None:
    rows = [a_row("a"), a_failure("b", seconds=None, peak_mib=None, error="x" * 10_000 + "\nü")]
    with Store(path) as store:
        assert [store.put(row) for row in rows] == [True, True]
    with Store(path) as store:
        assert store.rows() == rows
        assert store.get("a") == rows[0]
        assert store.get("c") is None


def test_numbers_json_cannot_hold_come_back_as_none(store: Store) -> None:
    result = {
        "aepe": float("nan"),
        "energy": [1.5, float("inf"), {"last": np.float64("-inf")}],
        "steps": (np.int64(3), np.float32(0.5)),
        "trace": np.array([1.0, np.nan]),
        "converged": np.bool_(True),
    }
    store.put(a_row(result=result, seconds=np.float32(0.25), peak_mib=float("nan")))
    row = store.get("k")
    assert row is not None
    assert row.result == {
        "aepe": None,
        "energy": [1.5, None, {"last": None}],
        "steps": [3, 0.5],
        "trace": [1.0, None],
        "converged": True,
    }
    assert (row.seconds, row.peak_mib) == (0.25, None)


def test_a_row_comes_back_from_its_text_as_from_the_store(store: Store) -> None:
    row = a_row(result={"aepe": float("nan"), "steps": (np.int64(3), 0.1)}, error="x\nü\udce4")
    store.put(row)
    again = Row.from_json(row.to_json())
    assert len(row.to_json().splitlines()) == 1
    assert again.result == store.rows()[0].result
    store.put(again)
    assert store.rows()[0].error == store.get("k").error
    for text in ("", "[]", '{"key": "k"}', '{"status": "dome"}', row.to_json().replace("done", "dome")):
        with pytest.raises(ValueError):
            Row.from_json(text)


def test_an_error_text_that_is_not_unicode_is_kept_readable(store: Store) -> None:
    store.put(a_failure(error=f"cannot read {os.fsdecode(b'fr' + bytes([0xE4]) + b'me.png')}"))
    assert store.rows()[0].error == r"cannot read fr\udce4me.png"


def test_the_file_is_plain_sqlite_with_canonical_json(store: Store, path: Path) -> None:
    store.put(a_row())
    store.close()
    db = sqlite3.connect(path)
    spec, aae = db.execute("SELECT spec, json_extract(result, '$.aae') FROM points").fetchone()
    header = [db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")]
    db.close()
    assert spec == '{"alpha":"1.2","method":"tvl1_sb_alpha","region":"grove2_A"}'
    assert aae == 0.0395
    assert header == [APPLICATION_ID, SCHEMA_VERSION]


def test_canonical_json() -> None:
    assert canonical_json({"b": [1, "ü"], "a": None}) == '{"a":null,"b":[1,"\\u00fc"]}'
    with pytest.raises(ValueError, match="JSON"):
        canonical_json({"a": float("nan")})


def test_a_new_row_is_dated_now_in_utc() -> None:
    row = Row(key="k", identity="i", spec={}, solver_version=1, status="done")
    assert abs(datetime.fromisoformat(row.created) - datetime.now(UTC)) < timedelta(minutes=5)


def test_an_unknown_status_names_the_nearest(store: Store) -> None:
    with pytest.raises(InputError, match="unknown status 'dome': did you mean 'done'"):
        a_row(status="dome")
    with pytest.raises(InputError, match="unknown status 'crash': did you mean 'crashed'"):
        store.rows("crash")


# --- replacing, asking, deleting ----------------------------------------------------------------------


@pytest.mark.parametrize("first", STATUSES)
@pytest.mark.parametrize("second", STATUSES)
def test_a_done_row_is_never_replaced_by_a_failed_one(store: Store, first: str, second: str) -> None:
    old, new = a_row(status=first, attempts=1), a_row(status=second, attempts=2, seconds=9.0)
    store.put(old)
    written = store.put(new)
    assert written == (first != "done" or second == "done")
    assert store.rows() == [new if written else old]


def test_many_rows_are_put_as_each_of_them_would_be(store: Store) -> None:
    store.put(a_row("a", seconds=1.0))
    rows = [a_failure("a"), a_failure("b"), a_row("b", seconds=2.0), a_row("c")]
    store.put_many([encode(row) for row in rows])
    assert {row.key: row.status for row in store.rows()} == {"a": "done", "b": "done", "c": "done"}
    assert store.get("a").seconds == 1.0 and store.get("b").seconds == 2.0


def test_many_rows_are_put_all_or_none(store: Store) -> None:
    def rows():
        yield encode(a_row("a"))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.put_many(rows())
    assert store.rows() == []


def test_get_many_beyond_one_query(store: Store) -> None:
    keys = [f"{n:04d}" for n in range(1203)]
    for key in keys[::100]:
        store.put(a_row(key))
    found = store.get_many([*reversed(keys), "1200"])
    assert list(found) == sorted(keys[::100], reverse=True)
    assert all(row == a_row(key) for key, row in found.items())
    assert store.get_many([]) == {}


def test_by_identity_tells_why_a_point_is_run_again(store: Store) -> None:
    newer = a_row("new", identity="same", solver_version=4, created="2024-06-01T00:00:00+00:00")
    older = a_row("old", identity="same", solver_version=3, created="2024-05-01T00:00:00+00:00")
    for row in (newer, older, a_row("other")):
        store.put(row)
    assert store.by_identity("same") == [older, newer]
    assert store.by_identity("none") == []


def test_rows_by_status_and_counts(store: Store) -> None:
    rows = [a_row("a"), a_failure("b"), a_row("c"), a_failure("d", status="timeout")]
    for row in rows:
        store.put(row)
    assert store.rows("done") == [rows[0], rows[2]]
    assert store.rows("diverged") == []
    assert store.counts() == {"done": 2, "failed": 0, "crashed": 1, "timeout": 1, "diverged": 0}


def test_an_interrupted_write_is_rolled_back(store: Store) -> None:
    store.put(a_row("a"))
    with pytest.raises(KeyboardInterrupt), transaction(store._db):
        store._db.execute("DELETE FROM points")
        raise KeyboardInterrupt
    assert store.put(a_row("b"))
    assert [row.key for row in store.rows()] == ["a", "b"]


# --- reading only -------------------------------------------------------------------------------------


def test_reading_a_store_that_is_not_there_creates_nothing(tmp_path: Path) -> None:
    missing, empty = tmp_path / "none" / "store.sqlite", tmp_path / "empty.sqlite"
    empty.touch()
    for path in (missing, empty):
        with Store(path, readonly=True) as store:
            assert (store.rows(), store.get("k"), sum(store.counts().values())) == ([], None, 0)
    assert sorted(tmp_path.iterdir()) == [empty]
    assert empty.read_bytes() == b""


def test_a_reader_sees_what_is_committed_and_cannot_write(store: Store, path: Path) -> None:
    store.put(a_row("a"))
    with Store(path, readonly=True) as reader:
        assert reader.rows() == [a_row("a")]
        store.put(a_row("b"))
        assert len(reader.rows()) == 2
        with pytest.raises(StoreError, match="opened for reading only"):
            reader.put(a_row("c"))
    assert len(store.rows()) == 2


@pytest.fixture
def folder_of_a_plain_user():
    """A folder of a user who may not write everywhere, which is this process's user for the time of the test."""
    if not hasattr(os, "setresuid"):
        pytest.skip("there are no users here")
    root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as name:
        if root:
            os.chown(name, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, 0)
        try:
            if not os.access(name, os.W_OK):
                pytest.skip(f"another user may not write to {name}")
            yield Path(name)
        finally:
            if root:
                os.setresuid(0, 0, 0)


def test_a_read_only_folder(folder_of_a_plain_user: Path) -> None:
    path = folder_of_a_plain_user / "store.sqlite"
    with Store(path) as store:
        store.put(a_row())
    path.chmod(0o444)
    path.parent.chmod(0o555)
    try:
        with Store(path, readonly=True) as reader:
            assert reader.rows() == [a_row()]
        assert "cannot be written" in refusal(path)
        assert "cannot be opened" in refusal(path.with_name("other.sqlite"))
    finally:
        path.parent.chmod(0o755)


def test_a_reader_leaves_nothing_behind(path: Path) -> None:
    with Store(path) as store:
        store.put(a_row())
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    with Store(path, readonly=True) as reader:
        assert len(reader.rows()) == 1
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


# --- what cannot be opened, and what goes wrong later -------------------------------------------------


@pytest.mark.parametrize("content", [b"aae,aepe\n1,2\n", b"\0" * 4096, b"SQLite format 3\0" + b"\7" * 4096])
@pytest.mark.parametrize("readonly", [False, True])
def test_a_file_that_is_no_store_is_refused_and_left_alone(tmp_path: Path, content: bytes, readonly: bool) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    assert "is not a fracbench store; name another file" in refusal(path, readonly=readonly)
    assert path.read_bytes() == content


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize(
    ("application", "version", "message"),
    [
        (
            APPLICATION_ID,
            SCHEMA_VERSION + 1,
            "fracbench newer than this (schema 2, this one has 1); upgrade it",
        ),
        (APPLICATION_ID, SCHEMA_VERSION - 1, "fracbench older than this (schema 0, this one has 1); move"),
        (0, SCHEMA_VERSION, "is another program's SQLite database"),
        (0, 0, "is another program's SQLite database"),
    ],
)
def test_another_schema_is_refused(
    tmp_path: Path, application: int, version: int, message: str, readonly: bool
) -> None:
    path = tmp_path / "store.sqlite"
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE points (key)")
    db.execute(f"PRAGMA application_id = {application}")
    db.execute(f"PRAGMA user_version = {version}")
    db.close()
    before = path.read_bytes()
    assert message in refusal(path, readonly=readonly)
    assert path.read_bytes() == before


def test_a_place_where_no_file_can_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "folder you may write to" in refusal(tmp_path / "file" / "store.sqlite")
    assert "is a folder; name a file in it" in refusal(tmp_path)
    assert "is a folder; name a file in it" in refusal(tmp_path, readonly=True)


def test_a_damaged_store_says_so_in_one_line(store: Store, path: Path) -> None:
    for n in range(50):
        store.put(a_row(f"{n:02d}", error="x" * 2000))
    store.close()
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)  # all pages but the first, which holds the schema
    path.write_bytes(content)
    with Store(path, readonly=True) as damaged, pytest.raises(StoreError, match=r"is damaged; move it away"):
        damaged.rows()


def test_a_row_that_is_not_json_is_damage_too(store: Store) -> None:
    store.put(a_row())
    store._db.execute("UPDATE points SET result = '{'")
    with pytest.raises(StoreError, match="is damaged"):
        store.get("k")


def test_a_full_disk_loses_nothing_and_the_store_goes_on(store: Store) -> None:
    store.put(a_row("a"))
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreError, match="the disk is full; free some space") as caught:
        store.put(a_row("b", error="x" * 100_000))
    assert isinstance(caught.value, FracbenchError)
    store._db.execute(f"PRAGMA max_page_count = {pages + 1000}")
    assert store.put(a_row("c"))
    assert [row.key for row in store.rows()] == ["a", "c"]


def test_a_lock_held_too_long_is_reported(store: Store, path: Path) -> None:
    store._db.execute("PRAGMA busy_timeout = 10")
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreError, match="another process has held it"):
        store.put(a_row())
    other.execute("ROLLBACK")
    other.close()
    assert store.put(a_row())


def test_a_writer_waits_half_a_minute_and_commits_are_durable(store: Store) -> None:
    settings = {
        name: store._db.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("busy_timeout", "journal_mode", "synchronous")
    }
    full = 2
    assert settings == {"busy_timeout": 30_000, "journal_mode": "wal", "synchronous": full}


class Held:
    """A database whose journal cannot be changed some times, for the reason of a code of SQLite's."""

    def __init__(self, times: int, code: int) -> None:
        self.times, self.code = times, code

    def execute(self, _: str) -> None:
        if self.times:
            self.times -= 1
            error = sqlite3.OperationalError("no")
            error.sqlite_errorcode = self.code
            raise error


def test_the_journal_waits_for_another_process_and_for_nothing_else(monkeypatch) -> None:
    db = Held(3, sqlite3.SQLITE_BUSY)
    sqlite._prefer_wal(db)
    assert db.times == 0
    monkeypatch.setattr(sqlite, "BUSY_SECONDS", 0.0)
    for held in (Held(1, sqlite3.SQLITE_READONLY), Held(2, sqlite3.SQLITE_BUSY)):
        with pytest.raises(sqlite3.OperationalError):
            sqlite._prefer_wal(held)


def test_a_closed_store_is_an_error_and_closing_twice_is_not(store: Store) -> None:
    store.close()
    store.close()
    with pytest.raises(StoreError, match="closed"):
        store.rows()


# --- several processes --------------------------------------------------------------------------------

WRITER = """
import sys
from itertools import count
from fracbench.harness.run.store import Row, Store
path, name, rows = sys.argv[1:]
print("ready", flush=True)
sys.stdin.readline()
with Store(path) as store:
    for n in range(int(rows)) if rows != "endless" else count():
        key = f"{name}{n}"
        store.put(Row(key=key, identity=name, spec={"n": str(n)}, solver_version=1, status="done"))
        print(key, flush=True)
"""


def start_writers(path: Path, names: str, rows: str) -> list[subprocess.Popen[str]]:
    """Start processes that open a store and write to it, all at the same moment."""
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), name, rows],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in names
    ]
    assert [w.stdout.readline() for w in writers] == ["ready\n"] * len(names)
    for writer in writers:
        writer.stdin.write("go\n")
        writer.stdin.flush()
    return writers


def test_processes_that_create_and_fill_one_store_at_once(path: Path) -> None:
    writers = start_writers(path, "abc", "50")
    for writer in writers:
        _, errors = writer.communicate(timeout=60)
        assert (writer.returncode, errors) == (0, "")
    with Store(path, readonly=True) as store:
        assert {row.key for row in store.rows()} == {f"{name}{n}" for name in "abc" for n in range(50)}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no kill -9 here")
def test_kill_9_loses_nothing_that_was_committed(path: Path) -> None:
    (writer,) = start_writers(path, "a", "endless")
    told = [writer.stdout.readline().strip() for _ in range(20)]
    os.kill(writer.pid, signal.SIGKILL)
    told += writer.stdout.read().split("\n")[:-1]  # a line cut short was not told
    writer.communicate(timeout=60)
    assert writer.returncode == -signal.SIGKILL
    with Store(path) as store:
        kept = store.rows()
        assert [row.key for row in kept][: len(told)] == told
        assert [row.spec for row in kept] == [{"n": str(n)} for n in range(len(kept))]
        assert store.put(a_row("next"))
        assert store._db.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize(
    ("writable", "mode"),
    [
        (("file", "folder"), "mode=rw"),
        (("file",), "mode=ro&immutable=1"),
        (("folder",), "mode=ro"),
        ((), "mode=ro&immutable=1"),
    ],
)
def test_a_store_is_read_as_its_rights_allow(tmp_path, monkeypatch, writable, mode):
    """Where the folder cannot be written, SQLite cannot make the files that WAL needs beside the store."""
    path = tmp_path / "store.sqlite"
    rights = {path: "file" in writable, tmp_path: "folder" in writable}
    monkeypatch.setattr(sqlite.os, "access", lambda place, _: rights[place])
    assert sqlite._reading_mode(path) == mode


# --- blocks of rows -----------------------------------------------------------------------------------


def test_a_block_of_rows_is_stored_whole_or_not_at_all(store: Store, path: Path) -> None:
    rows = [a_row("a"), a_failure("b"), a_row("c")]
    store.put_many([encode(row) for row in rows])
    assert store.rows() == rows
    broken = (*encode(a_row("e"))[:4], "no status", *encode(a_row("e"))[5:])
    with pytest.raises(StoreError):
        store.put_many([encode(a_row("d")), broken])
    assert store.rows() == rows


@pytest.mark.parametrize(
    ("column", "value"), [(0, 1), (2, {}), (3, "2"), (4, None), (6, 5), (7, "1 s"), (10, None)]
)
def test_a_block_with_a_value_of_a_wrong_type_is_refused(store: Store, column: int, value: object) -> None:
    values = encode(a_row("b"))
    with pytest.raises(StoreError, match="not a row"):
        store.put_many([encode(a_row("a")), (*values[:column], value, *values[column + 1 :])])
    with pytest.raises(StoreError, match="not a row"):
        store.put_many([values[:-1]])
    assert store.is_empty()


def test_a_failed_row_of_a_block_does_not_take_the_place_of_a_finished_one(store: Store) -> None:
    store.put(a_row("a"))
    store.put_many([encode(a_failure("a")), encode(a_failure("b"))])
    assert dict(store.statuses(["a", "b", "c"])) == {"a": "done", "b": "crashed"}


def test_rows_are_read_when_they_are_asked_for(path: Path, monkeypatch) -> None:
    monkeypatch.setattr("fracbench.harness.run.store._KEYS_PER_BLOCK", 3)
    keys = [f"{i:02d}" for i in range(20)]
    with Store(path) as store:
        store.put_many([encode(a_row(key)) for key in keys if key != "05"])
    statuses = dict.fromkeys(keys, "done") | {"05": None}
    rows = StoredRows(path, statuses)
    assert (len(rows), list(rows), rows.get("05"), rows.get("x")) == (
        19,
        [k for k in keys if k != "05"],
        None,
        None,
    )
    for order in (keys, keys[::-1], keys[::3], keys):
        assert [rows[key].key for key in order if key != "05"] == [key for key in order if key != "05"]
    assert dict(rows) == {key: a_row(key) for key in keys if key != "05"}


def test_keys_identities_and_a_sample(store: Store) -> None:
    assert store.is_empty() and store.size() == 0 and store.sample("done", 5) == []
    store.put_many([encode(a_row(f"{i:02d}", identity=str(i % 3))) for i in range(20)] + [encode(a_failure("x"))])
    assert set(store.keys("done")) == {f"{i:02d}" for i in range(20)} == set(store.keys()) - {"x"}
    assert store.identities() >= {"0", "1", "2"} and store.size() == 21
    assert [row.key for row in store.sample("done", 5)] == ["04", "09", "14", "19"]
    assert len(store.sample("done", 100)) == 20
