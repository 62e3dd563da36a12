"""The rules of the claims on Figures 6 and 7, the regions; `fracbench.report.claims.judging` defines a rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.report.claims.judging import (
    CLOSE,
    CONTEXT,
    ERRORS,
    FAILS,
    HOLDS,
    IN_PART,
    NEAR,
    PROTOCOLS,
    SIGNIFICANT,
    Judgement,
    Tables,
    UnjudgeableError,
    captioned_regions,
    combine,
    grade,
    minimum,
    near_best,
    nearest_row,
    percent,
    region_curve,
    rule,
    span,
)
from fracbench.studies.base import FLAT

if TYPE_CHECKING:
    import pandas as pd

_UNITS = {"aae": "rad", "aepe": "px"}
_SMALL_GAIN = 0.02  # a gain above this is a gain, if not a significant one


@rule(*PROTOCOLS, CONTEXT)
def best_alpha(
    tables: Tables, setting: str, *, regions: Sequence[str], metrics: Sequence[str], low: float, high: float
) -> Judgement:
    """Judge whether the errors on some regions are smallest at an alpha from `low` to `high`."""
    verdicts, sentences = [], []
    for region in regions:
        curve = region_curve(tables, setting, region)
        for metric in metrics:
            verdicts.append(_alpha_verdict(curve, metric, low, high))
            best = curve.loc[curve[metric].idxmin()]
            inside = curve[_inside(curve, low, high)][metric].min()
            where = f"at {low:g}" if low == high else f"from {low:g} to {high:g}"
            at_best = f"{best[metric]:.4f} {_UNITS[metric]}"
            near = span(near_best(curve, metric, "alpha"))
            there = "" if inside == best[metric] else f", {percent(inside / best[metric])} {where}"
            at = f"alpha {best['alpha']:g} ({at_best})"
            sentences.append(f"{region} {metric.upper()} is smallest at {at}, {NEAR} at {near}{there}")
    if setting == "reference":
        sentences.append(_over_boxes(tables, regions, metrics, low, high))
    return combine(verdicts), "; ".join(sentences) + "."


def _inside(curve: pd.DataFrame, low: float, high: float) -> np.ndarray[Any, Any]:
    """Return the alphas of the grid from `low` to `high`; for a single value, those nearest to it."""
    alphas = curve["alpha"].to_numpy()
    slack = np.diff(alphas).min() / 2.0 if low == high else 0.0
    inside: np.ndarray[Any, Any] = (alphas >= low - slack - 1e-9) & (alphas <= high + slack + 1e-9)
    return inside


def _alpha_verdict(curve: pd.DataFrame, metric: str, low: float, high: float) -> str:
    errors, inside = curve[metric].to_numpy(), _inside(curve, low, high)
    return grade(bool(inside[errors.argmin()]), bool(errors[inside].min() <= (1.0 + FLAT) * errors.min()))


def _over_boxes(tables: Tables, regions: Sequence[str], metrics: Sequence[str], low: float, high: float) -> str:
    """State on how many of the shifted boxes a claim on the best alpha holds."""
    verdicts: dict[str, list[str]] = {}
    try:
        for region in regions:
            band = tables.points(captioned_regions()[region][0], region=region, part="band")
            for shift, box in band.groupby("shift"):
                curve = box.sort_values("alpha")
                cases = [_alpha_verdict(curve, metric, low, high) for metric in metrics]
                verdicts.setdefault(str(shift), []).extend(cases)
    except UnjudgeableError as exc:
        return f"shifted boxes: {exc}"
    whole = [combine(cases) for cases in verdicts.values()]
    step = np.diff(np.unique(band["alpha"])).min()
    return (
        f"of {len(whole)} shifted boxes (steps of {step:.1g}) it holds in {whole.count(HOLDS)}, in part in "
        f"{whole.count(IN_PART)}, not in {whole.count(FAILS)}"
    )


@rule(*PROTOCOLS)
def best_lambda_sb(tables: Tables, setting: str, *, region: str) -> Judgement:
    """Judge whether the caption's lambda_SB gives a region's smallest errors, each value at its best alpha."""
    value = captioned_regions()[region][1]
    curve = _lambda_sb_curve(tables, setting, region)
    if value not in curve["lambda_sb"].to_numpy():
        raise UnjudgeableError(f"lambda_SB {value:g} was not among the values tried on {region}")
    verdicts, sentences = [], []
    for metric in ERRORS:
        best, near = minimum(curve, metric, "lambda_sb"), near_best(curve, metric, "lambda_sb")
        verdicts.append(grade(best == value, bool((near == value).any())))
        at = nearest_row(curve, "lambda_sb", value)[metric] / curve[metric].min()
        sentences.append(
            f"{metric.upper()} is smallest at lambda_SB {best:g}, {NEAR} at {span(near)}, and "
            f"{percent(at)} at {value:g}"
        )
    return combine(verdicts), "; ".join(sentences) + "."


@rule(*PROTOCOLS)
def near_two_over_theta(tables: Tables, setting: str) -> Judgement:
    """Judge whether the best lambda_SB of each region is close to 2/theta."""
    verdicts, sentences, printed = [], [], 0
    for region, (_, caption) in captioned_regions().items():
        curve = _lambda_sb_curve(tables, setting, region)
        target = 2.0 / float(curve["theta"].iloc[0])
        places = []
        for metric in ERRORS:
            places.append(minimum(curve, metric, "lambda_sb"))
            at = nearest_row(curve, "lambda_sb", target)[metric]
            verdicts.append(grade(_close(places[-1], target), at <= (1.0 + FLAT) * curve[metric].min()))
        printed += _close(caption, target)
        sentences.append(f"{region} {places[0]:g} by AAE and {places[1]:g} by AEPE (2/theta {target:.2g})")
    evidence = f"Best lambda_SB: {', '.join(sentences)}; of the six printed values {printed} are close."
    return combine(verdicts), evidence


def _lambda_sb_curve(tables: Tables, setting: str, region: str) -> pd.DataFrame:
    """Return for each lambda_SB the smallest errors over alpha; all must have been tried at the same alphas."""
    figure = captioned_regions()[region][0] if setting == "reference" else "regions_lambda_sb"
    table = tables.points(figure, region=region, part="main", protocol=setting)
    counts = table.pivot_table("aae", "lambda_sb", "alpha", aggfunc="size")
    whole = len(counts) >= 3 and counts.columns.min() <= 0.0 and counts.columns.max() >= 2.0
    if not whole or counts.isna().any(axis=None):
        raise UnjudgeableError(f"{figure} lacks values of alpha or lambda_SB on {region}")
    return table.groupby("lambda_sb", as_index=False)[[*ERRORS, "theta"]].min()


def _close(value: float, target: float) -> bool:
    return 1.0 / CLOSE <= value / target <= CLOSE


@rule(*PROTOCOLS, CONTEXT)
def better_than_one(tables: Tables, setting: str, *, regions: Sequence[str]) -> Judgement:
    """Judge whether some alpha other than 1 makes the errors significantly smaller than alpha 1 does."""
    verdicts, sentences = [], []
    for region in regions:
        curve = region_curve(tables, setting, region)
        for metric in ERRORS:
            gain = _gain(curve, metric)
            verdicts.append(grade(gain >= SIGNIFICANT, gain >= _SMALL_GAIN))
            best = minimum(curve, metric, "alpha")
            sentences.append(f"{region} {metric.upper()} {percent(1.0 - gain)} at alpha {best:g}")
    return combine(verdicts), f"Against alpha 1: {', '.join(sentences)}."


@rule(*PROTOCOLS, CONTEXT)
def gains_less(tables: Tables, setting: str, *, region: str, than: Sequence[str]) -> Judgement:
    """Judge whether the gain over alpha 1 is smaller on one region than on each of the others."""
    verdicts, sentences = [], []
    for metric in ERRORS:
        gain = _gain(region_curve(tables, setting, region), metric)
        others = {other: _gain(region_curve(tables, setting, other), metric) for other in than}
        verdicts += [grade(gain < value, False) for value in others.values()]
        shown = ", ".join(f"{other} {100 * value:.1f} %" for other, value in others.items())
        sentences.append(f"{metric.upper()}: {region} {100 * gain:.1f} %, {shown}")
    return combine(verdicts), f"The best alpha gains over alpha 1 by {'; by '.join(sentences)}."


def _gain(curve: pd.DataFrame, metric: str) -> float:
    """Return by which share the smallest error is below that at alpha 1; 0 if alpha 1 is best."""
    at_one = curve[np.isclose(curve["alpha"], 1.0)][metric]
    if at_one.empty:
        raise UnjudgeableError("alpha 1 is not among the values tried")
    return 1.0 - float(curve[metric].min() / at_one.iloc[0])


@rule(*PROTOCOLS, CONTEXT)
def rougher(tables: Tables, setting: str, *, region: str, than: str) -> Judgement:
    """Judge whether the errors of one region go up and down more along alpha than those of another."""
    verdicts, sentences = [], []
    for metric in ERRORS:
        extra = {
            name: _extra_way(region_curve(tables, setting, name)[metric].to_numpy()) for name in (region, than)
        }
        verdicts.append(grade(extra[region] >= extra[than] + SIGNIFICANT, False))
        shown = " and ".join(f"{100 * value:.0f} % on {name}" for name, value in extra.items())
        sentences.append(f"{metric.upper()} {shown}")
    return combine(verdicts), f"Ups and downs beyond those of a single valley: {'; '.join(sentences)}."


def _extra_way(errors: np.ndarray[Any, Any]) -> float:
    """Return the sum of the relative ups and downs of a curve beyond those of a curve with one valley."""
    logs = np.log(errors)
    return max(float(np.abs(np.diff(logs)).sum() - (logs[0] + logs[-1] - 2.0 * logs.min())), 0.0)


@rule(*PROTOCOLS, CONTEXT)
def no_common_alpha(tables: Tables, setting: str) -> Judgement:
    """Judge whether no single alpha is good enough for all six regions."""
    import pandas as pd

    verdicts, sentences = [], []
    for metric in ERRORS:
        excess, best = {}, {}
        for region in captioned_regions():
            errors = region_curve(tables, setting, region).set_index("alpha")[metric]
            excess[region], best[region] = errors / errors.min(), float(errors.idxmin())
        table = pd.DataFrame(excess)
        if table.isna().any(axis=None):
            raise UnjudgeableError("the regions were not computed at the same values of alpha")
        worst = table.max(axis=1)
        common, cost = float(worst.idxmin()), float(worst.min())
        verdicts.append(grade(cost >= 1.0 + SIGNIFICANT, cost > 1.0 + FLAT))
        places = ", ".join(f"{region} {alpha:g}" for region, alpha in best.items())
        sentences.append(
            f"by {metric.upper()}, alpha {common:g} serves all six with at most {percent(cost)} "
            f"({table.loc[common].idxmax()}); the best are {places}"
        )
    text = "; ".join(sentences)
    return combine(verdicts), f"{text[0].upper()}{text[1:]}."
