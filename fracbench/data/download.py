"""Single files out of zip archives on a server, each verified before it appears."""

from __future__ import annotations

import hashlib
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fracbench.data.files import atomic_path
from fracbench.errors import DataError

_MAX_MEMBER_BYTES = 64 * 2**20


def fetch_members(url: str, members: Mapping[str, tuple[Path, str]], timeout: float = 5.0) -> None:
    """Download a zip archive and put some of its members in place: the file and the SHA-256 are given for each.

    Nothing is written unless all of them are there and right; each file appears by a rename. `timeout` is the
    seconds the server has to give its first answer, and the longest pause it may make. It is asked once.
    """
    with tempfile.TemporaryDirectory(prefix="fracbench-") as folder:
        archive = _download(url, Path(folder), timeout)
        content = {member: _verified_member(archive, url, member, sha) for member, (_, sha) in members.items()}
    for member, (target, _) in members.items():
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise DataError(f"cannot make the folder {str(target.parent)!r}: {exc.strerror}") from exc
        with atomic_path(target) as temporary:
            temporary.write_bytes(content[member])


def _download(url: str, folder: Path, timeout: float) -> Path:
    import pooch
    import requests

    try:
        _require_answer(url, timeout)
        with _quiet_pooch():
            # pooch leaves its connection open for reuse; "close" keeps the socket from outliving the download
            downloader = pooch.HTTPDownloader(timeout=timeout, headers={"Connection": "close"})
            return Path(pooch.retrieve(url, None, fname="archive.zip", path=folder, downloader=downloader))
    except (requests.Timeout, TimeoutError) as exc:
        raise DataError(f"{url} gave no answer within {timeout:g} s") from exc
    except requests.ConnectionError as exc:
        raise DataError(f"{url} cannot be reached") from exc
    except (OSError, ValueError) as exc:  # the other errors of requests, and malformed URLs
        raise DataError(f"{url}: {exc}") from exc


def _require_answer(url: str, timeout: float) -> None:
    """Raise unless the server has the archive and says so in time.

    The time-outs of a socket leave out name resolution and count anew for each address of a host; a thread
    bounds the whole.
    """
    import requests

    failures: list[Exception] = []

    def ask() -> None:
        try:
            with requests.head(url, timeout=timeout, allow_redirects=True) as response:
                response.raise_for_status()
        except Exception as exc:
            failures.append(exc)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(timeout)
    if thread.is_alive():
        raise TimeoutError
    if failures:
        raise failures[0]


@contextmanager
def _quiet_pooch() -> Iterator[None]:
    """Silence pooch's advice about hashes: the members are verified one by one."""
    import pooch

    logger = pooch.get_logger()
    before = logger.disabled  # not its level: pooch's logger stands alone, and caches what its level allows
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _verified_member(archive: Path, url: str, member: str, sha256: str) -> bytes:
    try:
        with zipfile.ZipFile(archive) as opened, opened.open(member) as file:
            data = file.read(_MAX_MEMBER_BYTES)
    except KeyError as exc:
        raise DataError(f"{url} does not contain {member}") from exc
    except Exception as exc:  # a damaged archive shows as any of zipfile's, zlib's and struct's errors
        raise DataError(f"{url} is not a sound zip archive ({exc})") from exc
    actual = hashlib.sha256(data).hexdigest()
    if actual != sha256:
        raise DataError(f"{member} in {url} is corrupt: its SHA-256 is {actual}, not {sha256}")
    return data
