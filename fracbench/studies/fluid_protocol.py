"""The choice of protocol=fluid: leave-one-flow-out over rendered particle images and the public pairs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError
from fracbench.evaluation.resampling import leave_one_out
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact, file_stem
from fracbench.studies.infimal.tables import setting_names

if TYPE_CHECKING:
    import pandas as pd

_LEGEND = (
    "AEPE in pixels. Each flow is scored with the setting that is best on all other flows, where both datasets "
    "weigh alike (leave-one-flow-out); `order 1` has the same lambda. `left out`: the means of each dataset; `all "
    "in`: the setting that is best on all. A setting is written `order, lambda`, one in two parts `(order of p, "
    "order of q) weight of q, lambda`."
)
_SETTINGS_LEGEND = (
    "All settings, best first: the mean AEPE over the flows of each dataset, over both, and over the flows of one "
    "displacement."
)


def fluid_protocol(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the choice of the protocol and the errors of all settings; see `fracbench.studies.base.Renderer`."""
    runs = tidy(plan, rows)
    choice, settings = choice_by_flow(runs), settings_table(runs)
    lines = sentences(choice)
    stem = file_stem(experiment.name, plan, results / TABLES)
    text = [f"# {experiment.title}", _LEGEND, tables.to_markdown(choice)]
    text += ["## Settings", _SETTINGS_LEGEND, tables.to_markdown(settings), *lines, *plan.notices]
    text += tables.footnote(rows, ["fluid"])
    files = [
        tables.write_table(choice, stem),
        tables.write_table(settings, stem.with_name(f"{stem.name}_settings")),
        tables.write_markdown(stem, *text),
    ]
    views = [(experiment.title, tables.rounded(choice)), ("Best settings", tables.rounded(settings.head(10)))]
    return Artefact(files, views, lines)


def flow_errors(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the mean AEPE of each setting (rows) on each flow: columns ``(dataset, flow)``.

    It is NaN where a point has no result.
    """
    named = _with_settings(runs)
    order = list(dict.fromkeys(named["setting"]))
    flows = list(dict.fromkeys(zip(named["dataset"], named["sequence"], strict=True)))
    means = named.groupby(["setting", "dataset", "sequence"])["aepe"].agg(lambda errors: errors.mean(skipna=False))
    return means.unstack(["dataset", "sequence"]).loc[order, flows]


def _with_settings(runs: pd.DataFrame) -> pd.DataFrame:
    names = [f"{name}, {weight:g}" for name, weight in zip(setting_names(runs), runs["lambda"], strict=True)]
    return runs.assign(setting=names)


def choice_by_flow(runs: pd.DataFrame) -> pd.DataFrame:
    """Return ``dataset, flow, setting, AEPE, order 1``: for each flow the setting that is best on the others.

    Each flow counts by one over the number of flows of its dataset. Rows with the means follow: ``left out`` for
    each dataset, and ``all in`` with the setting that is best on all. Errors are NaN where no setting is known on
    all flows.
    """
    import pandas as pd

    errors = flow_errors(runs)
    datasets = errors.columns.get_level_values(0)
    choice = leave_one_out(errors / datasets.map(datasets.value_counts()).to_numpy())
    if choice is None:
        raise InputError("no setting has an error on every flow: points failed or are missing")

    def first_order(setting: str) -> Any:
        same_weight = f"1, {setting.rpartition(', ')[2]}"
        return errors.loc[same_weight] if same_weight in errors.index else errors.iloc[0] * math.nan

    records: list[list[Any]] = []
    for flow, row in zip(errors, choice.left_out, strict=True):
        setting = errors.index[row]
        records.append([*flow, setting, errors[flow].iloc[row], first_order(setting)[flow]])
    scored = pd.DataFrame(records, columns=["dataset", "flow", "setting", "AEPE", "order 1"])
    best = errors.index[choice.all_in]
    means = []
    for name, setting, table in (
        ("left out", "", scored.groupby("dataset", sort=False)[["AEPE", "order 1"]].mean()),
        (
            "all in",
            best,
            pd.DataFrame({"AEPE": errors.loc[best], "order 1": first_order(best)}).groupby(level=0).mean(),
        ),
    ):
        means += [[dataset, name, setting, *table.loc[dataset]] for dataset in dict.fromkeys(datasets)]
    return pd.concat([scored, pd.DataFrame(means, columns=scored.columns)], ignore_index=True)


def settings_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return ``setting``, the mean AEPE of each dataset, their mean and that by displacement, best first."""
    import pandas as pd

    named = _with_settings(runs)
    table = flow_errors(runs).T.groupby(level=0, sort=False).mean().T
    table["both"] = table.mean(axis=1, skipna=False)
    moved = named[named.get("displacement", pd.Series("", named.index)).astype(str) != ""]
    for displacement, group in moved.groupby("displacement", sort=False):
        table[f"{displacement} px"] = group.groupby("setting")["aepe"].agg(
            lambda errors: errors.mean(skipna=False)
        )
    return table.sort_values("both", kind="stable").reset_index(names="setting")


def sentences(choice: pd.DataFrame) -> list[str]:
    """State the means of both ways to choose, and where order 1 is better than the chosen setting."""
    flows = choice[~choice["flow"].isin(["left out", "all in"])]
    told = [
        f"{row['dataset']}: AEPE {row['AEPE']:.4f} px chosen on the other flows"
        if row["flow"] == "left out"
        else f"{row['dataset']}: AEPE {row['AEPE']:.4f} px chosen on all ({row['setting']})"
        for row in choice.to_dict("records")
        if row["flow"] in ("left out", "all in")
    ]
    worse = flows[flows["AEPE"] > flows["order 1"]]["flow"].tolist()
    where = f"larger on {', '.join(worse)}" if worse else "on no flow larger"
    return [f"{line}." for line in told] + [f"The chosen error is {where} than that of order 1."]
