"""The leave-one-out gain of an alpha for each class of structure over one alpha for all, and its oracle bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.evaluation.resampling import leave_one_out
from fracbench.model.structure import CLASSES
from fracbench.studies.alpha_map.oracle import SCOPES

if TYPE_CHECKING:
    import pandas as pd

#: Parts of the experiment: single orders, orders by class, and the single orders that oracles choose from.
SINGLE, BY_CLASS, ORACLE = "single", "classes", "oracle"
#: The estimates by their short names; `left out`: chosen on the other sequences, `all in`: on all of them.
ESTIMATES: Mapping[str, str] = {
    "one": "alpha = 1",
    "single": "one alpha, left out",
    "adaptive": "alpha by class, left out",
    "single all in": "one alpha, all in",
    "adaptive all in": "alpha by class, all in",
    "single own": "one alpha, by the truth",
    "adaptive own": "alpha by class, by the truth",
    **{f"run {scope}": f"map of orders by {scope}, by the truth" for scope in SCOPES},
    **{f"least {scope}": f"single flows put together by {scope}, by the truth" for scope in SCOPES},
}
MEAN = "mean"
#: The goal against the best single alpha: per cent in the mean, and the part of the sequences.
GOAL, GOAL_SHARE = 3.0, 0.75

Oracles = Mapping[str, Mapping[str, Any] | None]


def adaptive_table(runs: pd.DataFrame, oracles: Oracles) -> pd.DataFrame:
    """Return the errors of all estimates in one table, a row for each sequence and estimate, and their means.

    Columns: ``sequence, estimate, orders, aae, aepe, gain``, the last one how much smaller the AEPE is than that
    of one alpha left out, per cent. NaN where points or bounds are missing.
    """
    import pandas as pd

    sequences = list(dict.fromkeys(runs["sequence"]))
    records = _chosen(_settings(runs, SINGLE), "single", sequences)
    records += _chosen(_settings(runs, BY_CLASS), "adaptive", sequences)
    for sequence in sequences:
        for scope in SCOPES:
            for kind in ("run", "least"):
                errors = (oracles.get(sequence) or {}).get("scopes", {}).get(scope, {}).get(kind, {})
                found = errors.get("aae", math.nan), errors.get("aepe", math.nan)
                records.append((sequence, f"{kind} {scope}", "", *found))
    table = pd.DataFrame.from_records(records, columns=["sequence", "estimate", "orders", "aae", "aepe"])
    table = table.astype({"aae": np.float64, "aepe": np.float64})  # a store has None where a number is not finite
    # A mean over fewer sequences than the others' would not be comparable.
    means = table.groupby("estimate")[["aae", "aepe"]].agg(lambda errors: errors.mean(skipna=False)).reset_index()
    orders = table.groupby("estimate")["orders"].agg(lambda names: names.iloc[0] if names.nunique() == 1 else "")
    means = means.assign(sequence=MEAN, orders=means["estimate"].map(orders))
    table = pd.concat([table, means[table.columns]])
    table["_row"] = table["sequence"].map({name: i for i, name in enumerate([*sequences, MEAN])})
    table["_column"] = table["estimate"].map({name: i for i, name in enumerate(ESTIMATES)})
    table = table.sort_values(["_row", "_column"], ignore_index=True).drop(columns=["_row", "_column"])
    base = table[table["estimate"] == "single"].set_index("sequence")["aepe"]
    table["gain"] = 100.0 * (1.0 - table["aepe"] / table["sequence"].map(base))
    return table


def _settings(runs: pd.DataFrame, part: str) -> pd.DataFrame:
    """Return the errors of each setting, a row a setting in the order of the grid: columns (error, sequence)."""
    chosen = runs[runs["part"] == part]
    orders = ["alpha"] if part == SINGLE else [f"alpha_{name}" for name in CLASSES]
    names = ["/".join(f"{value:g}" for value in row) for row in chosen[orders].to_numpy(np.float64)]
    table = chosen.assign(orders=names).pivot(index="orders", columns="sequence", values=["aae", "aepe"])
    return table.loc[list(dict.fromkeys(names))].astype(np.float64)


def _chosen(errors: pd.DataFrame, kind: str, sequences: list[str]) -> list[tuple[Any, ...]]:
    """Return the choices among settings of one kind: on the other sequences, on all, on the sequence itself."""
    aepe = errors["aepe"][sequences].to_numpy()
    choice = leave_one_out(aepe)
    records: list[tuple[Any, ...]] = []
    for m, sequence in enumerate(sequences):
        own = None if np.isnan(aepe[:, m]).any() else int(aepe[:, m].argmin())
        rows = {
            kind: None if choice is None else choice.left_out[m],
            f"{kind} all in": None if choice is None else choice.all_in,
            f"{kind} own": own,
        }
        if kind == "single":
            rows["one"] = list(errors.index).index("1") if "1" in errors.index else None
        for estimate, row in rows.items():
            if row is None:
                records.append((sequence, estimate, "", math.nan, math.nan))
            else:
                found = (float(errors[metric][sequence].iloc[row]) for metric in ("aae", "aepe"))
                records.append((sequence, estimate, str(errors.index[row]), *found))
    return records


def confusion_table(oracles: Oracles) -> pd.DataFrame:
    """Count which order is best about (``window``) or at (``pixel``) the pixels of each class, over all sequences.

    Columns: ``scope, class, pixels``, then the share of each order, per cent. Empty where there are no bounds.
    """
    import pandas as pd

    known = [found for found in oracles.values() if found is not None]
    records = []
    for scope in ("window", "pixel"):
        for name in CLASSES if known else ():
            counts = np.sum([found["classes"][name][scope] for found in known], axis=0)
            record: dict[str, Any] = {"scope": scope, "class": name, "pixels": int(counts.sum())}
            shares = 100.0 * counts / max(int(counts.sum()), 1)
            records.append(record | dict(zip(map("{:g}".format, known[0]["alphas"]), shares, strict=True)))
    return pd.DataFrame.from_records(records)


def class_orders(oracles: Oracles) -> pd.DataFrame:
    """Return for each sequence and class the single order with the least error over the class's pixels, or NaN."""
    import pandas as pd

    records = []
    for sequence, found in oracles.items():
        if found is not None:
            best = {name: found["alphas"][int(np.argmin(own["sums"]))] if own["pixels"] else math.nan
                    for name, own in found["classes"].items()}  # fmt: skip
            records.append({"sequence": sequence, **best})
    return pd.DataFrame.from_records(records, columns=["sequence", *CLASSES])


