"""The rules of the claims on Table 2 and Figures 2 to 4; `fracbench.report.claims.judging` defines a rule."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from fracbench.harness.run.tidy import METRICS
from fracbench.report.claims.judging import (
    CLOSE,
    ERRORS,
    HOLDS,
    IN_PART,
    MORE_SWEEPS,
    PROTOCOLS,
    VERDICTS,
    Judgement,
    Tables,
    UnjudgeableError,
    combine,
    grade,
    minimum,
    near_best,
    nearest_row,
    percent,
    published_table2,
    rule,
    span,
    two_over_theta,
)
from fracbench.studies.base import FLAT
from fracbench.studies.paper.table2 import distance, versus_published

if TYPE_CHECKING:
    import pandas as pd

_SEQUENCES = 8
_NAMES = {"lambda_sb": "lambda_SB"}


@rule(*PROTOCOLS)
def method_better(tables: Tables, setting: str, *, metric: str) -> Judgement:
    """Judge whether TV-L1-SB has the smaller error on each sequence of Table 2."""
    table = tables.points("table2", [metric], protocol=setting)
    errors = table.pivot_table(metric, "sequence", "method", sort=False)
    if len(errors) < _SEQUENCES or not {"tvl1", "tvl1_sb"} <= set(errors) or errors.isna().any(axis=None):
        raise UnjudgeableError(f"table2 does not have both methods on {_SEQUENCES} sequences")
    ratio = errors["tvl1_sb"] / errors["tvl1"]
    better = int((ratio < 1.0).sum())
    worse = ", ".join(f"{name} {percent(value)}" for name, value in ratio.items() if value >= 1.0)
    mean = float(np.exp(np.log(ratio).mean()))
    evidence = (
        f"TV-L1-SB has the smaller {metric.upper()} on {better} of {len(ratio)} sequences"
        f"{f' (not on {worse})' if worse else ''}; {percent(mean)} in the geometric mean."
    )
    return grade(better == len(ratio), 2 * better > len(ratio) and mean < 1.0), evidence


@rule(*PROTOCOLS)
def numbers_met(tables: Tables, setting: str) -> Judgement:
    """Judge how many of Table 2's numbers are met."""
    table, published = tables.points("table2", METRICS, protocol=setting), published_table2()
    ratio = versus_published(table, published)["ratio"]
    if len(ratio) < published.size - 2 * len(published) or ratio.isna().any():
        raise UnjudgeableError("table2 does not have all the numbers that are printed")
    within = {p: int((np.abs(np.log(ratio)) <= np.log(1.0 + p / 100.0)).sum()) for p in (5, 10)}
    evidence = (
        f"{within[5]} of {len(ratio)} numbers are met within 5 %, {within[10]} within 10 %; RMS of "
        f"ln(ours / printed) {distance(ratio):.3f}, ours / printed {span(ratio.to_numpy())}."
    )
    return grade(within[5] == len(ratio), 2 * within[10] >= len(ratio)), evidence


@rule(*PROTOCOLS)
def best_inside(tables: Tables, setting: str, *, experiment: str, x: str, low: float, high: float) -> Judgement:
    """Judge whether each curve of a figure is smallest at an `x` from `low` to `high`."""
    table = tables.points(experiment, protocol=setting)
    verdicts, places = [], []
    for curve in _curves(table, x, (low, high)):
        for metric in ERRORS:
            places.append(minimum(curve, metric, x))
            near = near_best(curve, metric, x)
            verdicts.append(grade(low <= places[-1] <= high, bool(((near >= low) & (near <= high)).any())))
    evidence = (
        f"{verdicts.count(HOLDS)} of {len(verdicts)} curves have their minimum from {low:g} to {high:g}, "
        f"further curves within 2 % there: {verdicts.count(IN_PART)}; the minima lie at {_NAMES.get(x, x)} "
        f"{span(places)}."
    )
    return combine(verdicts), evidence


@rule(*PROTOCOLS)
def better_inside(tables: Tables, setting: str, *, experiment: str, x: str, low: float, high: float) -> Judgement:
    """Judge whether the errors of each curve are larger below `low` and above `high` than between."""
    table = tables.points(experiment, protocol=setting)
    ratios: dict[str, list[float]] = {"below": [], "above": []}
    for curve in _curves(table, x, (low, high)):
        outside = {"below": curve[curve[x] < low], "above": curve[curve[x] > high]}
        inside = curve[(curve[x] >= low) & (curve[x] <= high)]
        for metric in ERRORS:
            for side, part in outside.items():
                ratios[side].append(float(part[metric].mean() / inside[metric].mean()))
    sides = {side: [grade(r > 1.0 + FLAT, r > 1.0) for r in values] for side, values in ratios.items()}
    verdicts = [max(both, key=VERDICTS.index) for both in zip(*sides.values(), strict=True)]
    parts = [
        f"{sides[side].count(HOLDS)} of {len(verdicts)} curves are higher {side} ({percent(min(values))} to "
        f"{percent(max(values))})"
        for side, values in ratios.items()
    ]
    evidence = (
        f"Against their mean from {low:g} to {high:g}, and by more than 2 %, {' and '.join(parts)}; on both "
        f"sides {verdicts.count(HOLDS)}. Curves are those of each lambda and error."
    )
    return combine(verdicts), evidence


