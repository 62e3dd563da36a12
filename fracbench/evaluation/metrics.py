"""Errors of an estimated flow: angular error and end-point error, as the paper defines them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError

CONVENTIONS = (
    "AAE: mean angular error in radians, the angle between (u1, u2, 1) and (gt1, gt2, 1); SDAE: its "
    "population standard deviation (divisor N), in radians; AEPE: mean end-point error in pixels. Means run "
    "over the pixels of the picture or region whose true flow is known, each with the same weight; pixels of "
    "unknown true flow are left out, and no border is cropped. A flow that is not finite at a scored pixel "
    "has no error (NaN)."
)

_UNKNOWN_ABOVE = 1e9

Map = NDArray[np.float64]


@dataclass(frozen=True)
class FlowErrors:
    """Errors over the scored pixels: those inside the mask whose true flow is known; see `CONVENTIONS`.

    Attributes
    ----------
    aae, sdae, aepe : float
        Mean and standard deviation of the angular error, radians, and mean end-point error, pixels.
    n_pixels, n_unknown : int
        Pixels scored, and pixels inside the mask whose true flow is unknown.
    n_nonfinite : int
        Scored pixels whose estimate is not finite. If there is one, the three errors are NaN.
    """

    aae: float
    aepe: float
    sdae: float
    n_pixels: int
    n_unknown: int
    n_nonfinite: int

    @property
    def degrees(self) -> tuple[float, float]:
        """AAE and SDAE in degrees."""
        return math.degrees(self.aae), math.degrees(self.sdae)


def flow_errors(flow: Any, truth: Any, mask: Any = None) -> FlowErrors:
    """Score an estimated flow against the true one.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels; unknown where a component of the true one is NaN or above 1e9.
    mask : array_like of bool, (H, W), optional
        True where pixels are to be scored; everywhere if not given.

    Returns
    -------
    FlowErrors
        The paper's equations (AE) and (EPE), averaged, computed in float64.

    Raises
    ------
    InputError
        If shapes differ, or no pixel can be scored.
    """
    from fracbench.evaluation._sums import error_sums

    flow, truth = _checked(flow, truth)
    wanted = _checked_mask(mask, truth.shape[1:])
    with np.errstate(all="ignore"):  # without compilation NumPy would warn of values that are not finite
        n_pixels, n_unknown, n_nonfinite, *sums = error_sums(flow, truth, wanted, _UNKNOWN_ABOVE)
    if n_pixels == 0:
        raise InputError(
            f"no pixel to score: the mask holds {int(wanted.sum())}, {n_unknown} of unknown true flow"
        )
    if n_nonfinite:
        return FlowErrors(math.nan, math.nan, math.nan, n_pixels, n_unknown, n_nonfinite)
    aae, variance, aepe = (value / n_pixels for value in sums)
    return FlowErrors(aae, aepe, math.sqrt(variance), n_pixels, n_unknown, 0)


def angular_error(flow: Any, truth: Any) -> Map:
    """Map the angular error, the paper's equation (AE), in radians.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels.

    Returns
    -------
    ndarray of float64, (H, W)
        NaN where the true flow is unknown, infinite where the estimate is not finite.
    """
    return _error_map(_angles, flow, truth)


def endpoint_error(flow: Any, truth: Any) -> Map:
    """Map the end-point error, the paper's equation (EPE), in pixels; see `angular_error`."""
    return _error_map(_distances, flow, truth)


def with_unknown_as_zero(truth: Any) -> NDArray[Any]:
    """Return a true flow, (2, H, W), that is 0 where it is unknown: for a scoring that takes all pixels.

    It is the switch ``score=unknown_as_zero`` (docs/switches.md). Unknown is a component that is NaN or above 1e9.
    """
    truth = np.asarray(truth)
    known = (np.abs(truth) <= _UNKNOWN_ABOVE).all(axis=0)
    return np.where(known, truth, truth.dtype.type(0))


