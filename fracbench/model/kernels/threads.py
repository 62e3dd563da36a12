"""Threads that share the work on one image; the results do not depend on their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from typing import TypeVar

from fracbench.errors import InputError
from fracbench.model.kernels.cosine import LINES

#: The smallest number of lines worth a thread of its own...
LEAST_LINES = 64
#: ...the smallest number of pixels of an image...
LEAST_PIXELS = 15_000
#: ...and the smallest number of lines for loops of a few operations a pixel.
LEAST_LIGHT_LINES = 256

T = TypeVar("T")
R = TypeVar("R")

_threads: ContextVar[int] = ContextVar("threads", default=1)
_pool: ContextVar[ThreadPoolExecutor] = ContextVar("pool")


@contextmanager
def use_threads(number: int) -> Iterator[None]:
    """Let the solver use `number` threads within a ``with`` block; one by default."""
    if number < 1:
        raise InputError(f"`threads` must be at least 1, got {number}")
    with ThreadPoolExecutor(number, "fracbench") as pool, _team(pool, number):
        yield


@contextmanager
def _team(pool: ThreadPoolExecutor, number: int) -> Iterator[None]:
    tokens = _pool.set(pool), _threads.set(number)
    try:
        yield
    finally:
        _pool.reset(tokens[0])
        _threads.reset(tokens[1])


@contextmanager
def worth_threads(pixels: int) -> Iterator[None]:
    """Use one thread within a ``with`` block if an image of `pixels` pixels is too small for several."""
    token = _threads.set(count() if pixels >= LEAST_PIXELS else 1)
    try:
        yield
    finally:
        _threads.reset(token)


def count() -> int:
    """Return the number of threads that the next `parallel_for` may use."""
    return _threads.get()


def parallel_for(work: Callable[[int, int], object], lines: int, least: int = LEAST_LINES) -> None:
    """Call ``work(start, stop)`` in parallel for ranges that make up ``0..lines-1``, none shorter than `least`.

    `work` releases the GIL and writes each line independently of the others. Within a range it may call
    `parallel_for` again; it then gets its part of the threads.
    """
    parts = 1 if count() == 1 else min(count(), max(1, lines // least))
    if parts == 1:
        work(0, lines)
        return
    pool, inner = _pool.get(), count() // parts
    grain = LINES if least >= LINES else 1
    cuts = [grain * (lines * part // (parts * grain)) for part in range(parts)] + [lines]

    def take(start: int, stop: int) -> None:
        with _team(pool, inner):
            work(start, stop)

    others = [pool.submit(take, a, b) for a, b in pairwise(cuts[1:])]
    take(cuts[0], cuts[1])
    for other in others:
        other.result()


def parallel_map(work: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Return ``[work(item) for item in items]``, computed in parallel; see `parallel_for`."""
    if count() == 1:
        return [work(item) for item in items]
    found: dict[int, list[R]] = {}

    def take(start: int, stop: int) -> None:
        found[start] = [work(item) for item in items[start:stop]]

    parallel_for(take, len(items), least=1)
    return [result for start in sorted(found) for result in found[start]]
