"""What the terminal shows: results on standard output; remarks, errors and progress on standard error."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console
    from rich.progress import Progress


def _console(*, stderr: bool) -> Console:
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, soft_wrap=True, emoji=False)


def say(text: str) -> None:
    """Print a result to standard output, as it is."""
    print(text)


def note(text: str) -> None:
    """Print a remark to standard error."""
    _console(stderr=True).print(text, markup=False, style="dim")


def complain(text: str) -> None:
    """Print an error to standard error, in one line."""
    _console(stderr=True).print(f"fracbench: {text}", markup=False, style="bold red")


class _Notes(logging.Handler):
    """Print what the package logs as remarks."""

    def emit(self, record: logging.LogRecord) -> None:
        note(f"note: {record.getMessage()}")


def show_log() -> None:
    """From now on, print the package's log as remarks."""
    logger = logging.getLogger("fracbench")
    if not logger.handlers:
        logger.addHandler(_Notes())


def show_table(table: pd.DataFrame, title: str = "") -> None:
    """Print a table to standard output.

    Parameters
    ----------
    table : pandas.DataFrame
        Cells are shown by ``str``; numbers should be rounded already.
    title : str, optional
        Heading.
    """
    from rich.markup import escape
    from rich.table import Table

    view = Table(title=escape(title) or None, title_justify="left")
    for column in table.columns:
        numeric = table[column].map(_looks_numeric).all()
        view.add_column(str(column), justify="right" if numeric else "left", no_wrap=True)
    for row in table.itertuples(index=False):
        view.add_row(*("" if value is None else escape(str(value)) for value in row))
    console = _console(stderr=False)
    if not console.is_terminal:
        console.width = 200  # a file or a pipe has no edge to wrap at
    console.print(view)


def _looks_numeric(value: Any) -> bool:
    try:
        float(value or 0)
    except (TypeError, ValueError):
        return False
    return True


@contextmanager
def progress(total: int, what: str) -> Iterator[Any]:
    """Show a progress bar with the time left; yields a function to call once a point, with anything.

    Parameters
    ----------
    total : int
        Number of points; for 0 nothing is shown.
    what : str
        Label.

    Yields
    ------
    callable
        Advances the bar by one.
    """
    if total == 0:
        yield lambda *_: None
        return
    with _bar() as bar:
        task = bar.add_task(what, total=total)
        yield lambda *_: bar.advance(task)


def _bar() -> Progress:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    terminal = _console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("ETA"),
        TimeRemainingColumn(),
        console=terminal,
        transient=True,
        disable=not terminal.is_terminal,
    )
