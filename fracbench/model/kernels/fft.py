"""Complex Fourier transforms of any length, of eight lines at once and in place (`fracbench.model.kernels.simd`).

A workspace ``work`` of shape (2 N, LANES) holds N complex rows of eight: its rows 2 r and 2 r + 1 are the real
and the imaginary part of row r. A transform takes the n rows from ``base`` on.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import LANES, Lanes, load_complex, store_complex


class LinePlan(NamedTuple):
    """Tables for the transforms of one length, computed in float64 and rounded once.

    The Fourier transform leaves its results in digit-reversed order (decimation in frequency). They are never
    moved: a reader looks up the row of a result.
    """

    radices: NDArray[np.intp]  # lengths of the Fourier transform's passes
    starts: NDArray[np.intp]  # where the twiddle factors of each pass begin...
    root_starts: NDArray[np.intp]  # ...and its roots
    together: int  # passes over all rows, after which the remaining shorter transforms are done one by one
    results: NDArray[np.intp]  # row of each result of the Fourier transform
    forth: NDArray[np.intp]  # row of each sample before a transform: even ones, then odd ones in reverse
    back: NDArray[np.intp]  # row of each sample after an inverse transform
    natural: NDArray[np.intp]  # 0, 1, ... n-1
    twiddles: Array  # (2, number): cosines and sines of the passes, one after the other
    roots: Array  # (number, 4): cosines and sines of the odd radices above 5, as `_odd_radix` takes them
    quarter: Array  # (2, n): cos(pi k / (2 n)) and sin(pi k / (2 n))


#: Shorter transforms of so many rows are done one by one: 6 to 16 KB in float32, which fit the first-level cache.
#: For fewer rows the calls cost more than they save.
LEAST_ROWS, MOST_ROWS = 96, 256


@lru_cache(maxsize=128)
def line_plan(n: int, dtype: np.dtype) -> LinePlan:
    """Return the plan for lines of length `n`. Any length works; a prime factor above 5 costs its square."""
    radices = _radices(n)
    twiddles, roots, rests = [], [np.zeros((0, 4))], [n]
    for radix in radices:
        rest = rests[-1] // radix
        twiddles.append(-2.0 * np.pi * np.outer(np.arange(rest), np.arange(1, radix)).ravel() / (rest * radix))
        roots.append(_odd_roots(radix) if radix > 5 else roots[0])
        rests.append(rest)
    samples = np.concatenate([np.arange(0, n, 2), np.arange(n - 1 - n % 2, 0, -2)])
    forth = np.argsort(samples)
    results = np.argsort(_digits_reversed(radices))
    return LinePlan(
        radices=np.array(radices, np.intp),
        starts=np.cumsum([0, *map(len, twiddles)], dtype=np.intp),
        root_starts=np.cumsum([0, *map(len, roots[1:])], dtype=np.intp),
        together=next((i for i, rest in enumerate(rests) if LEAST_ROWS <= rest <= MOST_ROWS), 0),
        results=results.astype(np.intp),
        forth=forth.astype(np.intp),
        back=results[forth].astype(np.intp),
        natural=np.arange(n, dtype=np.intp),
        twiddles=_cosines_and_sines(twiddles, dtype),
        roots=np.concatenate(roots).astype(dtype),
        quarter=_cosines_and_sines([np.pi * np.arange(n) / (2 * n)], dtype),
    )


def _radices(n: int) -> list[int]:
    """Return the factors of `n` in the order of their passes: fours, the others from the largest on, a four.

    In this order consecutive results are seldom a multiple of 4096 bytes apart, a distance at which they evict
    each other from the first-level cache; and the last passes, which have the shortest loops, are cheap ones.
    """
    factors, rest = [], n
    for radix in (4, 2, 3, 5):
        while rest % radix == 0:
            factors.append(radix)
            rest //= radix
    radix = 7
    while rest > 1:
        if rest % radix == 0:
            factors.append(radix)
            rest //= radix
        else:
            radix += 2
    fours, others = ([radix for radix in factors if (radix == 4) == four] for four in (True, False))
    return fours[1:] + others[::-1] + fours[:1]


def _digits_reversed(radices: list[int]) -> NDArray[np.intp]:
    """Return the frequency of each row after the passes."""
    frequencies = np.zeros(1, np.intp)
    for radix in reversed(radices):
        frequencies = np.concatenate([frequencies * radix + j for j in range(radix)])
    return frequencies


def _odd_roots(radix: int) -> NDArray[np.float64]:
    """Return the cosines and sines of an odd radix in the order in which `_odd_radix` takes them."""
    j = np.arange(1, radix // 2 + 1)
    angles = [-2.0 * np.pi * (np.outer(i, j).ravel() % radix) / radix for i in (j[::2], j[::2] + 1)]
    return np.stack([f(angle) for angle in angles for f in (np.cos, np.sin)], axis=1)


def _cosines_and_sines(angles: list[NDArray[np.float64]], dtype: np.dtype) -> Array:
    angle = np.concatenate(angles) if angles else np.zeros(0)
    return np.array([np.cos(angle), np.sin(angle)]).astype(dtype)


@jit
def _store_twiddled(work: Array, row: int, x: Lanes, y: Lanes, twiddles: Array, k: int) -> None:
    """Write a row times a twiddle factor."""
    at = np.uintp(k)
    c, s = twiddles[0, at], twiddles[1, at]
    store_complex(work, row, c * x - s * y, c * y + s * x)


@jit
def fourier(work: Array, base: int, plan: LinePlan) -> None:
    """Transform the rows of `work` from `base` on in place; ``plan.results`` holds the row of each result."""
    n, passes = plan.results.size, plan.radices.size
    # not a literal 0, for which numba would compile every pass again
    start, rows, rest, first, last = base, n, n, int(np.intp(0)), plan.together  # all rows together...
    while start < base + n:
        rest = rows
        for i in range(first, last):
            stop, radix, k = start + rows, plan.radices[i], plan.starts[i]
            rest //= radix
            if radix == 4:
                _radix4(work, start, stop, rest, plan.twiddles, k)
            elif radix == 2:
                _radix2(work, start, stop, rest, plan.twiddles, k)
            elif radix == 3:
                _radix3(work, start, stop, rest, plan.twiddles, k)
            elif radix == 5:
                _radix5(work, start, stop, rest, plan.twiddles, k)
            else:
                _odd_radix(work, start, stop, radix, rest, plan.twiddles, k, plan.roots, plan.root_starts[i])
        if last < passes:  # ...then one shorter transform after the other
            rows, first, last = rest, last, passes
        else:
            start += rows


@jit
def _radix2(work: Array, start: int, stop: int, rest: int, twiddles: Array, first: int) -> None:
    for block in range(start, stop, 2 * rest):
        for p in range(rest):
            row = block + p
            ar, ai = load_complex(work, row)
            br, bi = load_complex(work, row + rest)
            store_complex(work, row, ar + br, ai + bi)
            _store_twiddled(work, row + rest, ar - br, ai - bi, twiddles, first + p)


@jit
def _radix3(work: Array, start: int, stop: int, rest: int, twiddles: Array, first: int) -> None:
    half = twiddles.dtype.type(0.5)
    root = twiddles.dtype.type(np.sqrt(0.75))
    for block in range(start, stop, 3 * rest):
        for p in range(rest):
            row, k = block + p, first + 2 * p
            ar, ai = load_complex(work, row)
            br, bi = load_complex(work, row + rest)
            cr, ci = load_complex(work, row + 2 * rest)
            sr, si = br + cr, bi + ci
            dr, di = root * (br - cr), root * (bi - ci)
            mr, mi = ar - half * sr, ai - half * si
            store_complex(work, row, ar + sr, ai + si)
            _store_twiddled(work, row + rest, mr + di, mi - dr, twiddles, k)
            _store_twiddled(work, row + 2 * rest, mr - di, mi + dr, twiddles, k + 1)


@jit
def _radix4(work: Array, start: int, stop: int, rest: int, twiddles: Array, first: int) -> None:
    for block in range(start, stop, 4 * rest):
        for p in range(rest):
            row, k = block + p, first + 3 * p
            ar, ai = load_complex(work, row)
            br, bi = load_complex(work, row + rest)
            cr, ci = load_complex(work, row + 2 * rest)
            dr, di = load_complex(work, row + 3 * rest)
            er, ei, fr, fi = ar + cr, ai + ci, ar - cr, ai - ci
            gr, gi, hr, hi = br + dr, bi + di, br - dr, bi - di
            store_complex(work, row, er + gr, ei + gi)
            _store_twiddled(work, row + rest, fr + hi, fi - hr, twiddles, k)
            _store_twiddled(work, row + 2 * rest, er - gr, ei - gi, twiddles, k + 1)
            _store_twiddled(work, row + 3 * rest, fr - hi, fi + hr, twiddles, k + 2)


@jit
def _radix5(work: Array, start: int, stop: int, rest: int, twiddles: Array, first: int) -> None:
    real = twiddles.dtype.type
    c1, c2 = real(np.cos(0.4 * np.pi)), real(np.cos(0.8 * np.pi))
    s1, s2 = real(np.sin(0.4 * np.pi)), real(np.sin(0.8 * np.pi))
    for block in range(start, stop, 5 * rest):
        for p in range(rest):
            row, k = block + p, first + 4 * p
            ar, ai = load_complex(work, row)
            br, bi = load_complex(work, row + rest)
            cr, ci = load_complex(work, row + 2 * rest)
            dr, di = load_complex(work, row + 3 * rest)
            er, ei = load_complex(work, row + 4 * rest)
            pr, pi, qr, qi = br + er, bi + ei, br - er, bi - ei
            ur, ui, vr, vi = cr + dr, ci + di, cr - dr, ci - di
            store_complex(work, row, ar + pr + ur, ai + pi + ui)
            mr, mi = ar + c1 * pr + c2 * ur, ai + c1 * pi + c2 * ui
            nr, ni = s1 * qr + s2 * vr, s1 * qi + s2 * vi
            _store_twiddled(work, row + rest, mr + ni, mi - nr, twiddles, k)
            _store_twiddled(work, row + 4 * rest, mr - ni, mi + nr, twiddles, k + 3)
            mr, mi = ar + c2 * pr + c1 * ur, ai + c2 * pi + c1 * ui
            nr, ni = s2 * qr - s1 * vr, s2 * qi - s1 * vi
            _store_twiddled(work, row + 2 * rest, mr + ni, mi - nr, twiddles, k + 1)
            _store_twiddled(work, row + 3 * rest, mr - ni, mi + nr, twiddles, k + 2)


@jit
def _odd_radix(
    work: Array,
    start: int,
    stop: int,
    radix: int,
    rest: int,
    twiddles: Array,
    first: int,
    roots: Array,
    first_root: int,
) -> None:
    # The terms j and radix - j have the same cosine and opposite sines, which halves the products.
    half = radix // 2
    pairs = np.empty((4 * half + 4, LANES), work.dtype)
    for block in range(start, stop, radix * rest):
        for p in range(rest):
            row, k = block + p, first + (radix - 1) * p
            ar, ai = load_complex(work, row)
            tr, ti, zero = ar, ai, ar - ar
            for j in range(1, half + 1):
                xr, xi = load_complex(work, row + j * rest)
                yr, yi = load_complex(work, row + (radix - j) * rest)
                store_complex(pairs, 2 * j, xr + yr, xi + yi)
                store_complex(pairs, 2 * j + 1, xr - yr, xi - yi)
                tr, ti = tr + (xr + yr), ti + (xi + yi)
            store_complex(work, row, tr, ti)
            at = np.uintp(first_root)
            for i in range(1, half + 1, 2):  # two sums at a time, so that each term is loaded once for both
                fr, fi, gr, gi = ar, ai, ar, ai
                pr, pi, qr, qi = zero, zero, zero, zero
                for j in range(1, half + 1):
                    xr, xi = load_complex(pairs, 2 * j)
                    yr, yi = load_complex(pairs, 2 * j + 1)
                    c, s = roots[at, 0], roots[at, 1]
                    fr, fi, pr, pi = fr + c * xr, fi + c * xi, pr + s * yr, pi + s * yi
                    c, s = roots[at, 2], roots[at, 3]
                    gr, gi, qr, qi = gr + c * xr, gi + c * xi, qr + s * yr, qi + s * yi
                    at += np.uintp(1)
                _store_mirrored(work, row, rest, i, radix, fr, fi, pr, pi, twiddles, k)
                if i + 1 <= half:
                    _store_mirrored(work, row, rest, i + 1, radix, gr, gi, qr, qi, twiddles, k)


@jit
def _store_mirrored(
    work: Array,
    row: int,
    rest: int,
    i: int,
    radix: int,
    xr: Lanes,
    xi: Lanes,
    yr: Lanes,
    yi: Lanes,
    twiddles: Array,
    k: int,
) -> None:
    """Write the results i and radix - i: cosine sum plus and minus i times the sine sum."""
    _store_twiddled(work, row + i * rest, xr - yi, xi + yr, twiddles, k + i - 1)
    _store_twiddled(work, row + (radix - i) * rest, xr + yi, xi - yr, twiddles, k + radix - i - 1)
