"""Output to the terminal: results on standard output; remarks, errors and progress on standard error."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

COMPILING = "compiling, once on this machine"


def _console(*, stderr: bool) -> Console:
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, soft_wrap=True, emoji=False)


def say(text: str) -> None:
    """Print a result to standard output."""
    print(_visible(text))


def note(text: str) -> None:
    """Print a remark to standard error."""
    _console(stderr=True).print(_visible(text), markup=False, style="dim")


def complain(text: str) -> None:
    """Print an error to standard error, in one line."""
    text = _visible(" ".join(text.splitlines()))  # a file's name may hold a line break
    _console(stderr=True).print(f"fracbench: {text}", markup=False, style="bold red")


def _visible(text: str) -> str:
    """Return a text with its control characters as escapes: a terminal would obey those in the name of a file."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)


class _Notes(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        note(f"note: {record.getMessage()}")


def show_log() -> None:
    """From now on, print the package's log as remarks."""
    logging.getLogger("PIL").setLevel(logging.CRITICAL)  # a damaged picture is told of in one line, which is ours
    logger = logging.getLogger("fracbench")
    if not logger.handlers:
        logger.addHandler(_Notes())


def show_table(table: pd.DataFrame, title: str = "") -> None:
    """Print a table to standard output; cells are shown by ``str``, so numbers should be rounded already."""
    from rich.markup import escape
    from rich.table import Table

    view = Table(title=escape(_visible(title)) or None, title_justify="left")
    for column in table.columns:
        numeric = table[column].map(_looks_numeric).all()
        view.add_column(escape(_visible(str(column))), justify="right" if numeric else "left", no_wrap=True)
    for row in table.itertuples(index=False):
        view.add_row(*("" if value is None else escape(_visible(str(value))) for value in row))
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
def progress(total: int | None, label: str) -> Iterator[Any]:
    """Show a progress bar with the time left; yield a function to call once per point, with any arguments."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    terminal = _console(stderr=True)
    if total == 0 or not terminal.is_terminal:
        yield lambda *_: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("ETA"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=terminal, transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda *_: bar.advance(task)


@contextmanager
def compiling() -> Iterator[Callable[[], None]]:
    """Yield a function to call as each loop is compiled: it shows a bar, or one line outside a terminal."""
    advances: list[Callable[[], None]] = []
    with ExitStack() as stack:

        def advance() -> None:
            if not advances:
                advances.append(stack.enter_context(progress(None, COMPILING)))
                if not _console(stderr=True).is_terminal:
                    note(COMPILING)
            advances[0]()

        yield advance