def reached(table: pd.DataFrame) -> tuple[float, int, int] | None:
    """Return the mean gain [%] of alpha by class over one alpha, wins, and sequences; None if not known."""
    rows = table[table["estimate"] == "adaptive"].set_index("sequence")["gain"]
    if rows.isna().any():
        return None
    return float(rows[MEAN]), int((rows.drop(MEAN) > 0.0).sum()), len(rows) - 1


def adaptive_sentences(table: pd.DataFrame, oracles: Oracles) -> list[str]:
    """State the gain of alpha by class, its bounds, and the reason of a missed goal; nothing if points failed."""
    found = reached(table)
    if found is None:
        return []
    gain, wins, n = found
    means = table[table["sequence"] == MEAN].set_index("estimate")
    met = gain >= GOAL and wins >= GOAL_SHARE * n
    sentences = [
        "Alpha by class, chosen on the other sequences, has a mean AEPE of "
        f"{means.loc['adaptive', 'aepe']:.4f} px, one alpha chosen in the same way "
        f"{means.loc['single', 'aepe']:.4f} px: {_less(gain)}, and better on {wins} of {n} sequences. The goal of "
        f"{GOAL:g} % and {math.ceil(GOAL_SHARE * n)} sequences is "
        f"{'reached' if met else 'not reached'}.",
        f"Mean AAE: {means.loc['adaptive', 'aae']:.4f} rad against {means.loc['single', 'aae']:.4f} rad.",
    ]
    sentences += _where(table)
    if not math.isnan(one := means.loc["one", "aepe"]):
        parts = [_less(100.0 * (1.0 - means.loc[name, "aepe"] / one)) for name in ("single", "adaptive")]
        sentences.append(f"Against alpha = 1 ({one:.4f} px) one alpha errs {parts[0]}, alpha by class {parts[1]}.")
    sentences.append(
        f"Chosen on all sequences: alpha {means.loc['single all in', 'orders']} "
        f"({means.loc['single all in', 'aepe']:.4f} px), by class ({'/'.join(CLASSES)}) "
        f"{means.loc['adaptive all in', 'orders']} ({means.loc['adaptive all in', 'aepe']:.4f} px)."
    )
    if means.loc[[f"{kind} {scope}" for kind in ("run", "least") for scope in SCOPES], "gain"].isna().any():
        return sentences
    return [*sentences, *_bounds(means), *([] if met else _reasons(means, oracles))]


