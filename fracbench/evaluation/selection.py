"""Which setting to take: for each sequence by the others, whose true flows alone have a part in the choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError


@dataclass(frozen=True)
class Choice:
    """What `leave_one_out` chose.

    Attributes
    ----------
    left_out : tuple of int
        For each sequence the setting that has the least mean error on all the others.
    all_in : int
        The setting with the least mean error on all sequences.
    """

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
        Row numbers; of equally good settings the first. A single sequence leaves no other to choose by: the
        first setting that is known is taken. None if no setting is known on all sequences.

    Raises
    ------
    InputError
        `errors` is not a table, or an empty one.
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
