"""Complex Fourier transforms of any length, of eight lines at once and in place (`fracbench.model._lanes`).

A workspace ``work`` of shape (2 N, LANES) holds N complex rows of eight: its rows 2 r and 2 r + 1 are the real
and the imaginary part of row r. A transform takes the n rows from ``base`` on.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracbench.model._jit import jit
from fracbench.model._lanes import LANES, Lanes, load, store
from fracbench.model.arrays import Array


class LinePlan(NamedTuple):
    """What the transforms of one length need, all computed in float64 and rounded once.

    The Fourier transform leaves its results in the order of its digits reversed (decimation in frequency);
    nothing is ever moved for that: whoever reads a result looks up its row.

    Attributes
    ----------
    radices : ndarray of int
        Lengths of the Fourier transform's passes.
    results : ndarray of int, shape (n,)
        Row in which each result of the Fourier transform stands.
    forth : ndarray of int, shape (n,)
        Row at which each sample goes in: the even ones first, then the odd ones backwards.
    back : ndarray of int, shape (n,)
        Row in which each sample stands after a transform back.
    natural : ndarray of int, shape (n,)
        0, 1, ... n-1.
    twiddles : ndarray, shape (2, number)
        Cosines and sines of the passes, one after the other.
    roots : ndarray, shape (2, number)
        Cosines and sines of the odd radices above 5.
    quarter : ndarray, shape (2, n)
        ``cos(pi k / (2 n))`` and ``sin(pi k / (2 n))``.
    """

    radices: NDArray[np.intp]
    results: NDArray[np.intp]
    forth: NDArray[np.intp]
    back: NDArray[np.intp]
    natural: NDArray[np.intp]
    twiddles: Array
    roots: Array
    quarter: Array


@lru_cache(maxsize=128)
def line_plan(n: int, dtype: np.dtype) -> LinePlan:
    """Return the plan for lines of length `n`.

    Parameters
    ----------
    n : int
        Length, at least 1. Any length works; a prime factor above 5 costs its square.
    dtype : dtype
        float32 or float64.

    Returns
    -------
    LinePlan
        The plan.
    """
    radices = _radices(n)
    twiddles, roots, rest = [], [], n
    for radix in radices:
        rest //= radix
        twiddles.append(-2.0 * np.pi * np.outer(np.arange(rest), np.arange(1, radix)).ravel() / (rest * radix))
        if radix > 5:
            roots.append(-2.0 * np.pi * np.arange(radix) / radix)
    samples = np.concatenate([np.arange(0, n, 2), np.arange(n - 1 - n % 2, 0, -2)])
    forth = np.argsort(samples)
    results = np.argsort(_digits_reversed(radices))
    return LinePlan(
        radices=np.array(radices, np.intp),
        results=results.astype(np.intp),
        forth=forth.astype(np.intp),
        back=results[forth].astype(np.intp),
        natural=np.arange(n, dtype=np.intp),
        twiddles=_cosines_and_sines(twiddles, dtype),
        roots=_cosines_and_sines(roots, dtype),
        quarter=_cosines_and_sines([np.pi * np.arange(n) / (2 * n)], dtype),
    )


def _radices(n: int) -> list[int]:
    radices, rest = [], n
    for radix in (4, 2, 3, 5):
        while rest % radix == 0:
            radices.append(radix)
            rest //= radix
    radix = 7
    while rest > 1:
        if rest % radix == 0:
            radices.append(radix)
            rest //= radix
        else:
            radix += 2
    return radices


def _digits_reversed(radices: list[int]) -> NDArray[np.intp]:
    """Return the frequency that stands in each row after the passes."""
    frequencies = np.zeros(1, np.intp)
    for radix in reversed(radices):
        frequencies = np.concatenate([frequencies * radix + j for j in range(radix)])
    return frequencies


def _cosines_and_sines(angles: list[NDArray[np.float64]], dtype: np.dtype) -> Array:
    angle = np.concatenate(angles) if angles else np.zeros(0)
    return np.array([np.cos(angle), np.sin(angle)]).astype(dtype)


@jit
def get(work: Array, row: int) -> tuple[Lanes, Lanes]:
    """Return the real and the imaginary part of a row."""
    return load(work, 2 * row, 0), load(work, 2 * row + 1, 0)


@jit
def put(work: Array, row: int, x: Lanes, y: Lanes) -> None:
    """Write the real and the imaginary part of a row."""
    store(work, 2 * row, 0, x)
    store(work, 2 * row + 1, 0, y)


@jit
def _put_turned(work: Array, row: int, x: Lanes, y: Lanes, twiddles: Array, k: int) -> None:
    """Write a row times a twiddle factor."""
    c, s = twiddles[0, k], twiddles[1, k]
    put(work, row, c * x - s * y, c * y + s * x)


@jit
def fourier(work: Array, base: int, plan: LinePlan) -> None:
    """Transform the rows `base`, `base` + 1, ... of `work` in place; ``plan.results`` says what then is where."""
    n = plan.results.size
    zero = int(np.intp(0))  # a literal 0 would have every pass compiled twice, once for it
    rest, first_twiddle, first_root = n, zero, zero
    for radix in plan.radices:
        rest //= radix
        for start in range(base, base + n, radix * rest):
            if radix == 4:
                _radix4(work, start, rest, plan.twiddles, first_twiddle)
            elif radix == 2:
                _radix2(work, start, rest, plan.twiddles, first_twiddle)
            elif radix == 3:
                _radix3(work, start, rest, plan.twiddles, first_twiddle)
            elif radix == 5:
                _radix5(work, start, rest, plan.twiddles, first_twiddle)
            else:
                _odd_radix(work, start, radix, rest, plan.twiddles, first_twiddle, plan.roots, first_root)
        first_twiddle += rest * (radix - 1)
        if radix > 5:
            first_root += radix


@jit
def _radix2(work: Array, start: int, rest: int, twiddles: Array, first: int) -> None:
    for p in range(rest):
        row = start + p
        ar, ai = get(work, row)
        br, bi = get(work, row + rest)
        put(work, row, ar + br, ai + bi)
        _put_turned(work, row + rest, ar - br, ai - bi, twiddles, first + p)


@jit
def _radix3(work: Array, start: int, rest: int, twiddles: Array, first: int) -> None:
    half = twiddles.dtype.type(0.5)
    root = twiddles.dtype.type(np.sqrt(0.75))
    for p in range(rest):
        row, k = start + p, first + 2 * p
        ar, ai = get(work, row)
        br, bi = get(work, row + rest)
        cr, ci = get(work, row + 2 * rest)
        sr, si = br + cr, bi + ci
        dr, di = root * (br - cr), root * (bi - ci)
        mr, mi = ar - half * sr, ai - half * si
        put(work, row, ar + sr, ai + si)
        _put_turned(work, row + rest, mr + di, mi - dr, twiddles, k)
        _put_turned(work, row + 2 * rest, mr - di, mi + dr, twiddles, k + 1)


@jit
def _radix4(work: Array, start: int, rest: int, twiddles: Array, first: int) -> None:
    for p in range(rest):
        row, k = start + p, first + 3 * p
        ar, ai = get(work, row)
        br, bi = get(work, row + rest)
        cr, ci = get(work, row + 2 * rest)
        dr, di = get(work, row + 3 * rest)
        er, ei, fr, fi = ar + cr, ai + ci, ar - cr, ai - ci
        gr, gi, hr, hi = br + dr, bi + di, br - dr, bi - di
        put(work, row, er + gr, ei + gi)
        _put_turned(work, row + rest, fr + hi, fi - hr, twiddles, k)
        _put_turned(work, row + 2 * rest, er - gr, ei - gi, twiddles, k + 1)
        _put_turned(work, row + 3 * rest, fr - hi, fi + hr, twiddles, k + 2)


@jit
def _radix5(work: Array, start: int, rest: int, twiddles: Array, first: int) -> None:
    real = twiddles.dtype.type
    c1, c2 = real(np.cos(0.4 * np.pi)), real(np.cos(0.8 * np.pi))
    s1, s2 = real(np.sin(0.4 * np.pi)), real(np.sin(0.8 * np.pi))
    for p in range(rest):
        row, k = start + p, first + 4 * p
        ar, ai = get(work, row)
        br, bi = get(work, row + rest)
        cr, ci = get(work, row + 2 * rest)
        dr, di = get(work, row + 3 * rest)
        er, ei = get(work, row + 4 * rest)
        pr, pi, qr, qi = br + er, bi + ei, br - er, bi - ei
        ur, ui, vr, vi = cr + dr, ci + di, cr - dr, ci - di
        put(work, row, ar + pr + ur, ai + pi + ui)
        mr, mi = ar + c1 * pr + c2 * ur, ai + c1 * pi + c2 * ui
        nr, ni = s1 * qr + s2 * vr, s1 * qi + s2 * vi
        _put_turned(work, row + rest, mr + ni, mi - nr, twiddles, k)
        _put_turned(work, row + 4 * rest, mr - ni, mi + nr, twiddles, k + 3)
        mr, mi = ar + c2 * pr + c1 * ur, ai + c2 * pi + c1 * ui
        nr, ni = s2 * qr - s1 * vr, s2 * qi - s1 * vi
        _put_turned(work, row + 2 * rest, mr + ni, mi - nr, twiddles, k + 1)
        _put_turned(work, row + 3 * rest, mr - ni, mi + nr, twiddles, k + 2)


@jit
def _odd_radix(
    work: Array, start: int, radix: int, rest: int, twiddles: Array, first: int, roots: Array, first_root: int
) -> None:
    # The terms j and radix - j share their cosine and, but for the sign, their sine: half the products.
    half = radix // 2
    sums = np.empty((2 * half + 2, LANES), work.dtype)
    differences = np.empty((2 * half + 2, LANES), work.dtype)
    for p in range(rest):
        row, k = start + p, first + (radix - 1) * p
        ar, ai = get(work, row)
        tr, ti, zero = ar, ai, ar - ar
        for j in range(1, half + 1):
            xr, xi = get(work, row + j * rest)
            yr, yi = get(work, row + (radix - j) * rest)
            put(sums, j, xr + yr, xi + yi)
            put(differences, j, xr - yr, xi - yi)
            tr, ti = tr + (xr + yr), ti + (xi + yi)
        put(work, row, tr, ti)
        for i in range(1, half + 1, 3):  # three at a time: each term, once loaded, serves three sums
            fr, fi, gr, gi, hr, hi = ar, ai, ar, ai, ar, ai
            pr, pi, qr, qi, tr, ti = zero, zero, zero, zero, zero, zero
            f, g, h = 0, 0, 0
            for j in range(1, half + 1):
                f, g, h = _next(f, i, radix), _next(g, i + 1, radix), _next(h, i + 2, radix)
                xr, xi = get(sums, j)
                yr, yi = get(differences, j)
                c, s = roots[0, first_root + f], roots[1, first_root + f]
                fr, fi, pr, pi = fr + c * xr, fi + c * xi, pr + s * yr, pi + s * yi
                c, s = roots[0, first_root + g], roots[1, first_root + g]
                gr, gi, qr, qi = gr + c * xr, gi + c * xi, qr + s * yr, qi + s * yi
                c, s = roots[0, first_root + h], roots[1, first_root + h]
                hr, hi, tr, ti = hr + c * xr, hi + c * xi, tr + s * yr, ti + s * yi
            _put_mirrored(work, row, rest, i, radix, fr, fi, pr, pi, twiddles, k)
            if i + 1 <= half:
                _put_mirrored(work, row, rest, i + 1, radix, gr, gi, qr, qi, twiddles, k)
            if i + 2 <= half:
                _put_mirrored(work, row, rest, i + 2, radix, hr, hi, tr, ti, twiddles, k)


@jit
def _next(at: int, step: int, radix: int) -> int:
    at += step
    return at - radix if at >= radix else at


@jit
def _put_mirrored(
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
    _put_turned(work, row + i * rest, xr - yi, xi + yr, twiddles, k + i - 1)
    _put_turned(work, row + (radix - i) * rest, xr + yi, xi - yr, twiddles, k + radix - i - 1)
