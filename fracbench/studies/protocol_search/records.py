"""Trials and the table that keeps them: a row a trial, from which a search goes on, here or on another machine."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fracbench.errors import InputError
from fracbench.studies.protocol_search.space import Settings

#: Numbers of a method and a sequence in Table 2: the angular errors first, for the two objectives of NSGA-II.
NUMBERS = ("aae", "sdae", "aepe")
#: |ln(ours / printed)| of a point that failed or diverged.
FAILED = float(np.log(100.0))

_DIGITS = 4
_FIRST = ("stage", "study", "number", "settings")


@dataclass(frozen=True)
class Trial:
    """A configuration that was tried: its values, and ln(ours / printed) by method, sequence and metric.

    `distance` is over the numbers that were computed: all of the stage's, unless it was `stopped` early.
    `settings` is the digest of the settings of its study.
    """

    stage: str
    study: str
    number: int
    values: dict[str, Any]
    logs: dict[tuple[str, str, str], float]
    stopped: bool
    settings: str = ""

    @property
    def distance(self) -> float:
        """The root mean square of `logs`: the distance of `table2.distance`."""
        return rms(self.logs.values())

    @property
    def configuration(self) -> tuple[str, str]:
        """The stage's methods and the values, as text: equal for trials that are the same run."""
        return self.stage, repr(sorted(self.values.items()))


def rms(logs: Iterable[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(list(logs)))))


class TrialTable:
    """A CSV file of trials, to which batches are appended; rows of a batch that was cut short are removed.

    The columns of the switches hold their values, or nothing where the stage does not search them. Those of the
    numbers hold ln(ours / printed), or nothing where the trial was stopped before.
    """

    def __init__(self, path: Path, settings: Settings) -> None:
        self.path, self._settings = path, settings
        methods = dict.fromkeys(method for method, _ in settings.points)
        numbers = [(method, name, n) for name in settings.sequences for method in methods for n in NUMBERS]
        self._numbers = {" ".join(number): number for number in numbers}
        self._words = {s.name: {_word(value): value for value in s.values} for s in settings.switches}
        self._header = [*_FIRST, *self._words, *self._numbers]

    def read(self) -> list[Trial]:
        """Return the trials of the file, in its order; none if there is no file."""
        if not self.path.exists():
            return []
        raw = self.path.read_bytes()
        if self.path.suffix == ".gz":
            raw = gzip.decompress(raw)
        else:
            whole = raw[: raw.rfind(b"\n") + 1]
            if len(whole) < len(raw):
                with self.path.open("r+b") as file:
                    file.truncate(len(whole))
            raw = whole
        rows = csv.reader(io.StringIO(raw.decode()))
        if next(rows, None) != self._header:
            raise InputError(f"{self.path}: holds a search with other settings; move it away")
        try:
            return [self._trial(dict(zip(self._header, row, strict=True))) for row in rows]
        except (ValueError, KeyError) as exc:
            raise InputError(f"{self.path}: is no table of a search's trials; move it away ({exc})") from exc

    def append(self, trials: Sequence[Trial]) -> None:
        """Write a batch at the end of the file."""
        text = self.text(trials, header=not self.path.exists())
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(text)

    def text(self, trials: Sequence[Trial], *, header: bool = True) -> str:
        """Return the rows of trials as CSV."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        if header:
            writer.writerow(self._header)
        for trial in trials:
            writer.writerow(self._row(trial))
        return out.getvalue()

    def _row(self, trial: Trial) -> list[str]:
        values = [_word(trial.values[name]) if name in trial.values else "" for name in self._words]
        logs = [_decimal(trial.logs[n]) if n in trial.logs else "" for n in self._numbers.values()]
        return [trial.stage, trial.study, str(trial.number), trial.settings, *values, *logs]

    def _trial(self, row: Mapping[str, str]) -> Trial:
        values = {name: words[row[name]] for name, words in self._words.items() if row[name]}
        logs = {number: float(row[name]) for name, number in self._numbers.items() if row[name]}
        stopped = len(logs) < len(NUMBERS) * len(self._settings.order(row["stage"].split("+")))
        return Trial(row["stage"], row["study"], int(row["number"]), values, logs, stopped, row["settings"])


def compressed(text: str) -> bytes:
    """Return text as gzip: the same text gives the same bytes."""
    return gzip.compress(text.encode(), compresslevel=9, mtime=0)


def rounded(log: float) -> float:
    """Return a logarithm as the table keeps it, so that a search does not depend on where it was interrupted."""
    return round(min(max(log, -FAILED), FAILED), _DIGITS) + 0.0


def _decimal(log: float) -> str:
    return f"{log:.{_DIGITS}f}"


def _word(value: Any) -> str:
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else f"{value}"
