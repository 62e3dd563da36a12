"""The rules by which the paper's sentences are judged: tidy tables in, a verdict and its numbers out.

A rule sees the tables through `Tables`, which raises `UnjudgeableError` where a point is missing or failed:
a claim without points never holds. A sentence about several cases (errors, regions, curves) holds if it does in
each, and in part if it does so, wholly or in part, in at least half of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.config.paths import asset
from fracbench.studies.base import FLAT
from fracbench.studies.paper.alpha_regions import CAPTIONED, captions

if TYPE_CHECKING:
    import pandas as pd

HOLDS, IN_PART, FAILS, UNKNOWN = "holds", "holds in part", "does not hold", "cannot be judged"
VERDICTS = (HOLDS, IN_PART, FAILS, UNKNOWN)
#: The protocols of the paper, with a description in a line.
PROTOCOLS = {
    "reference": "the paper's model, computed correctly and to convergence",
    "published": "a run near the printed Table 2, found by hand: coarse flow halved on upsampling, few iterations",
    "as_printed": "Algorithms 1 and 2 to the letter: the linearisation point u0 is never updated",
}
#: The reference under ``boundary=reflect`` and with pixels around the region: no pull to 0 at its edges.
CONTEXT = "reference, reflect + context"
#: The settings under which claims are judged: the protocols and `CONTEXT`.
SETTINGS = {
    **PROTOCOLS,
    CONTEXT: "the model with reflecting boundary and 48 pixels of image around each region: not the paper's",
}
ERRORS = ("aae", "aepe")
SIGNIFICANT = 0.05  # an error this much smaller counts as significantly smaller
MORE_SWEEPS = 0.25  # this many more inner iterations still count as nearly the fewest
CLOSE = 1.5  # within this factor of 2/theta counts as close to it
NEAR = f"within {100 * FLAT:g} %"

Judgement = tuple[str, str]  # verdict and evidence
Rule = Callable[..., Judgement]  # rule(tables, setting, **args)


@lru_cache(maxsize=1)
def captioned_regions() -> Mapping[str, tuple[str, float]]:
    """Return the figure and the caption's lambda_SB of each region, in the order of the paper."""
    return {
        region: (figure, caption["lambda_sb"])
        for figure in CAPTIONED
        for region, caption in captions(load_experiment(figure)).items()
    }


def published_table2() -> pd.DataFrame:
    """Return Table 2 as it is printed."""
    import pandas as pd

    return pd.read_csv(asset("results/published/table2.csv"))


class UnjudgeableError(Exception):
    """The tables lack points that a rule needs; the message names them."""


class Tables:
    """The tidy tables of the experiments, each loaded once: `load` gives that of a name, or None."""

    def __init__(self, load: Callable[[str], pd.DataFrame | None]) -> None:
        self._load = lru_cache(maxsize=None)(load)

    def points(self, experiment: str, needs: Sequence[str] = ERRORS, **where: Any) -> pd.DataFrame:
        """Return the points of an experiment with these values by column: at least one, and all of them finished.

        The columns `needs` must hold a number in each row.
        """
        table = self._load(experiment)
        if table is None:
            raise UnjudgeableError(f"there are no results of {experiment}")
        chosen = np.ones(len(table), bool)
        for column, value in where.items():
            if column not in table:
                raise UnjudgeableError(f"{experiment} has no column {column}")
            chosen &= (table[column] == value).to_numpy(bool)
        table = table[chosen]
        if table.empty:
            wanted = ", ".join(f"{column} {value}" for column, value in where.items())
            raise UnjudgeableError(f"{experiment} has no points with {wanted}")
        if (table["dataset"] != "middlebury").any():
            raise UnjudgeableError(
                f"{experiment} was computed on other data, the sentence is about Middlebury's sequences"
            )
        finite = np.isfinite(table[list(needs)].to_numpy(np.float64, na_value=np.nan)).all(axis=1)
        bad = int((~(finite & (table["status"] == "done").to_numpy())).sum())
        if bad:
            raise UnjudgeableError(f"{bad} of {len(table)} points of {experiment} are missing or failed")
        return table


@dataclass(frozen=True)
class Registered:
    """A rule, and the settings its sentences are judged under."""

    judge: Rule
    settings: tuple[str, ...]


RULES: dict[str, Registered] = {}


def rule(*settings: str) -> Callable[[Rule], Rule]:
    """Register a function as the rule of its name; `settings` are the protocols and variants it can judge."""

    def register(function: Rule) -> Rule:
        RULES[function.__name__] = Registered(function, settings)
        return function

    return register


def combine(verdicts: Sequence[str]) -> str:
    """Return the verdict on all cases: see the module's first lines."""
    if all(verdict == HOLDS for verdict in verdicts):
        return HOLDS
    return IN_PART if 2 * sum(verdict != FAILS for verdict in verdicts) >= len(verdicts) else FAILS


def grade(whole: bool, part: bool) -> str:
    """Return the verdict on one case."""
    return HOLDS if whole else IN_PART if part else FAILS


def region_curve(tables: Tables, setting: str, region: str) -> pd.DataFrame:
    """Return the errors of a region against alpha at the caption's lambda_SB, sorted by alpha from 0 to 2."""
    figure, lambda_sb = captioned_regions()[region]
    where: dict[str, Any] = {"part": "main", "protocol": setting, "lambda_sb": lambda_sb}
    if setting == CONTEXT:
        where = {"part": "context"}
    elif setting != "reference":
        where = {"part": "protocols", "protocol": setting}
    curve = tables.points(figure, region=region, **where).sort_values("alpha")
    alphas = curve["alpha"].to_numpy()
    if len(alphas) < 2 or alphas[0] > 0.0 or alphas[-1] < 2.0 or np.diff(alphas).max() > 0.25:
        raise UnjudgeableError(f"{figure} has {len(alphas)} values of alpha on {region}: not all of 0 to 2")
    return curve


def near_best(curve: pd.DataFrame, metric: str, x: str) -> np.ndarray[Any, Any]:
    """Return the values of `x` whose error is at most `FLAT` above the smallest."""
    return np.asarray(curve[x][curve[metric] <= (1.0 + FLAT) * curve[metric].min()])


def minimum(curve: pd.DataFrame, metric: str, x: str) -> float:
    """Return where a curve is smallest."""
    return float(curve.loc[curve[metric].idxmin(), x])


def nearest_row(curve: pd.DataFrame, x: str, value: float) -> pd.Series:
    """Return the row whose `x` is nearest to `value` by ratio."""
    return curve.iloc[int(np.abs(np.log(curve[x].to_numpy() / value)).argmin())]


def span(values: Sequence[float] | np.ndarray[Any, Any]) -> str:
    """Return the range of some numbers as text."""
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def percent(ratio: float) -> str:
    """Return a ratio as the change it stands for, e.g. ``+3.1 %``; a large one as such, e.g. ``36.7 times``."""
    return f"{100.0 * (ratio - 1.0):+.1f} %" if ratio < 2.0 else f"{ratio:.3g} times"


def two_over_theta(table: pd.DataFrame) -> float:
    """Return 2/theta for points that share a theta."""
    theta = table["theta"].unique()
    if len(theta) != 1 or not math.isfinite(theta[0]):
        raise UnjudgeableError("the points differ in theta")
    return 2.0 / float(theta[0])
