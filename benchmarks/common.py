"""Parts that the benchmarks share: the frames and the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.commands import console
from fracbench.commands.parser import Parser
from fracbench.errors import FracbenchError, InputError

#: An estimate with all iterations that it may take by default on any image, so that time grows as the work does.
FIXED: dict[str, Any] = {"alpha": 1.2, "epsilon": 0.0, "n_scales": 4}


def texture_pair(shape: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return two 8-bit frames of smoothed noise, shape (H, W), the second moved by (2, 1) pixels."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(0).normal(size=shape).astype(np.float32), 2.0, mode="wrap")
    low, high = noise.min(), noise.max()
    frame = (255.0 * (noise - low) / (high - low)).astype(np.uint8)
    return frame, np.roll(frame, (1, 2), axis=(0, 1))


def parser(description: str | None, *, against: str = "", default: str = "", repeats: bool = True) -> Parser:
    """Return the command line of a benchmark: overrides, ``--repeats`` if asked for, ``--threads`` or ``--jobs``.

    `against` is ``threads`` or ``jobs``, a number that is compared with one; the overrides in `default` apply if
    none are given.
    """
    made = Parser(description=description)
    told = f" (default: {default})" if default else ", such as paths.results=FOLDER"
    made.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help=f"overrides{told}")
    if repeats:
        made.add_argument("--repeats", type=int, default=5, metavar="N", help="timed rounds (default: 5)")
    if against:
        text = f"number of {against} that is compared with one (default: 2)"
        made.add_argument(f"--{against}", type=int, default=2, metavar="N", help=text)
    return made


def run(work: Callable[[argparse.Namespace], None], parser: Parser, argv: Sequence[str]) -> int:
    """Parse `argv` and call `work`; return 0, or 2 after an input error, which is printed in one line."""
    parser.set_defaults(parser=parser)
    try:
        arguments = parser.parse_words(argv)
        least = dict.fromkeys(("repeats", "threads", "jobs", "points", "workers"), 1) | {"sleepers": 0, "real": 0}
        for name, lowest in least.items():
            if (number := getattr(arguments, name, lowest)) < lowest:
                raise InputError(f"--{name} must be at least {lowest}, got {number}")
        work(arguments)
    except FracbenchError as exc:
        console.complain(str(exc))
        return 2
    return 0
