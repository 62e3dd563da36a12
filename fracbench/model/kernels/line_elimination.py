r"""The u-system under `zero`, solved line by line once a basis has made the other axis diagonal.

A left derivative is the output of a linear system with few states (`kernels.exponential_sum`). Before sample j
the states are ``x_0 = u(j - 1)`` and, for each exponential, ``x_m = sum_{k >= 2} rho_m^(k - 2) u(j - k)``; the
output is ``u(j) + w x`` with ``w = (w_1, c_1, ..., c_M)``. So ``(s + mu T^T T) u = f`` is a linear-quadratic
control problem: minimise ``sum_j s/2 u(j)^2 + mu/2 (u(j) + w x(j))^2 - f(j) u(j)``. By dynamic programming from
the last sample back, the best u(j) is linear in the states before it, and the remaining cost quadratic in them,

    ``u(j) = (f(j) + q_0(j + 1)) / r(j) - k(j) x(j)``.

The gains k and r depend on s and mu only (a Riccati recursion). With them a line takes one backward pass for q and
one forward pass for x. With a single state it is the elimination in `fracbench.model.kernels.forward_rows`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.cosine import LINES, gather, scatter
from fracbench.model.kernels.exponential_sum import ExponentialSum
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import LANES, load_complex, store_complex


class LineGains(NamedTuple):
    """The factorisation of the lines' systems."""

    #: ``1 / r`` and the gains on x, of `LINES` lines each, (number, 2 (M + 2), LANES).
    rows: Array
    #: Row of each block of lines and each sample, counted from the last one, (blocks, n). The gains converge, so
    #: that many samples have the same row.
    which: NDArray[np.intp]


def line_gains(weights: ExponentialSum, direct: Float64Array, mu: float, n: int) -> LineGains:
    """Factorise the lines' systems, ``direct(i) + mu T^T T``; the first weight of T is 1."""
    blocks, dtype = math.ceil(len(direct) / LINES), weights.ratios.dtype
    lanes = np.pad(direct, (0, blocks * LINES - len(direct)), mode="edge").reshape(blocks, LINES)
    known = np.concatenate([weights.taps[1:], weights.factors]).astype(np.float64)
    ratios, tolerance = weights.ratios.astype(np.float64), float(np.finfo(dtype).eps)
    room, which = np.empty((n, len(known) + 1, LINES), dtype), np.empty((blocks, n), np.intp)
    parts, number = [], 0
    for lane, place in zip(lanes, which, strict=True):
        parts.append(room[: _eliminate(known, ratios, lane, mu, tolerance, room, place)].copy())
        place += number
        number += len(parts[-1])
    return LineGains(np.concatenate(parts).reshape(number, -1, LANES), which)


@jit
def _eliminate(
    known: Float64Array, ratios: Float64Array, lanes: Float64Array, mu: float, tolerance: float, rows: Array,
    which: NDArray[np.intp],
) -> int:  # fmt: skip
    """Write the gains of some lines, a new row when they change by more than rounding; return the number of rows.

    The cost matrix changes by ``change y y^T``, of rank one, in each step, so that a step takes a few operations a
    state (the Riccati recursion in Chandrasekhar's form).
    """
    n, states = len(rows), known.size
    r = lanes + mu
    change = mu * lanes / r
    y, kr = np.empty((states, LINES)), np.empty((states, LINES))
    for m in range(states):
        y[m] = known[m]
        kr[m] = mu * known[m]
    gain, kept = np.empty((states, LINES)), np.zeros((states, LINES))
    inverse, drift = np.empty(LINES), np.empty(LINES)
    number, since = 0, 0
    for step in range(n):
        for i in range(LINES):
            inverse[i] = 1.0 / r[i]
            drift[i] = 0.0
        for m in range(states):
            reach = 1.0 / (1.0 - ratios[m - 1]) if m > 0 else 1.0  # the largest x_m for u of size 1
            for i in range(LINES):
                gain[m, i] = kr[m, i] * inverse[i]
                drift[i] += reach * abs(gain[m, i] - kept[m, i])
        moved = step == 0
        for i in range(LINES):  # NumPy's maximum takes half a second to compile
            moved = moved or drift[i] > tolerance
        if moved:
            for i in range(LINES):
                rows[number, 0, i] = inverse[i]
            for m in range(states):
                for i in range(LINES):
                    rows[number, m + 1, i] = kept[m, i] = gain[m, i]
            number, since = number + 1, step
        which[step] = number - 1
        # the gains converge at least as 1 / step: the remaining change is at most as much again
        if step > 2 * since:
            which[step:] = number - 1
            break
        _step_back(ratios, gain, r, change, kr, y)
    return number


@jit
def _step_back(
    ratios: Float64Array, gain: Float64Array, r: Float64Array, change: Float64Array, kr: Float64Array,
    y: Float64Array,
) -> None:  # fmt: skip
    """Go back by one sample; forwards the states go ``x_m <- rho_m x_m + x_0``, ``x_0 <- u``."""
    passed, fed, rise = np.zeros(LINES), np.empty(LINES), np.empty(LINES)
    for m in range(1, len(y)):
        for i in range(LINES):
            passed[i] += y[m, i]
    for i in range(LINES):
        fed[i] = y[0, i]
        rise[i] = change[i] * fed[i]
        larger = r[i] + rise[i] * fed[i]
        change[i] *= r[i] / larger
        r[i] = larger
    for m in range(len(y)):
        for i in range(LINES):
            back = ratios[m - 1] * y[m, i] if m > 0 else passed[i]
            kr[m, i] += rise[i] * back
            y[m, i] = back - gain[m, i] * fed[i]


@jit
def solve_lines(x: Array, axis: int, start: int, stop: int, ratios: Array, gains: LineGains) -> None:
    """Solve the systems of the lines ``start..stop-1`` of `x`, which run along `axis`; see `line_gains`."""
    n, terms = x.shape[axis], ratios.size
    rows, which = gains
    natural = np.arange(n)
    work, state = np.empty((2 * n, LANES), x.dtype), np.empty((2 * (terms + 1), LANES), x.dtype)
    for first in range(start, stop, LINES):
        place = which[first // LINES]
        gather(x, axis, first, natural, work, 0)
        state[...] = 0.0  # q, without q_0
        q, s = load_complex(state, terms)
        for k in range(n - 1, -1, -1):
            gain = rows[place[n - 1 - k]]
            f, g = load_complex(work, k)
            a, b = f + q, g + s
            store_complex(work, k, a, b)
            c, d = load_complex(gain, 1)
            q, s = a - a - c * a, b - b - d * b  # as x_0 goes into every other x_m, q_0 gathers every other q_m
            for m in range(terms):
                f, g = load_complex(state, m)
                q, s = q + f, s + g
                c, d = load_complex(gain, m + 2)
                store_complex(state, m, ratios[m] * f - c * a, ratios[m] * g - d * b)
        state[...] = 0.0  # x, without x_0
        p, o = load_complex(state, terms)
        for k in range(n):
            gain = rows[place[n - 1 - k]]
            a, b = load_complex(work, k)
            c, d = load_complex(gain, 0)
            f, g = load_complex(gain, 1)
            u, v = c * a - f * p, d * b - g * o
            for m in range(terms):
                c, d = load_complex(gain, m + 2)
                f, g = load_complex(state, m)
                u, v = u - c * f, v - d * g
                store_complex(state, m, ratios[m] * f + p, ratios[m] * g + o)
            store_complex(work, k, u, v)
            p, o = u, v
        scatter(work, 0, natural, x, axis, first, False)
