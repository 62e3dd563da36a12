r"""Convolutions with Gruenwald-Letnikov weights as recurrences: the weights as a sum of a few exponentials.

From the third on, Gruenwald-Letnikov weights are moments of a density of one sign on (0, 1),
``w_k = const int_0^1 t^(k - alpha - 1) (1 - t)^alpha dt`` (Euler's integral of the binomial's gamma functions), so
that ten or twelve exponentials, ``w_k = sum_m c_m rho_m^(k - 2)`` with ``rho_m`` in (0, 1), give hundreds of them
to single precision. A left derivative is then a recurrence along a line, with one number an exponential in place
of all previous samples: ``h_m(i) = rho_m h_m(i - 1) + u(i - 2)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.cosine import LINES, gather, scatter
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.simd import LANES, load_complex, store_complex

#: Number of weights kept as they are; the sum of exponentials begins after them.
TAPS = 2
#: Largest sum of the errors of all weights, relative to the largest weight: single precision.
TOLERANCE = 1.2e-7
_MOST_TERMS = 16


class ExponentialSum(NamedTuple):
    """Weights ``taps(0), taps(1)``, and ``sum_m factors(m) ratios(m)^(k - 2)`` from ``k = 2`` on."""

    taps: Array
    ratios: Array
    factors: Array


def exponential_sum(weights: Float64Array, dtype: np.dtype | type) -> ExponentialSum | None:
    """Fit a sum of a few exponentials to at least eight Gruenwald-Letnikov weights.

    In the space of the first singular vectors of the weights' Hankel matrix, the shift by one is a matrix whose
    eigenvalues are the ratios (ESPRIT, Roy and Kailath 1989). Return None if `TOLERANCE` cannot be kept with real
    ratios in (0, 1).
    """
    tail = weights[TAPS:]
    half = len(tail) // 2
    basis, _, _ = scipy.linalg.svd(scipy.linalg.hankel(tail[: half + 1], tail[half:]), full_matrices=False)
    powers = np.arange(len(tail))[:, None]
    for terms in range(1, min(_MOST_TERMS, half) + 1):
        space = basis[:, :terms]
        found = np.linalg.eigvals(np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0])
        if not (np.isreal(found).all() and (found.real > 0.0).all() and (found.real < 1.0).all()):
            continue
        ratios = np.sort(found.real.astype(dtype))  # as they will be used: rounding is part of the error
        exponentials = ratios.astype(float) ** powers
        factors = np.linalg.lstsq(exponentials, tail, rcond=None)[0]
        if np.abs(exponentials @ factors - tail).sum() <= TOLERANCE * np.abs(weights).max():
            return ExponentialSum(weights[:TAPS].astype(dtype), ratios, factors.astype(dtype))
    return None


@jit
def convolve(
    x: Array, axis: int, start: int, stop: int, weights: ExponentialSum, reverse: bool, out: Array
) -> None:
    """Write ``sum_k w_k x(j - k)``, or ``x(j + k)`` in reverse, of the lines ``start..stop-1``, x being 0 outside.

    The lines run along `axis`; `start` is a multiple of `LINES`; `out` may be `x`.
    """
    n, terms = x.shape[axis], weights.ratios.size
    taps, ratios, factors = weights
    natural = np.arange(n)
    work, state = np.empty((2 * n, LANES), x.dtype), np.empty((2 * (terms + 1), LANES), x.dtype)
    for first in range(start, stop, LINES):
        gather(x, axis, first, natural, work, 0)
        state[...] = 0.0
        a1, b1 = load_complex(state, terms)
        a2, b2 = a1, b1
        for k in range(n):
            row = n - 1 - k if reverse else k
            a, b = load_complex(work, row)
            p, q = taps[0] * a + taps[1] * a1, taps[0] * b + taps[1] * b1
            for m in range(terms):
                f, g = load_complex(state, m)
                f, g = ratios[m] * f + a2, ratios[m] * g + b2
                store_complex(state, m, f, g)
                p, q = p + factors[m] * f, q + factors[m] * g
            store_complex(work, row, p, q)
            a1, b1, a2, b2 = a, b, a1, b1
        scatter(work, 0, natural, out, axis, first, False)
