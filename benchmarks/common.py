"""Parts that the benchmarks share: the frames, the command line, the table that is printed and written."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.commands import console
from fracbench.commands.bench import results_stem, write_results
from fracbench.commands.parser import Parser
from fracbench.errors import FracbenchError, InputError

#: An estimate with all iterations that it may take by default on any image, so that time grows as the work does.
FIXED: dict[str, Any] = {"alpha": 1.2, "epsilon": 0.0, "n_scales": 4}


def texture_pair(shape: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return two 8-bit frames of smoothed noise, the second moved by (2, 1) pixels.

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)``.

    Returns
    -------
    tuple of ndarray
        Frames.
    """
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(0).normal(size=shape).astype(np.float32), 2.0, mode="wrap")
    low, high = noise.min(), noise.max()
    frame = (255.0 * (noise - low) / (high - low)).astype(np.uint8)
    return frame, np.roll(frame, (1, 2), axis=(0, 1))


def parser(description: str | None, *, repeats: int, against: str = "", default: str = "") -> Parser:
    """Return the command line of a benchmark: overrides, ``--repeats``, and ``--threads`` or ``--jobs``.

    Parameters
    ----------
    description : str
        The module's docstring.
    repeats : int
        Timed rounds by default.
    against : str, optional
        ``threads`` or ``jobs``: the number that is compared with one, an option then.
    default : str, optional
        Overrides that apply where none are given.

    Returns
    -------
    Parser
        Ready to parse.
    """
    made = Parser(description=description)
    told = f" (default: {default})" if default else ", such as paths.results=FOLDER"
    made.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help=f"overrides{told}")
    made.add_argument("--repeats", type=int, default=repeats, help=f"timed rounds (default: {repeats})")
    if against:
        made.add_argument(f"--{against}", type=int, default=2, help=f"{against}, compared with one (default: 2)")
    return made


def run(work: Callable[[argparse.Namespace], None], parser: Parser, argv: Sequence[str]) -> int:
    """Parse the words of a command line and call `work`; an input error is one line and exit code 2.

    Parameters
    ----------
    work : callable
        Takes the arguments.
    parser : Parser
        See `parser`.
    argv : sequence of str
        Words without the program's name.

    Returns
    -------
    int
        Exit code: 0 done, 2 bad input.
    """
    parser.set_defaults(parser=parser)
    try:
        arguments = parser.parse_words(argv)
        for name in ("repeats", "threads", "jobs"):
            if (number := getattr(arguments, name, 1)) < 1:
                raise InputError(f"--{name} must be at least 1, got {number}")
        work(arguments)
    except FracbenchError as exc:
        console.complain(" ".join(str(exc).splitlines()))
        return 2
    return 0


def write(records: list[dict[str, Any]], stem: Path, title: str, note: str = "medians of the rounds") -> None:
    """Print the records of a benchmark as a table and write them as CSV."""
    import pandas as pd

    write_results(pd.DataFrame(records), stem, title, note)


__all__ = ["FIXED", "parser", "results_stem", "run", "texture_pair", "write"]
