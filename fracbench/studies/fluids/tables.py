"""Errors of flows of fluids with intervals over seeds: by flow, order, setting of the images, local gradient."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.evaluation.fluid_errors import GRADIENTS
from fracbench.evaluation.resampling import mean_interval
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.methods.registry import get_method

if TYPE_CHECKING:
    import pandas as pd

#: The parts of the experiment: those of single orders, those that compare on all flows, and those of one setting.
ORDERS, FLOWS = "orders", "flows"
SETTINGS = ("density", "noise", "lost", "displacement")
OURS, ALPHA_1, OPENPIV = "protocol fluid", "alpha = 1", "OpenPIV"
#: The row of the mean over the flows of a dataset.
MEAN = "mean"
#: Scores in the order of their columns.
SCORES = (
    "aepe", "aepe_grid", "vorticity", "vorticity_grid", "divergence", "divergence_grid", "own_divergence",
    "own_divergence_grid", "true_vorticity", "true_vorticity_grid", "true_divergence", "true_divergence_grid",
)  # fmt: skip


def with_names(runs: pd.DataFrame) -> pd.DataFrame:
    """Add the columns ``topic``, the part without the method's share, and ``name``, the method as tables name it.

    Scores of points that failed are NaN.
    """
    found = runs.assign(
        topic=[part.split("/")[0].removeprefix("piv ") for part in runs["part"]],
        name=[_name(row) for row in runs.to_dict("records")],
        seed=runs.get("seed", "0"),
    )
    scores = [score for score in SCORES if score in found]
    found[scores] = found[scores].where(found["status"] == "done")
    return found


def _name(row: Mapping[str, Any]) -> str:
    if row["part"].endswith("/ours"):
        return OURS
    if row["part"].endswith(f"/{ALPHA_1.replace('= ', '')}"):
        return ALPHA_1
    if row["method"] == "openpiv":
        shape = "" if row["passes"] == 3 else ", windows to 32 px"
        return f"{OPENPIV}{shape}{', symmetric' if row['deformation'] == 'symmetric' else ''}"
    return get_method(row["method"]).label


def flow_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each dataset, flow and method: mean scores over seeds, and Student's interval of the AEPE.

    Columns: ``dataset, flow, method, n, aepe_low, aepe_high`` and `SCORES`; `n` counts seeds. The rows `MEAN`
    average over the flows of a dataset, seed by seed.
    """
    runs = runs[runs["topic"] == FLOWS]
    return _with_means(runs, ["dataset"], "name").rename(columns={"sequence": "flow", "name": "method"})


def order_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each dataset, flow and single order: its AEPE with the protocol's weight and with the best.

    Columns: ``dataset, flow, alpha, lambda, n, aepe_low, aepe_high`` and `SCORES` with the protocol's weight
    of the data, and ``best_lambda, best_aepe``: the weight of those of the grid with the smallest mean AEPE of
    that order on that flow, which is an oracle's choice.
    """
    runs = runs[runs["topic"] == ORDERS]
    if not len(runs):
        return runs
    runs = runs.assign(alpha=runs["alpha_flat"])
    table = _with_means(runs, ["dataset", "lambda"], "alpha").rename(columns={"sequence": "flow"})
    own = float(runs[~runs["part"].str.endswith("/lambda")]["lambda"].iloc[0])
    keys = ["dataset", "flow", "alpha"]
    best = table.sort_values("aepe").groupby(keys, sort=False).first().reset_index()
    best = best[[*keys, "lambda", "aepe"]].rename(columns={"lambda": "best_lambda", "aepe": "best_aepe"})
    return table[table["lambda"] == own].merge(best, on=keys)


def setting_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each setting, value and method: means over flows, with intervals over seeds.

    Columns: ``setting, value, method, n, aepe_low, aepe_high`` and `SCORES`.
    """
    import pandas as pd

    tables = []
    for setting in SETTINGS:
        part = runs[runs["topic"] == setting]
        if len(part):
            found = _with_means(part.assign(value=part[setting].astype(float)), ["value"], "name")
            found = found[found["sequence"] == MEAN].drop(columns="sequence")
            tables.append(found.assign(setting=setting).rename(columns={"name": "method"}))
    if not tables:
        return pd.DataFrame(columns=["setting", "value", "method", *SCORES])
    table = pd.concat(tables, ignore_index=True)
    return table[["setting", "value", "method", *(c for c in table if c not in ("setting", "value", "method"))]]


def gradient_table(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return a row for each class of the local gradient and method, pooled over flows and displacements.

    Columns: ``gradient``, where the class begins in px / px, ``method, n, n_pixels, aepe, aepe_low, aepe_high``,
    with intervals over seeds. Where a point of a method failed, its errors are NaN.
    """
    import pandas as pd

    sums: dict[tuple[str, float], dict[str, list[float]]] = {}
    for planned in plan.points:
        labels, row = planned.labels, rows.get(planned.point.key)
        if not labels["part"].startswith("displacement/"):
            continue
        name = _name({**labels, **planned.point.canonical, "passes": getattr(planned.point.params, "passes", 3)})
        done = row is not None and row.status == "done"
        classes = (
            row.result["gradients"] if row is not None and done else dict.fromkeys(map("{:g}".format, GRADIENTS))
        )
        for begin, found in classes.items():
            pixels, error = (found["n_pixels"], found["aepe"]) if found else (0, float("nan"))
            held = sums.setdefault((name, float(begin)), {}).setdefault(labels["seed"], [0.0, 0.0])
            held[0] += pixels
            held[1] += error * (pixels or 1)
    records = []
    for (name, begin), seeds in sorted(sums.items(), key=lambda item: item[0][1]):
        counts, totals = np.array(list(seeds.values())).T
        mean, low, high = map(float, mean_interval(totals / np.maximum(counts, 1)))
        record = {"gradient": begin, "method": name, "n": len(seeds), "n_pixels": int(counts.sum())}
        records.append({**record, "aepe": mean, "aepe_low": low, "aepe_high": high})
    return pd.DataFrame(records)


def _with_means(runs: pd.DataFrame, keys: Sequence[str], name: str) -> pd.DataFrame:
    """Return means over seeds for each of `keys`, flow and `name`, and after each group of flows their mean."""
    import pandas as pd

    records = []
    for values, group in runs.groupby(list(keys), sort=False):
        flows = list(dict.fromkeys(group["sequence"]))
        names = list(dict.fromkeys(group[name]))
        for flow in [*flows, MEAN]:
            for each in names:
                part = group[group[name] == each]
                part = part if flow == MEAN else part[part["sequence"] == flow]
                # (seeds, flows): every seed has every flow, or its mean is unknown
                by_seed = part.groupby(["seed", "sequence"], sort=False)[list(SCORES)].mean().unstack("sequence")
                samples = np.stack([by_seed[score].to_numpy(float).mean(axis=1) for score in SCORES], axis=1)
                if not len(samples):
                    continue
                mean, low, high = mean_interval(samples)
                record = {**dict(zip(keys, values, strict=True)), "sequence": flow, name: each, "n": len(samples)}
                record |= {"aepe_low": low[0], "aepe_high": high[0], **dict(zip(SCORES, mean, strict=True))}
                records.append(record)
    return pd.DataFrame(records)
