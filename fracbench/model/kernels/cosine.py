r"""Fast cosine and sine transforms of the lines of an image, along either axis.

Lines and their transforms are real: two lines are the real and the imaginary part of one complex Fourier
transform of length n (Makhoul 1980), and two times eight lines are transformed at a time. Samples
``x(j)`` have the orthonormal coefficients ``C(k) = beta(k) sum_j x(j) cos(pi k (2 j + 1) / (2 n))`` and
``S(k)``, the same with the sine, for ``j, k = 0..n-1``, ``beta(0) = sqrt(1/n)``, else ``sqrt(2/n)``: the DCT-II,
and the DST-II numbered by frequency (``S(0) = 0``; frequency n, absent from a cosine series, is left out).

Each transform takes the lines from a start to a stop, so that threads can share an image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.fft import LinePlan, fourier
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import (
    LANES,
    gather_square,
    load,
    load_complex,
    scatter_square,
    store,
    store_complex,
)

#: Lines that are transformed together.
LINES = 2 * LANES

# --- eight lines out of an image and back ------------------------------------------------------------------


@jit
def gather(image: Array, axis: int, first: int, rows: NDArray[np.intp], work: Array, base: int) -> None:
    """Copy element j of the 16 lines from `first` on to row ``base + rows[j]``.

    Where fewer than 16 are left, the last one is repeated.
    """
    if axis == 0 and first + LINES <= image.shape[1]:
        for j in range(len(image)):  # both at once: they share a cache line
            store_complex(work, base + rows[j], load(image, j, first), load(image, j, first + LANES))
        return
    for part in range(2):
        _gather_eight(image, axis, first + part * LANES, rows, work, 2 * base + part)


@jit
def _gather_eight(image: Array, axis: int, first: int, rows: NDArray[np.intp], work: Array, part: int) -> None:
    n, count = image.shape[axis], image.shape[1 - axis]
    done = 0
    if first + LANES <= count and axis == 0:
        for j in range(n):
            store(work, 2 * rows[j] + part, 0, load(image, j, first))
        done = n
    elif first + LANES <= count:
        done = n - n % LANES
        for j in range(0, done, LANES):
            gather_square(image, first, j, rows, work, part)
    for i in range(LANES):
        line = min(first + i, count - 1)
        for j in range(done, n):
            work[2 * rows[j] + part, i] = image[line, j] if axis == 1 else image[j, line]


@jit
def scatter(
    work: Array, base: int, rows: NDArray[np.intp], image: Array, axis: int, first: int, turned: bool
) -> None:
    """Undo `gather`; if `turned`, the imaginary parts hold the first eight lines."""
    if axis == 0 and first + LINES <= image.shape[1]:
        one, other = (first + LANES, first) if turned else (first, first + LANES)
        for j in range(len(image)):
            x, y = load_complex(work, base + rows[j])
            store(image, j, one, x)
            store(image, j, other, y)
        return
    for part in range(2):
        _scatter_eight(work, 2 * base + (1 - part if turned else part), rows, image, axis, first + part * LANES)


@jit
def _scatter_eight(work: Array, part: int, rows: NDArray[np.intp], image: Array, axis: int, first: int) -> None:
    n, count = image.shape[axis], image.shape[1 - axis]
    done = 0
    if first + LANES <= count and axis == 0:
        for j in range(n):
            store(image, j, first, load(work, 2 * rows[j] + part, 0))
        done = n
    elif first + LANES <= count:
        done = n - n % LANES
        for j in range(0, done, LANES):
            scatter_square(work, rows, part, image, first, j)
    for i in range(min(LANES, count - first)):
        for j in range(done, n):
            if axis == 1:
                image[first + i, j] = work[2 * rows[j] + part, i]
            else:
                image[j, first + i] = work[2 * rows[j] + part, i]


# --- between Fourier and cosine or sine coefficients, in place ---------------------------------------------


@jit
def _from_fourier(work: Array, base: int, plan: LinePlan, factor: Array, sine: bool) -> None:
    """Turn Fourier coefficients of a + i b into ``factor`` times the coefficients of a and b.

    A sine series is the reversed cosine series of the samples with alternating signs: the coefficient of
    frequency k is stored in the row of frequency n - k, and 0 in the row of frequency 0.
    """
    n = plan.results.size
    real = factor.dtype.type
    row = base + plan.results[0]
    x, y = load_complex(work, row)
    scale = real(0.0) if sine else factor[0] / np.sqrt(real(n))
    store_complex(work, row, scale * x, scale * y)
    scale = real(1.0) / np.sqrt(real(2 * n))
    for k in range(1, n // 2 + 1):
        low, high = base + plan.results[k], base + plan.results[n - k]
        c, s = scale * plan.quarter[0, k], scale * plan.quarter[1, k]
        p, q = load_complex(work, low)
        r, t = load_complex(work, high)
        ar, ai, br, bi = p + r, q - t, q + t, r - p
        f, g = (factor[n - k], factor[k]) if sine else (factor[k], factor[n - k])
        store_complex(work, high, g * (s * ar - c * ai), g * (s * br - c * bi))
        store_complex(work, low, f * (c * ar + s * ai), f * (c * br + s * bi))


@jit
def _to_fourier(work: Array, base: int, plan: LinePlan, factor: Array, sine: bool) -> None:
    """Turn coefficients of a and b, in natural order, times ``factor`` into the input of `fourier` for b + i a."""
    n = plan.results.size
    real = factor.dtype.type
    a, b = load_complex(work, base)
    scale = real(0.0) if sine else factor[0] / np.sqrt(real(n))
    store_complex(work, base, scale * b, scale * a)
    scale = real(1.0) / np.sqrt(real(2 * n))
    for k in range(1, n // 2 + 1):
        c, s = scale * plan.quarter[0, k], scale * plan.quarter[1, k]
        a_low, b_low = load_complex(work, base + k)
        a_high, b_high = load_complex(work, base + n - k)
        f, g = factor[k], factor[n - k]
        a_low, b_low, a_high, b_high = f * a_low, f * b_low, g * a_high, g * b_high
        if sine:
            a_low, b_low, a_high, b_high = a_high, b_high, a_low, b_low
        ar, ai = c * a_low + s * a_high, s * a_low - c * a_high
        br, bi = c * b_low + s * b_high, s * b_low - c * b_high
        store_complex(work, base + n - k, br - ai, ar + bi)
        store_complex(work, base + k, ai + br, ar - bi)


# --- the transforms ----------------------------------------------------------------------------------------


def cosine(x: Array, axis: int, start: int, stop: int, factor: Array, plan: LinePlan, out: Array) -> None:
    """Write ``factor(k) C(k)`` of the lines ``start..stop-1`` of `x`, which run along `axis`; `out` may be `x`.

    `start` is a multiple of `LINES`, `stop` is one or the number of lines.
    """
    _analyse(x, x, x, axis, start, stop, factor[:0], factor[:0], factor, plan, out)


def cosine_back(x: Array, axis: int, start: int, stop: int, factor: Array, plan: LinePlan, out: Array) -> None:
    """Write the lines whose cosine coefficients are ``factor(k) x(k)``; see `cosine`."""
    _synthesise(x, axis, start, stop, factor, factor[:0], plan, out, out)


def derivatives(
    x: Array, axis: int, start: int, stop: int, even: Array, odd: Array, plan: LinePlan, out: Array
) -> None:
    """Write left and right derivatives, ``A - B`` and ``A + B``, of lines given by their cosine coefficients `x`.

    A is the cosine series of ``even(k) x(k)``, B the sine series of ``odd(k) x(k)``. `out`, shape (2, 2, H, W), is
    by side (left, right) and direction (x, y); the direction of `axis` is written.
    """
    left, right = out[:, 1 - axis]
    _synthesise(x, axis, start, stop, even, odd, plan, left, right)


def derivatives_adjoint(
    d: Array, v: Array, axis: int, start: int, stop: int, even: Array, odd: Array, direct: Array, plan: LinePlan,
    out: Array,
) -> None:  # fmt: skip
    """Write the cosine coefficients of the adjoint of `derivatives`, applied to the lines of `d`, (2, 2, H, W).

    ``direct(k)`` times the cosine coefficients of `v` are added, unless `direct` is empty.
    """
    left, right = d[:, 1 - axis]
    _analyse(left, right, v, axis, start, stop, even, odd, direct, plan, out)


@jit
def _synthesise(
    x: Array, axis: int, start: int, stop: int, even: Array, odd: Array, plan: LinePlan, left: Array, right: Array
) -> None:
    """Write A to `left` if `odd` is empty, else ``A - B`` there and ``A + B`` to `right`; see `derivatives`."""
    n, series = plan.results.size, 2 if odd.size else 1
    work = np.empty((2 * series * n, LANES), x.dtype)
    for first in range(start, stop, LINES):
        gather(x, axis, first, plan.natural, work, int(np.intp(0)))  # as in `fourier`
        for row in range(n if series == 2 else 0):  # assigned as a slice it would take 3 s more to compile
            ar, ai = load_complex(work, row)
            store_complex(work, n + row, ar, ai)
        for i in range(series):
            _to_fourier(work, i * n, plan, even if i == 0 else odd, i > 0)
            fourier(work, i * n, plan)
        for sample in range(n if series == 2 else 0):
            row = plan.back[sample]
            ar, ai = load_complex(work, row)
            br, bi = load_complex(work, n + row)
            odd_sample = sample % 2  # B's samples have alternating signs
            store_complex(work, row + n * odd_sample, ar - br, ai - bi)
            store_complex(work, row + n * (1 - odd_sample), ar + br, ai + bi)
        for i in range(series):
            scatter(work, i * n, plan.back, left if i == 0 else right, axis, first, series > 0)


@jit
def _analyse(
    left: Array, right: Array, v: Array, axis: int, start: int, stop: int, even: Array, odd: Array, direct: Array,
    plan: LinePlan, out: Array,
) -> None:  # fmt: skip
    """Write the adjoint of `_synthesise` at `left` and `right` unless `even` is empty, and add that of `v`."""
    n, series = plan.results.size, 2 if even.size else 0
    work = np.empty((4 * n, LANES), v.dtype)
    for first in range(start, stop, LINES):
        for i in range(series):
            gather(left if i == 0 else right, axis, first, plan.forth, work, i * n)
        for row in range(n if series else 0):
            lr, li = load_complex(work, row)
            rr, ri = load_complex(work, n + row)
            store_complex(work, row, lr + rr, li + ri)
            if row >= n - n // 2:  # the odd samples
                store_complex(work, n + row, lr - rr, li - ri)
            else:
                store_complex(work, n + row, rr - lr, ri - li)
        for i in range(series):
            fourier(work, i * n, plan)
            _from_fourier(work, i * n, plan, even if i == 0 else odd, i > 0)
        for k in range(n if series else 0):
            # sine coefficient k is in the row of frequency n - k (see `_from_fourier`), coefficient 0 in its own
            _add_row(work, plan.results[k], n + plan.results[(n - k) % n])
        if direct.size:
            base = n if series else 0
            gather(v, axis, first, plan.forth, work, base)
            fourier(work, base, plan)
            _from_fourier(work, base, plan, direct, series < 0)
            for row in range(base):
                _add_row(work, row, n + row)
        scatter(work, int(np.intp(0)), plan.results, out, axis, first, series < 0)


@jit
def _add_row(work: Array, row: int, other: int) -> None:
    ar, ai = load_complex(work, row)
    br, bi = load_complex(work, other)
    store_complex(work, row, ar + br, ai + bi)
