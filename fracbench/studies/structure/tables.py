"""Errors against alpha by structure: of scenes that hold one, and of Middlebury's pixels by class."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.errors import InputError
from fracbench.evaluation.resampling import held_out, mean_interval, minimum_interval
from fracbench.model.structure import CLASSES
from fracbench.studies.base import FLAT

if TYPE_CHECKING:
    import pandas as pd

#: Parts of the experiment: rendered scenes, repeated over seeds; classes of pixels, over sequences.
SCENES, BY_CLASS = "scenes", "classes"
#: The name of all pixels among the classes.
ALL = "all"
X = "alpha"
METRICS = ("aepe", "aae")
_KEYS = ["part", "structure", "noise", "boundary"]
AGREES, NEAR, DIFFERS = "agrees", f"within {FLAT:.0%}", "differs"


def long_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Bring the rows of both parts into one form: ``part, structure, noise, boundary, unit, alpha, aepe, aae``.

    A structure is a scene without its prefix, or a class of pixels; a unit is a seed or a sequence. Errors of
    points that are not done are NaN.
    """
    import pandas as pd

    runs = runs.assign(**{key: runs.get(key, "") for key in ("noise", "seed")})
    scenes = runs[runs["part"] == SCENES]
    names = scenes["sequence"].str.removeprefix("synthetic_")
    parts = [scenes.assign(structure=names, unit=scenes["seed"])]
    whole = runs[runs["part"] == BY_CLASS]
    whole = whole.assign(unit=whole["sequence"])
    parts.append(whole.assign(structure=ALL))
    for name in CLASSES:
        columns = {metric: whole.get(f"{metric}_{name}", np.nan) for metric in METRICS}
        parts.append(whole.assign(structure=name, **columns))
    table = pd.concat(parts)
    table[list(METRICS)] = table[list(METRICS)].astype(np.float64).where(table["status"] == "done")
    return table[[*_KEYS, "unit", X, *METRICS]].reset_index(drop=True)


def curve_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the mean errors of a `long_table`, and those relative to alpha = 1 with their 95 % intervals.

    Columns: ``part, structure, noise, boundary, metric, alpha, n, error, ratio, low, high``. `ratio` is the
    geometric mean over units of error / error at alpha = 1, each of the same unit.
    """
    import pandas as pd

    records = []
    for keys, errors in _matrices(table):
        mean, low, high = (np.exp(values) for values in mean_interval(_relative(errors)))
        columns = {"n": len(errors), "error": errors.mean().to_numpy(), "ratio": mean, "low": low, "high": high}
        records.append(pd.DataFrame({**keys, X: errors.columns, **columns}))
    return pd.concat(records, ignore_index=True)


def best_table(table: pd.DataFrame, paper: Mapping[str, tuple[float, float]]) -> pd.DataFrame:
    """Return the best alphas of a `long_table`, their gains over alpha = 1, and their agreement with the paper.

    `paper` is the paper's range of best alphas by structure. Columns: ``part, structure, noise, boundary, metric,
    n``; the ``best`` alpha with its bootstrap interval ``best_low, best_high``; the mean ``error_at_1``; the
    ``gain`` over alpha = 1 in per cent with its interval, alpha chosen on the other half of the units; the range
    ``paper_low, paper_high``; the extra error in per cent that the best alpha in that range ``costs``; and the
    ``verdict``: ``agrees`` if the intervals meet, else ``within 2 %`` if it costs no more, else ``differs``.
    """
    import pandas as pd

    records = []
    for keys, errors in _matrices(table):
        logs = _relative(errors)
        alphas = errors.columns.to_numpy(np.float64)
        place, low, high = minimum_interval(logs)
        gain = [100.0 * (1.0 - math.exp(value)) for value in mean_interval(held_out(logs))]
        record: dict[str, Any] = {**keys, "n": len(errors), "best": alphas[place]}
        record |= {"best_low": alphas[low], "best_high": alphas[high], "error_at_1": errors[1.0].mean()}
        record |= {"gain": gain[0], "gain_low": gain[2], "gain_high": gain[1]}
        record |= _against_paper(logs.mean(axis=0), alphas, alphas[[low, high]], paper.get(str(keys["structure"])))
        records.append(record)
    return pd.DataFrame(records)


def _against_paper(
    mean: np.ndarray, alphas: np.ndarray, ends: np.ndarray, said: tuple[float, float] | None
) -> dict[str, Any]:
    if said is None:
        return {"paper_low": math.nan, "paper_high": math.nan, "costs": math.nan, "verdict": ""}
    inside = (alphas >= said[0] - 1e-9) & (alphas <= said[1] + 1e-9)
    costs = 100.0 * math.expm1(mean[inside].min() - mean.min()) if inside.any() else math.nan
    meet = ends[0] <= said[1] + 1e-9 and ends[1] >= said[0] - 1e-9
    verdict = AGREES if meet else NEAR if costs <= 100.0 * FLAT else DIFFERS
    return {"paper_low": said[0], "paper_high": said[1], "costs": costs, "verdict": verdict}


def sentences(best: pd.DataFrame) -> list[str]:
    """State for each structure the best alpha by AEPE over all noises and boundaries, and its gain."""
    lines = []
    rows = best[best["metric"] == METRICS[0]]
    for (part, structure), found in rows.groupby(["part", "structure"], sort=False):
        where = "classes of pixels" if part == BY_CLASS else "scenes"
        gains = found["gain"]
        text = (
            f"{structure} ({where}): best alpha {found['best'].min():g} to {found['best'].max():g} over "
            f"{len(found)} settings, gain over alpha 1 {gains.min():.1f} to {gains.max():.1f} %, its interval "
            f"above 0 in {int((found['gain_low'] > 0).sum())}"
        )
        if found["verdict"].iloc[0]:
            low, high = found[["paper_low", "paper_high"]].iloc[0]
            counts = [(verdict, int((found["verdict"] == verdict).sum())) for verdict in (AGREES, NEAR, DIFFERS)]
            said = ", ".join(f"{verdict} in {count}" for verdict, count in counts if count)
            text += f"; the paper's {low:g} to {high:g} {said}"
        lines.append(f"{text}.")
    return lines


def _matrices(table: pd.DataFrame) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Yield for each curve its keys, and the errors with a row a unit and a column an alpha; whole rows only."""
    if not np.isclose(table[X].unique(), 1.0).any():
        raise InputError("errors are shown relative to alpha = 1, which the grid does not have")
    for values, part in table.groupby(_KEYS, sort=False):
        for metric in METRICS:
            errors = part.pivot_table(metric, "unit", X, dropna=False)
            errors = errors[(errors > 0).all(axis=1)]
            if len(errors):
                yield {**dict(zip(_KEYS, values, strict=True)), "metric": metric}, errors


def _relative(errors: pd.DataFrame) -> np.ndarray:
    logs = np.log(errors)
    return np.asarray(logs.sub(logs[1.0], axis=0), dtype=np.float64)
