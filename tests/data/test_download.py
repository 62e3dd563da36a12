from __future__ import annotations

import hashlib
import io
import logging
import socket
import threading
import zipfile
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pooch
import pytest

from fracbench.data.datasets import middlebury as mb
from fracbench.data.download import fetch_members
from fracbench.errors import DataError, InputError

# What the two archives hold: a text in the place of each file, and some files nobody asked for.
CONTENT = {name: f"this is {name}\n".encode() for name in mb.REGISTRY}


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def archive(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, data in members.items():
            opened.writestr(name, data)
    return buffer.getvalue()


def frames(content=CONTENT) -> bytes:
    wanted = {f"other-data/{n}": data for n, data in content.items() if n.endswith(".png")}
    return archive({**wanted, "other-data/Army/frame10.png": b"not asked for", "README": b"text"})


def flows(content=CONTENT) -> bytes:
    return archive({f"other-gt-flow/{n}": data for n, data in content.items() if n.endswith(".flo")})


class Server:
    """An HTTP server on the loopback address."""

    def __init__(self, folder):
        self.folder = folder
        self.requests: list[str] = []
        self._http = ThreadingHTTPServer(("127.0.0.1", 0), self._handler)
        self.url = f"http://127.0.0.1:{self._http.server_port}"
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    def _handler(self, *args):
        requests = self.requests

        class Handler(SimpleHTTPRequestHandler):
            def log_message(self, *args):
                requests.append(f"{self.command} {self.path}")

        return Handler(*args, directory=str(self.folder))

    def close(self):
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()


@pytest.fixture
def server(tmp_path, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(mb, "REGISTRY", {name: sha256(data) for name, data in CONTENT.items()})
    served = tmp_path / "served"
    served.mkdir()
    (served / "other-color-twoframes.zip").write_bytes(frames())
    (served / "other-gt-flow.zip").write_bytes(flows())
    server = Server(served)
    yield server
    server.close()


def test_download_takes_what_is_registered_and_nothing_else(server, tmp_path):
    folder = tmp_path / "new" / "data"
    mb.download(folder, base_url=server.url + "/")
    stored = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert stored == CONTENT
    assert all(mb.state(name, folder).state == "ok" for name in mb.SEQUENCES)


def test_pooch_is_quiet_while_downloading_and_only_then(server, tmp_path):
    records: list[logging.LogRecord] = []
    handler = logging.Handler()
    handler.emit = records.append
    logger = pooch.get_logger()
    logger.addHandler(handler)
    try:
        mb.download(tmp_path / "d", base_url=server.url)
        assert records == []
        logger.info("heard")
        assert len(records) == 1
    finally:
        logger.removeHandler(handler)


def test_only_what_is_not_ok_is_fetched_again(server, tmp_path):
    mb.download(tmp_path / "d", base_url=server.url)
    server.requests.clear()
    mb.download(tmp_path / "d", base_url=server.url)
    assert server.requests == []
    damaged, sound = tmp_path / "d/Venus/flow10.flo", tmp_path / "d/Grove2/flow10.flo"
    damaged.write_bytes(b"damaged")
    before = sound.stat().st_ino
    mb.download(tmp_path / "d", base_url=server.url)
    assert server.requests == ["HEAD /other-gt-flow.zip", "GET /other-gt-flow.zip"]
    assert damaged.read_bytes() == CONTENT["Venus/flow10.flo"]
    assert sound.stat().st_ino == before


@pytest.mark.parametrize(
    ("served", "message"),
    [
        (frames({**CONTENT, "Venus/frame11.png": b"forged"}), "Venus/frame11.png in .* is corrupt"),
        (
            frames({n: data for n, data in CONTENT.items() if "Venus" not in n}),
            "does not contain other-data/Venus",
        ),
        (frames()[:-40], "not a sound zip archive"),
        (b"<html>please log in</html>", "not a sound zip archive"),
        (None, "404"),
    ],
    ids=["forged", "incomplete", "cut off", "a log-in page", "gone"],
)
def test_a_wrong_archive_leaves_nothing_behind(server, tmp_path, served, message):
    path = server.folder / "other-color-twoframes.zip"
    if served is None:
        path.unlink()
    else:
        path.write_bytes(served)
    with pytest.raises(DataError, match=message) as caught:
        mb.download(tmp_path / "d", base_url=server.url)
    assert "FRACBENCH_DATA" in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "d").exists()


def test_a_forged_file_is_reported_with_both_hashes(server, tmp_path):
    data = archive({"a/b": b"forged"})
    (server.folder / "x.zip").write_bytes(data)
    with pytest.raises(DataError) as caught:
        fetch_members(f"{server.url}/x.zip", {"a/b": (tmp_path / "b", sha256(b"real"))})
    assert sha256(b"forged") in str(caught.value) and sha256(b"real") in str(caught.value)


def test_a_server_that_does_not_answer_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as silent:  # connections are queued and never served
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(DataError, match=r"gave no answer within 0\.1 s"):
            mb.download(tmp_path / "d", base_url=url, timeout=0.1)
    with pytest.raises(DataError, match="cannot be reached"):
        mb.download(tmp_path / "d", base_url=url, timeout=5.0)


@pytest.mark.parametrize("url", ["no-scheme/x.zip", "http://", "gopher://127.0.0.1/x.zip"])
def test_a_malformed_url_is_a_data_error(tmp_path, url):
    with pytest.raises(DataError):
        fetch_members(url, {"a": (tmp_path / "a", sha256(b""))}, timeout=1.0)


def test_a_folder_that_cannot_be_made_is_named(server, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot make the folder '.*file/d/"):
        mb.download(tmp_path / "file" / "d", base_url=server.url)
