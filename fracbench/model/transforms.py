r"""Fast cosine and sine transforms of both components of a flow at once, along either axis.

A component is real and so are its transforms, so the two components travel as the real and the imaginary part
of one complex Fourier transform of length n (Makhoul 1980), eight lines of the image at a time
(`fracbench.model._lanes`). With ``x(j)`` at ``j = 0..n-1``, all transforms are orthonormal:

``C(k) = beta(k) sum_j x(j) cos(pi k (2 j + 1) / (2 n))`` and ``S(k) = beta(k) sum_j x(j) sin(pi k (2 j + 1) / (2 n))``

for ``k = 0..n-1`` with ``beta(0) = sqrt(1/n)``, else ``sqrt(2/n)``: the DCT-II, and the DST-II numbered by
frequency (``S(0) = 0``; the frequency n, which a cosine series lacks, is left out).

Each transform takes lines from a start to a stop, so that threads can share an image.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracbench.model._jit import jit
from fracbench.model._lanes import LANES, load, store, transpose
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


# --- the complex Fourier transform of eight lines, in place ------------------------------------------------
# `work` holds complex rows of eight, one after another: rows 2 r and 2 r + 1 are the real and the imaginary
# part of row r. A transform takes the n rows from `base` on.


@jit
def _get(work, row):  # type: ignore[no-untyped-def]
    return load(work, 2 * row, 0), load(work, 2 * row + 1, 0)


@jit
def _put(work, row, x, y):  # type: ignore[no-untyped-def]
    store(work, 2 * row, 0, x)
    store(work, 2 * row + 1, 0, y)


@jit
def _put_turned(work, row, x, y, twiddles, k):  # type: ignore[no-untyped-def]
    """Write a row times a twiddle factor."""
    c, s = twiddles[0, k], twiddles[1, k]
    _put(work, row, c * x - s * y, c * y + s * x)


@jit
def fourier(work: Array, base: int, plan: LinePlan) -> None:
    """Transform the rows `base`, `base` + 1, ... of `work` in place; ``plan.results`` says what then is where."""
    n = plan.results.size
    rest, first_twiddle, first_root = n, 0, 0
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
def _radix2(work, start, rest, twiddles, first):  # type: ignore[no-untyped-def]
    for p in range(rest):
        row = start + p
        ar, ai = _get(work, row)
        br, bi = _get(work, row + rest)
        _put(work, row, ar + br, ai + bi)
        _put_turned(work, row + rest, ar - br, ai - bi, twiddles, first + p)


@jit
def _radix3(work, start, rest, twiddles, first):  # type: ignore[no-untyped-def]
    half = twiddles.dtype.type(0.5)
    root = twiddles.dtype.type(np.sqrt(0.75))
    for p in range(rest):
        row, k = start + p, first + 2 * p
        ar, ai = _get(work, row)
        br, bi = _get(work, row + rest)
        cr, ci = _get(work, row + 2 * rest)
        sr, si = br + cr, bi + ci
        dr, di = root * (br - cr), root * (bi - ci)
        mr, mi = ar - half * sr, ai - half * si
        _put(work, row, ar + sr, ai + si)
        _put_turned(work, row + rest, mr + di, mi - dr, twiddles, k)
        _put_turned(work, row + 2 * rest, mr - di, mi + dr, twiddles, k + 1)


@jit
def _radix4(work, start, rest, twiddles, first):  # type: ignore[no-untyped-def]
    for p in range(rest):
        row, k = start + p, first + 3 * p
        ar, ai = _get(work, row)
        br, bi = _get(work, row + rest)
        cr, ci = _get(work, row + 2 * rest)
        dr, di = _get(work, row + 3 * rest)
        er, ei, fr, fi = ar + cr, ai + ci, ar - cr, ai - ci
        gr, gi, hr, hi = br + dr, bi + di, br - dr, bi - di
        _put(work, row, er + gr, ei + gi)
        _put_turned(work, row + rest, fr + hi, fi - hr, twiddles, k)
        _put_turned(work, row + 2 * rest, er - gr, ei - gi, twiddles, k + 1)
        _put_turned(work, row + 3 * rest, fr - hi, fi + hr, twiddles, k + 2)


@jit
def _radix5(work, start, rest, twiddles, first):  # type: ignore[no-untyped-def]
    real = twiddles.dtype.type
    c1, c2 = real(np.cos(0.4 * np.pi)), real(np.cos(0.8 * np.pi))
    s1, s2 = real(np.sin(0.4 * np.pi)), real(np.sin(0.8 * np.pi))
    for p in range(rest):
        row, k = start + p, first + 4 * p
        ar, ai = _get(work, row)
        br, bi = _get(work, row + rest)
        cr, ci = _get(work, row + 2 * rest)
        dr, di = _get(work, row + 3 * rest)
        er, ei = _get(work, row + 4 * rest)
        pr, pi, qr, qi = br + er, bi + ei, br - er, bi - ei
        ur, ui, vr, vi = cr + dr, ci + di, cr - dr, ci - di
        _put(work, row, ar + pr + ur, ai + pi + ui)
        mr, mi = ar + c1 * pr + c2 * ur, ai + c1 * pi + c2 * ui
        nr, ni = s1 * qr + s2 * vr, s1 * qi + s2 * vi
        _put_turned(work, row + rest, mr + ni, mi - nr, twiddles, k)
        _put_turned(work, row + 4 * rest, mr - ni, mi + nr, twiddles, k + 3)
        mr, mi = ar + c2 * pr + c1 * ur, ai + c2 * pi + c1 * ui
        nr, ni = s2 * qr - s1 * vr, s2 * qi - s1 * vi
        _put_turned(work, row + 2 * rest, mr + ni, mi - nr, twiddles, k + 1)
        _put_turned(work, row + 3 * rest, mr - ni, mi + nr, twiddles, k + 2)


@jit
def _odd_radix(work, start, radix, rest, twiddles, first, roots, first_root):  # type: ignore[no-untyped-def]
    # The terms j and radix - j share their cosine and, but for the sign, their sine: half the products.
    half = radix // 2
    sums = np.empty((2 * half + 2, LANES), work.dtype)
    differences = np.empty((2 * half + 2, LANES), work.dtype)
    for p in range(rest):
        row, k = start + p, first + (radix - 1) * p
        ar, ai = _get(work, row)
        tr, ti, zero = ar, ai, ar - ar
        for j in range(1, half + 1):
            xr, xi = _get(work, row + j * rest)
            yr, yi = _get(work, row + (radix - j) * rest)
            _put(sums, j, xr + yr, xi + yi)
            _put(differences, j, xr - yr, xi - yi)
            tr, ti = tr + (xr + yr), ti + (xi + yi)
        _put(work, row, tr, ti)
        for i in range(1, half + 1, 3):  # three at a time: each term, once loaded, serves three sums
            fr, fi, gr, gi, hr, hi = ar, ai, ar, ai, ar, ai
            pr, pi, qr, qi, tr, ti = zero, zero, zero, zero, zero, zero
            f, g, h = 0, 0, 0
            for j in range(1, half + 1):
                f, g, h = _next(f, i, radix), _next(g, i + 1, radix), _next(h, i + 2, radix)
                xr, xi = _get(sums, j)
                yr, yi = _get(differences, j)
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
def _next(at, step, radix):  # type: ignore[no-untyped-def]
    at += step
    return at - radix if at >= radix else at


@jit
def _put_mirrored(work, row, rest, i, radix, xr, xi, yr, yi, twiddles, k):  # type: ignore[no-untyped-def]
    """Write the results i and radix - i: cosine sum plus and minus i times the sine sum."""
    _put_turned(work, row + i * rest, xr - yi, xi + yr, twiddles, k + i - 1)
    _put_turned(work, row + (radix - i) * rest, xr + yi, xi - yr, twiddles, k + radix - i - 1)


# --- eight lines out of an image and back ------------------------------------------------------------------


@jit
def _gather(image, axis, first, rows, work, part):  # type: ignore[no-untyped-def]
    """Put element j of the lines `first`, `first` + 1, ... into ``work[2 rows[j] + part]``.

    Where fewer than eight lines are left, the last one is repeated.
    """
    n, count = image.shape[axis], image.shape[1 - axis]
    done = 0
    if first + LANES <= count:
        done = n - n % LANES if axis == 1 else n
        if axis == 0:
            for j in range(n):
                store(work, 2 * rows[j] + part, 0, load(image, j, first))
        for j in range(0, done if axis == 1 else 0, LANES):
            r = first
            turned = transpose(
                (
                    load(image, r, j), load(image, r + 1, j), load(image, r + 2, j), load(image, r + 3, j),
                    load(image, r + 4, j), load(image, r + 5, j), load(image, r + 6, j), load(image, r + 7, j),
                )
            )  # fmt: skip
            store(work, 2 * rows[j] + part, 0, turned[0])
            store(work, 2 * rows[j + 1] + part, 0, turned[1])
            store(work, 2 * rows[j + 2] + part, 0, turned[2])
            store(work, 2 * rows[j + 3] + part, 0, turned[3])
            store(work, 2 * rows[j + 4] + part, 0, turned[4])
            store(work, 2 * rows[j + 5] + part, 0, turned[5])
            store(work, 2 * rows[j + 6] + part, 0, turned[6])
            store(work, 2 * rows[j + 7] + part, 0, turned[7])
    for i in range(LANES):
        line = min(first + i, count - 1)
        for j in range(done, n):
            work[2 * rows[j] + part, i] = image[line, j] if axis == 1 else image[j, line]


@jit
def _scatter(work, part, rows, image, axis, first):  # type: ignore[no-untyped-def]
    """Undo `_gather`."""
    n, count = image.shape[axis], image.shape[1 - axis]
    done = 0
    if first + LANES <= count:
        done = n - n % LANES if axis == 1 else n
        if axis == 0:
            for j in range(n):
                store(image, j, first, load(work, 2 * rows[j] + part, 0))
        for j in range(0, done if axis == 1 else 0, LANES):
            turned = transpose(
                (
                    load(work, 2 * rows[j] + part, 0), load(work, 2 * rows[j + 1] + part, 0),
                    load(work, 2 * rows[j + 2] + part, 0), load(work, 2 * rows[j + 3] + part, 0),
                    load(work, 2 * rows[j + 4] + part, 0), load(work, 2 * rows[j + 5] + part, 0),
                    load(work, 2 * rows[j + 6] + part, 0), load(work, 2 * rows[j + 7] + part, 0),
                )
            )  # fmt: skip
            store(image, first, j, turned[0])
            store(image, first + 1, j, turned[1])
            store(image, first + 2, j, turned[2])
            store(image, first + 3, j, turned[3])
            store(image, first + 4, j, turned[4])
            store(image, first + 5, j, turned[5])
            store(image, first + 6, j, turned[6])
            store(image, first + 7, j, turned[7])
    for i in range(min(LANES, count - first)):
        for j in range(done, n):
            if axis == 1:
                image[first + i, j] = work[2 * rows[j] + part, i]
            else:
                image[j, first + i] = work[2 * rows[j] + part, i]


# --- between Fourier and cosine or sine coefficients, in place ---------------------------------------------


@jit
def _from_fourier(work, base, plan, factor, sine):  # type: ignore[no-untyped-def]
    """Turn Fourier coefficients of a + i b into ``factor`` times the coefficients of a and b.

    A sine series is a cosine series turned round, of samples of which every other one is negative: that of
    frequency k then stands in the row of frequency n - k, and 0 in the row of frequency 0.
    """
    n = plan.results.size
    real = factor.dtype.type
    row = base + plan.results[0]
    x, y = _get(work, row)
    scale = real(0.0) if sine else factor[0] / np.sqrt(real(n))
    _put(work, row, scale * x, scale * y)
    scale = real(1.0) / np.sqrt(real(2 * n))
    for k in range(1, n // 2 + 1):
        low, high = base + plan.results[k], base + plan.results[n - k]
        c, s = scale * plan.quarter[0, k], scale * plan.quarter[1, k]
        p, q = _get(work, low)
        r, t = _get(work, high)
        ar, ai, br, bi = p + r, q - t, q + t, r - p
        f, g = (factor[n - k], factor[k]) if sine else (factor[k], factor[n - k])
        _put(work, high, g * (s * ar - c * ai), g * (s * br - c * bi))
        _put(work, low, f * (c * ar + s * ai), f * (c * br + s * bi))


@jit
def _to_fourier(work, base, plan, factor, sine):  # type: ignore[no-untyped-def]
    """Turn coefficients of a and b, in natural order, into what `fourier` makes b + i a of, times ``factor``."""
    n = plan.results.size
    real = factor.dtype.type
    a, b = _get(work, base)
    scale = real(0.0) if sine else factor[0] / np.sqrt(real(n))
    _put(work, base, scale * b, scale * a)
    scale = real(1.0) / np.sqrt(real(2 * n))
    for k in range(1, n // 2 + 1):
        c, s = scale * plan.quarter[0, k], scale * plan.quarter[1, k]
        a_low, b_low = _get(work, base + k)
        a_high, b_high = _get(work, base + n - k)
        f, g = factor[k], factor[n - k]
        a_low, b_low, a_high, b_high = f * a_low, f * b_low, g * a_high, g * b_high
        if sine:
            a_low, b_low, a_high, b_high = a_high, b_high, a_low, b_low
        ar, ai = c * a_low + s * a_high, s * a_low - c * a_high
        br, bi = c * b_low + s * b_high, s * b_low - c * b_high
        _put(work, base + n - k, br - ai, ar + bi)
        _put(work, base + k, ai + br, ar - bi)


# --- the transforms ----------------------------------------------------------------------------------------


@jit
def cosine(x: Array, axis: int, start: int, stop: int, factor: Array, plan: LinePlan, out: Array) -> None:
    """Write ``factor(k) C(k)`` of the lines ``start..stop-1``.

    Parameters
    ----------
    x : ndarray, shape (2, H, W), C-contiguous
        Both components.
    axis : {0, 1}
        Axis of an image along which the lines run.
    start, stop : int
        Lines; `start` is a multiple of LANES, and `stop` is one or the number of lines.
    factor : ndarray, shape (n,)
        What the coefficients are multiplied by.
    plan : LinePlan
        Plan for n in x's precision.
    out : ndarray, shape (2, H, W), C-contiguous
        Coefficients; may be `x`.
    """
    work = np.empty((2 * plan.results.size, LANES), x.dtype)
    for first in range(start, stop, LANES):
        for component in range(2):
            _gather(x[component], axis, first, plan.forth, work, component)
        fourier(work, 0, plan)
        _from_fourier(work, 0, plan, factor, False)
        for component in range(2):
            _scatter(work, component, plan.results, out[component], axis, first)


@jit
def cosine_back(x: Array, axis: int, start: int, stop: int, factor: Array, plan: LinePlan, out: Array) -> None:
    """Write the lines whose cosine coefficients are ``factor(k) x(k)``; parameters as for `cosine`."""
    work = np.empty((2 * plan.results.size, LANES), x.dtype)
    for first in range(start, stop, LANES):
        for component in range(2):
            _gather(x[component], axis, first, plan.natural, work, component)
        _to_fourier(work, 0, plan, factor, False)
        fourier(work, 0, plan)
        for component in range(2):
            _scatter(work, 1 - component, plan.back, out[component], axis, first)


@jit
def derivatives(
    x: Array, axis: int, start: int, stop: int, even: Array, odd: Array, plan: LinePlan, out: Array
) -> None:
    """Write left and right derivatives, ``A - B`` and ``A + B``, of lines given by their cosine coefficients.

    Parameters
    ----------
    x : ndarray, shape (2, H, W), C-contiguous
        Cosine coefficients of both components along `axis`.
    axis, start, stop, plan
        See `cosine`.
    even, odd : ndarray, shape (n,)
        A is the cosine series of ``even(k) x(k)``, B the sine series of ``odd(k) x(k)``.
    out : ndarray, shape (2, 2, 2, H, W), C-contiguous
        By component, side (left, right) and direction (x, y); the direction of `axis` is written.
    """
    n = plan.results.size
    work = np.empty((4 * n, LANES), x.dtype)
    for first in range(start, stop, LANES):
        for base in (0, n):
            for component in range(2):
                _gather(x[component], axis, first, plan.natural, work, 2 * base + component)
            _to_fourier(work, base, plan, even if base == 0 else odd, base > 0)
            fourier(work, base, plan)
        for sample in range(n):
            row = plan.back[sample]
            br, bi = _get(work, row)
            dr, di = _get(work, n + row)
            if sample % 2 == 1:  # of B's samples every other one is negative
                _put(work, row, br + dr, bi + di)
                _put(work, n + row, br - dr, bi - di)
            else:
                _put(work, row, br - dr, bi - di)
                _put(work, n + row, br + dr, bi + di)
        for component in range(2):
            for side in range(2):
                image = out[component, side, 1 - axis]
                _scatter(work, 2 * n * side + 1 - component, plan.back, image, axis, first)


@jit
def derivatives_adjoint(
    d: Array,
    v: Array,
    axis: int,
    start: int,
    stop: int,
    even: Array,
    odd: Array,
    direct: Array,
    plan: LinePlan,
    out: Array,
) -> None:
    """Write the cosine coefficients of the adjoint of `derivatives`, applied to the lines of `d`.

    Parameters
    ----------
    d : ndarray, shape (2, 2, 2, H, W), C-contiguous
        By component, side and direction; the direction of `axis` is read.
    v : ndarray, shape (2, H, W), C-contiguous
        ``direct(k)`` times its cosine coefficients are added.
    axis, start, stop, even, odd, plan
        See `derivatives`.
    direct : ndarray, shape (n,) or (0,)
        See `v`; (0,) for nothing to add.
    out : ndarray, shape (2, H, W), C-contiguous
        Cosine coefficients along `axis`.
    """
    n = plan.results.size
    parts = 3 if direct.size else 2
    work = np.empty((2 * parts * n, LANES), d.dtype)
    for first in range(start, stop, LANES):
        for component in range(2):
            for side in range(2):
                image = d[component, side, 1 - axis]
                _gather(image, axis, first, plan.forth, work, 2 * n * side + component)
            if parts == 3:
                _gather(v[component], axis, first, plan.forth, work, 4 * n + component)
        for row in range(n):
            lr, li = _get(work, row)
            rr, ri = _get(work, n + row)
            _put(work, row, lr + rr, li + ri)
            if row >= n - n // 2:  # the odd samples
                _put(work, n + row, lr - rr, li - ri)
            else:
                _put(work, n + row, rr - lr, ri - li)
        for part in range(parts):
            fourier(work, part * n, plan)
            factor = even if part == 0 else odd if part == 1 else direct
            _from_fourier(work, part * n, plan, factor, part == 1)
        for k in range(n):
            row = plan.results[k]
            ar, ai = _get(work, row)
            # a sine coefficient stands in its mirror's row, that of frequency 0 (nothing) in its own
            br, bi = _get(work, n + plan.results[(n - k) % n])
            ar, ai = ar + br, ai + bi
            if parts == 3:
                cr, ci = _get(work, 2 * n + row)
                ar, ai = ar + cr, ai + ci
            _put(work, row, ar, ai)
        for component in range(2):
            _scatter(work, component, plan.results, out[component], axis, first)


@jit
def multiply_sum(x: Array, y: Array, factor: Array) -> None:
    """Write ``factor (x + y)`` to `x`.

    Parameters
    ----------
    x, y : ndarray, shape (2, H, W)
        Coefficients of both components.
    factor : ndarray, shape (H, W)
        The same for both.
    """
    for component in range(2):
        for i in range(factor.shape[0]):
            for j in range(factor.shape[1]):
                x[component, i, j] = factor[i, j] * (x[component, i, j] + y[component, i, j])