@rule(*PROTOCOLS)
def smaller_in_general(tables: Tables, setting: str, *, experiment: str) -> Judgement:
    """Judge at how many of a figure's grid points TV-L1-SB has the smaller error."""
    table = tables.points(experiment, protocol=setting)
    shares, medians, counts = {}, {}, 0
    for metric in ERRORS:
        errors = table.pivot_table(metric, ["lambda", "theta"], "method", dropna=False)
        if not {"tvl1", "tvl1_sb"} <= set(errors) or errors.isna().any(axis=None):
            raise UnjudgeableError(f"{experiment} does not have both methods at every grid point")
        ratio = errors["tvl1_sb"] / errors["tvl1"]
        shares[metric], medians[metric] = float((ratio < 1.0).mean()), float(ratio.median())
        counts = len(errors)
    verdicts = [grade(share >= 0.75, share >= 0.5) for share in shares.values()]
    parts = " and ".join(
        f"{100 * share:.0f} % of them by {metric.upper()} (median of all {percent(medians[metric])})"
        for metric, share in shares.items()
    )
    return combine(verdicts), f"Of {counts} pairs of lambda and theta, TV-L1-SB has the smaller error at {parts}."


@rule(*PROTOCOLS)
def slower_far_away(tables: Tables, setting: str, *, experiment: str) -> Judgement:
    """Judge whether both ends of the axis of lambda_SB take more inner iterations than 2/theta."""
    table = tables.points(experiment, ("inner_iterations",), protocol=setting)
    target = two_over_theta(table)
    counts = []
    for curve in _curves(table, "lambda_sb", (target / CLOSE, target * CLOSE)):
        rows = [curve.iloc[0], nearest_row(curve, "lambda_sb", target), curve.iloc[-1]]
        counts.append([float(row["inner_iterations"]) for row in rows])
        places = [float(row["lambda_sb"]) for row in rows]
    totals, slower = np.sum(counts, axis=0), np.array(counts)[:, [0, 2]] > np.array(counts)[:, [1]]
    evidence = (
        f"Summed over lambda, {totals[0]:.0f} inner iterations at lambda_SB {places[0]:.3g}, {totals[1]:.0f} at "
        f"{places[1]:.3g}, {totals[2]:.0f} at {places[2]:.3g} (2/theta is {target:.3g}); of {len(counts)} curves "
        f"{slower[:, 0].sum()} are slower at the low end, {slower[:, 1].sum()} at the high end."
    )
    return combine([grade(bool(end), False) for end in slower.flat]), evidence


@rule(*PROTOCOLS)
def slower_with_theta(tables: Tables, setting: str, *, experiment: str) -> Judgement:
    """Judge whether inner iterations grow from the theta nearest to 2/lambda_SB to the largest."""
    table = tables.points(experiment, ("inner_iterations",), protocol=setting, method="tvl1_sb")
    verdicts, counts = [], []
    for curve in _curves(table, "theta"):
        rows = [nearest_row(curve, "theta", 2.0 / float(curve["lambda_sb"].iloc[0])), curve.iloc[-1]]
        start, end = (float(row["inner_iterations"]) for row in rows)
        verdicts.append(grade(end > start, False))
        counts.append((start, end))
        places = [float(row["theta"]) for row in rows]
    totals = np.sum(counts, axis=0)
    evidence = (
        f"Summed over lambda, {totals[0]:.0f} inner iterations at theta {places[0]:.3g} and {totals[1]:.0f} at "
        f"{places[1]:.3g}; {verdicts.count(HOLDS)} of {len(verdicts)} curves become slower."
    )
    return combine(verdicts), evidence


@rule(*PROTOCOLS)
def suitable_choice(tables: Tables, setting: str, *, experiment: str) -> Judgement:
    """Judge whether lambda_SB = 2/theta costs little in errors and in inner iterations."""
    table = tables.points(experiment, (*ERRORS, "inner_iterations"), protocol=setting)
    target = two_over_theta(table)
    excess: dict[str, list[float]] = {name: [] for name in (*ERRORS, "inner_iterations")}
    for curve in _curves(table, "lambda_sb", (target / CLOSE, target * CLOSE)):
        chosen = nearest_row(curve, "lambda_sb", target)
        for name, values in excess.items():
            values.append(float(chosen[name] / curve[name].min()))
    allowed = {name: FLAT if name in ERRORS else MORE_SWEEPS for name in excess}
    verdicts = [grade(v <= 1.0 + allowed[name], False) for name, values in excess.items() for v in values]
    evidence = (
        f"At the lambda_SB nearest to 2/theta = {target:.3g}, over lambda, AAE is at most "
        f"{percent(max(excess['aae']))}, AEPE {percent(max(excess['aepe']))} and the number of inner iterations "
        f"{percent(max(excess['inner_iterations']))} off the least."
    )
    return combine(verdicts), evidence


def _curves(table: pd.DataFrame, x: str, within: tuple[float, float] | None = None) -> Iterator[pd.DataFrame]:
    """Yield a figure's curves, one a lambda, sorted along `x`; refuse one that does not span more than a range."""
    for value, part in table.groupby("lambda"):
        curve = part.drop_duplicates([x]).sort_values(x)
        if len(curve) < 3:
            raise UnjudgeableError(f"the curve of lambda {value:g} has {len(curve)} points")
        if within is not None:
            (low, high), values = within, curve[x]
            if not (values.min() < low and values.max() > high and values.between(low, high).any()):
                raise UnjudgeableError(
                    f"the values of {x}, {span(values.to_numpy())}, do not reach beyond {low:g} to {high:g}"
                )
        yield curve
