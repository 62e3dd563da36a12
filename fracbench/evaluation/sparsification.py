"""Sparsification: the error that is left as the least certain pixels of a flow are dropped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.integrate
from numpy.typing import NDArray

from fracbench.errors import InputError

#: Shares of dropped pixels at which the curves are compared for `ause`.
SHARES = np.arange(100) / 100.0


def remaining_error(errors: Any, uncertainty: Any, dropped: Sequence[float] = (0.1, 0.2, 0.5)) -> NDArray[Any]:
    """Return the mean error of the pixels left after dropping shares of the least certain, over that of all.

    Parameters
    ----------
    errors : array_like
        Error of each pixel, NaN where the true flow is unknown; these pixels are left out.
    uncertainty : array_like of the same shape
        The larger, the earlier a pixel is dropped; infinite values come first, and ties are dropped in the order
        of the array. The errors themselves give the best curve that there is.
    dropped : sequence of float
        Shares, in [0, 1).

    Raises
    ------
    InputError
        Shapes that differ, an uncertainty that is NaN, shares out of range, or no pixel with a known error.
    """
    errors, uncertainty = np.asarray(errors, np.float64), np.asarray(uncertainty, np.float64)
    if errors.shape != uncertainty.shape:
        raise InputError(f"the errors have the shape {errors.shape}, the uncertainty {uncertainty.shape}")
    shares = np.asarray(dropped, np.float64)
    if not ((shares >= 0) & (shares < 1)).all():
        raise InputError(f"shares of dropped pixels must be in [0, 1), got {list(dropped)}")
    known = ~np.isnan(errors)
    errors, uncertainty = errors[known], uncertainty[known]
    if errors.size == 0:
        raise InputError("no pixel to score: every error is NaN")
    if np.isnan(uncertainty).any():
        raise InputError("the uncertainty is NaN at a pixel of known error")
    sums = np.cumsum(errors[np.argsort(uncertainty, kind="stable")])
    left = np.maximum(1, np.rint((1.0 - shares) * errors.size).astype(int))
    means = sums[left - 1] / left
    total = sums[-1] / errors.size
    return np.asarray(means / total if total else np.ones_like(means))


def ause(errors: Any, uncertainty: Any) -> float:
    """Return the area between the curve of an uncertainty and the best curve, AUSE (Ilg et al. 2018); 0 is best.

    Both curves are relative to the mean error of all pixels. The arguments are those of `remaining_error`.
    """
    own, best = (remaining_error(errors, order, tuple(SHARES)) for order in (uncertainty, errors))
    return float(scipy.integrate.trapezoid(own - best, SHARES))
