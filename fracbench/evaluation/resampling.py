"""Statistics over repetitions: confidence intervals of means and minima, and leave-one-out choice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError

LEVEL = 0.95
N_RESAMPLES = 2000

Table = NDArray[np.float64]


def mean_interval(samples: Any, level: float = LEVEL) -> tuple[Table, Table, Table]:
    """Return means over repetitions with Student's interval.

    Parameters
    ----------
    samples : array_like, (n, ...)
        Repetitions along the first axis.
    level : float, optional
        Of confidence, between 0 and 1.

    Returns
    -------
    mean, low, high : ndarray, (...)
        ``mean -+ t s / sqrt(n)`` with the quantile t of n - 1 degrees of freedom; the ends are NaN for n = 1.
    """
    from scipy.special import stdtrit

    values = _checked(samples)
    n = len(values)
    mean = values.mean(axis=0)
    if n == 1:
        return mean, np.full_like(mean, math.nan), np.full_like(mean, math.nan)
    half = float(stdtrit(n - 1, 0.5 * (1.0 + level))) * values.std(axis=0, ddof=1) / math.sqrt(n)
    return mean, mean - half, mean + half


def minimum_interval(samples: Any) -> tuple[int, int, int]:
    """Return the index of the smallest mean of curves (n, m), and the bootstrap interval of that index.

    The ends are quantiles of the index over `N_RESAMPLES` resamples of the n repetitions.
    """
    values = _checked(samples)
    n = len(values)
    counts = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), size=N_RESAMPLES)
    places = (counts @ values).argmin(axis=1)
    low, high = np.quantile(places, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)], method="inverted_cdf")
    return int(values.mean(axis=0).argmin()), int(low), int(high)


def held_out(samples: Any) -> Table:
    """Return each repetition's value (of curves (n, m)) where the mean of the other half of them is smallest.

    The smallest of many means is biased downwards by its selection; these values are not. The halves are every
    other repetition. Leave-one-out would keep a bias, because each repetition takes part in the choices for the
    others. Student's interval of these values still excludes 0 too often on its better side, in 6 of 100 cases
    instead of 2.5. A single repetition has no other half: NaN.
    """
    values = _checked(samples)
    if len(values) == 1:
        return np.full(1, math.nan)
    places = [values[1::2].mean(axis=0).argmin(), values[::2].mean(axis=0).argmin()]
    return np.asarray([row[places[i % 2]] for i, row in enumerate(values)])


def _checked(samples: Any) -> Table:
    values = np.asarray(samples, np.float64)
    if values.ndim == 0 or len(values) == 0:
        raise InputError("an interval needs repetitions, got none")
    return values


@dataclass(frozen=True)
class Choice:
    """The setting with the least mean error on all other sequences, for each sequence; and that on all."""

    left_out: tuple[int, ...]
    all_in: int


def leave_one_out(errors: Any) -> Choice | None:
    """Choose a setting for each sequence by the other sequences, and one by all.

    Parameters
    ----------
    errors : array_like, (N, M)
        The error of each of N settings on each of M sequences; logarithms of errors to weigh sequences alike. A
        setting with an error that is not known (NaN) is never chosen.

    Returns
    -------
    Choice or None
        Row numbers; of equally good settings the first, as for a single sequence. None if no setting is known on
        all sequences.
    """
    table = np.asarray(errors, np.float64)
    if table.ndim != 2 or table.size == 0:
        raise InputError(f"errors to choose by must have the shape (settings, sequences), not {table.shape}")
    known = np.flatnonzero(~np.isnan(table).any(axis=1))
    if not known.size:
        return None
    whole = table[known]
    others = [np.delete(whole, m, axis=1) for m in range(table.shape[1])]
    return Choice(tuple(_least(part, known) for part in others), _least(whole, known))


def _least(errors: NDArray[np.float64], names: Sequence[int] | NDArray[np.intp]) -> int:
    """Return the name of the row with the least mean."""
    return int(names[int(errors.mean(axis=1).argmin()) if errors.shape[1] else 0])
