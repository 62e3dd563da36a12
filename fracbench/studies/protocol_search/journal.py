"""Optuna's journal in a file that takes whole batches of trials: an interrupted batch leaves no trace."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from optuna.storages.journal import BaseJournalBackend

from fracbench.errors import InputError


class BatchJournal(BaseJournalBackend):
    """A journal whose entries reach the file when `commit` is called: one line a batch.

    A line that was cut short is removed when the file is opened.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._logs: list[dict[str, Any]] = []
        if path.exists():
            text = path.read_bytes()
            whole = text[: text.rfind(b"\n") + 1]
            try:
                self._logs = [log for line in whole.splitlines() for log in json.loads(line)]
            except ValueError as exc:
                raise InputError(f"{path}: is no journal of a search; move it away ({exc})") from exc
            if len(whole) < len(text):
                with path.open("r+b") as file:
                    file.truncate(len(whole))
        self._kept = len(self._logs)

    def read_logs(self, log_number_from: int) -> Iterable[dict[str, Any]]:
        """Return the entries from a number on."""
        return self._logs[log_number_from:]

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Take entries, as they would come back from the file."""
        self._logs += json.loads(json.dumps(logs))

    def commit(self) -> None:
        """Write the entries since the last call to the file."""
        line = json.dumps(self._logs[self._kept :], separators=(",", ":"))
        with self._path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
            file.flush()
            os.fsync(file.fileno())
        self._kept = len(self._logs)