def robustness(epe: Any, threshold: float) -> float:
    """Return R: the share of pixels, in per cent, whose end-point error is larger than `threshold` pixels.

    Parameters
    ----------
    epe : array_like
        End-point errors; NaN is left out (unknown true flow), infinity counts (no finite estimate).
    threshold : float
        Pixels, e.g. 1.0 for R1.0.
    """
    if not threshold >= 0:
        raise InputError(f"`threshold` must be at least 0 pixels, got {threshold}")
    return 100.0 * float(np.mean(_known_errors(epe) > threshold))


def outliers(flow: Any, truth: Any) -> float:
    """Return Fl, the share of outliers of the KITTI benchmark, in per cent of the pixels of known true flow.

    An outlier is a pixel whose end-point error is above 3 pixels and above 5 % of the length of the true flow.

    Parameters
    ----------
    flow, truth : array_like, (2, H, W)
        The estimate and the true flow, pixels.
    """
    epe = endpoint_error(flow, truth)
    known = ~np.isnan(epe)
    lengths = np.hypot(*np.asarray(truth, np.float64)[:, known])
    errors = _known_errors(epe)
    return 100.0 * float(np.mean((errors > 3.0) & (errors > 0.05 * lengths)))


def accuracy(epe: Any, percentile: float) -> float:
    """Return A: the smallest error that `percentile` per cent of the pixels do not exceed.

    Parameters
    ----------
    epe : array_like
        End-point errors, none interpolated; NaN is left out (unknown true flow).
    percentile : float
        0..100, e.g. 95 for A95.
    """
    if not 0 <= percentile <= 100:
        raise InputError(f"`percentile` must be within 0..100, got {percentile}")
    return float(np.percentile(_known_errors(epe), percentile, method="inverted_cdf"))


def _checked(flow: Any, truth: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    flow, truth = np.asarray(flow), np.asarray(truth)
    if truth.ndim != 3 or truth.shape[0] != 2:
        raise InputError(f"the true flow must have the shape (2, H, W), not {truth.shape}")
    if flow.shape != truth.shape:
        raise InputError(f"the flow has the shape {flow.shape}, the true flow {truth.shape}")
    dtype = np.float32 if flow.dtype == truth.dtype == np.float32 else np.float64
    return np.ascontiguousarray(flow, dtype), np.ascontiguousarray(truth, dtype)


def _checked_mask(mask: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(shape, dtype=bool)
    wanted: NDArray[Any] = np.asarray(mask)
    if wanted.dtype != np.bool_ or wanted.shape != shape:
        raise InputError(f"`mask` must be bool {shape}, not {wanted.dtype} {wanted.shape}")
    return wanted


def _known_errors(epe: Any) -> Map:
    errors = np.asarray(epe, dtype=np.float64)
    errors = errors[~np.isnan(errors)]
    if errors.size == 0:
        raise InputError("no pixel to score: every error is NaN")
    return errors


def _error_map(measure: Any, flow: Any, truth: Any) -> Map:
    flow, truth = (np.asarray(array, np.float64) for array in _checked(flow, truth))
    known = (np.abs(truth) <= _UNKNOWN_ABOVE).all(axis=0)
    finite = np.isfinite(flow[0]) & np.isfinite(flow[1])
    error = np.full(known.shape, np.nan)
    error[known] = np.inf
    error[known & finite] = measure(flow[:, known & finite], truth[:, known & finite])
    return error


def _angles(u: Map, gt: Map) -> Map:
    """Return the angles between (u1, u2, 1) and (gt1, gt2, 1).

    atan2(|a x b|, a . b) where the paper has arccos of the normalised product: the same angle, but exactly 0
    for equal flows and accurate for small angles. The estimate is scaled, which leaves the angle as it is, so
    that a diverged flow does not overflow.
    """
    scale = np.maximum(1.0, np.abs(u).max(axis=0))
    d1, d2 = (u - gt) / scale
    cross = np.hypot(np.hypot(d1, d2), d1 * gt[1] - d2 * gt[0])
    dot = (u[0] / scale) * gt[0] + (u[1] / scale) * gt[1] + 1.0 / scale
    return np.asarray(np.arctan2(cross, dot))


def _distances(u: Map, gt: Map) -> Map:
    return np.asarray(np.hypot(u[0] - gt[0], u[1] - gt[1]))