def _where(table: pd.DataFrame) -> list[str]:
    """Name the sequences on which alpha by class gains and those on which it loses, largest first."""
    gains = table[(table["estimate"] == "adaptive") & (table["sequence"] != MEAN)].set_index("sequence")["gain"]
    gains = gains.sort_values(key=abs, ascending=False, kind="stable")
    parts = {"It gains on": gains[gains > 0.0], "It does not gain on": gains[gains <= 0.0]}
    return [
        f"{words} {', '.join(f'{name} ({_less(gain)})' for name, gain in part.items())}."
        for words, part in parts.items()
        if len(part)
    ]


def _less(gain: float) -> str:
    return f"{abs(gain):.1f} % {'less' if gain >= 0.0 else 'more'}"


def _bounds(means: pd.DataFrame) -> list[str]:
    gains = {name: _less(gain) for name, gain in means["gain"].items()}
    by_scope = [
        "; ".join(f"{gains[f'{kind} {scope}']} by {scope}" for scope in SCOPES) for kind in ("run", "least")
    ]
    return [
        "Oracle bounds, chosen by the true flow, against one alpha left out: one alpha for each sequence "
        f"{gains['single own']}, alpha by class for each sequence {gains['adaptive own']}; runs with a map of "
        f"orders: {by_scope[0]}; the single flows put together: {by_scope[1]}."
    ]


def _reasons(means: pd.DataFrame, oracles: Oracles) -> list[str]:
    """State the reason of a missed goal: no room, classes that do not find it, or that do not generalise."""
    room, by_class = means.loc["least window", "gain"], means.loc["least class", "gain"]
    own = means.loc["single own", "gain"]
    if room < GOAL:
        cause = "there is little to gain by any map of orders over neighbourhoods"
    elif by_class - own < GOAL:
        cause = "the classes do not predict the best order"
    else:
        cause = "the best order of a class differs between sequences"
    sentence = (
        f"The reason: {cause}. With the single flows put together, orders by neighbourhood would give "
        f"{_less(room)}; the best order of each class, known for each sequence, {_less(by_class)}, of which the "
        f"best single alpha of each sequence alone {_less(own)}."
    )
    sentences = [sentence]
    if means.loc["run window", "gain"] < 0.0 < room:
        window, pixel = (_less(means.loc[f"run {scope}", "gain"]) for scope in ("window", "pixel"))
        sentences.append(
            f"Run as maps, the orders by neighbourhood err {window}, those by pixel {pixel}: the order of the "
            "best single flow is not the best one in a map, or the map has not converged within the iterations it "
            "was given."
        )
    told, guessed = predictability(oracles)
    spread = class_orders(oracles)
    ranges = ", ".join(f"{name} {spread[name].min():g} to {spread[name].max():g}" for name in CLASSES)
    return [
        *sentences,
        f"The order that is most often best for a pixel's class is the best one at {told:.0f} % of the pixels; "
        f"the order that is most often best for all pixels, at {guessed:.0f} %. Over the sequences, the order "
        f"with the least error on a class ranges: {ranges}.",
    ]


def predictability(oracles: Oracles) -> tuple[float, float]:
    """Return at how many pixels [%] the order most often best about their class, and about all, is best."""
    counts = np.array(
        [
            np.sum([found["classes"][name]["window"] for found in oracles.values() if found], axis=0)
            for name in CLASSES
        ]
    )
    share: NDArray[np.float64] = 100.0 * counts / counts.sum()
    return float(share.max(axis=1).sum()), float(share.sum(axis=0).max())
