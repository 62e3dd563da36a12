"""The artefact of the search: its best protocols, and all configurations that were tried."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import atomic_path
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import RUNS, Row
from fracbench.harness.run.tidy import METRICS
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact, file_stem
from fracbench.studies.paper.table2 import printed_table
from fracbench.studies.protocol_search.records import Trial, TrialTable, compressed
from fracbench.studies.protocol_search.space import Settings, settings_of

if TYPE_CHECKING:
    import pandas as pd

#: Configurations of a stage in the table.
_SHOWN = 5


def protocol_search(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Show the best configurations of each stage; see `fracbench.studies.base.Renderer`."""
    settings = settings_of(experiment, plan)
    kept = trial_table(experiment, plan, settings)
    trials = kept.read()
    table = best_table(trials, settings)
    stem = file_stem(experiment.name, plan, results / TABLES)
    lines = sentences(trials, settings)
    text = [f"# {experiment.title}", _LEGEND, tables.to_markdown(table), *lines, *plan.notices]
    files = [tables.write_table(table, stem), tables.write_markdown(stem, *text)]
    with atomic_path(stem.with_name(f"{stem.name}_trials.csv.gz")) as path:
        path.write_bytes(compressed(kept.text(trials)))
    files.append(stem.with_name(f"{stem.name}_trials.csv.gz"))
    return Artefact(files, [(experiment.title, tables.rounded(table))], lines)


_LEGEND = (
    "Distance: RMS of ln(ours / printed) over the numbers of Table 2 that the stage is about. Each row is a "
    "configuration; switches at their value in the grid are left out. The file of trials has all configurations "
    "and ln(ours / printed) of all numbers that they computed."
)


def trial_table(experiment: Experiment, plan: Plan, settings: Settings) -> TrialTable:
    """Return the table to which a search appends its trials."""
    return TrialTable(plan.config.results / RUNS / f"{experiment.name}{plan.mark}_trials.csv", settings)


def printed_numbers(plan: Plan) -> dict[tuple[str, str, str], float]:
    """Return the numbers of Table 2 by method, sequence and metric.

    A scene that the paper does not have takes the numbers of the sequence for which it stands, in the order of the
    paper: so a search can be tried without the data.
    """
    printed = printed_table().set_index(["method", "sequence"])
    names = list(dict.fromkeys(printed.index.get_level_values("sequence")))
    sequences = list(dict.fromkeys(planned.labels["sequence"] for planned in plan.points))
    stand_ins = {name: name if name in names else names[i % len(names)] for i, name in enumerate(sequences)}
    return {
        (planned.point.method, name, metric): float(printed.loc[(planned.point.method, stand_ins[name]), metric])
        for planned in plan.points
        for name in [planned.labels["sequence"]]
        for metric in METRICS
    }


def best_table(trials: Sequence[Trial], settings: Settings) -> pd.DataFrame:
    """Return the best configurations of each stage, with the numbers within 5 and 10 % of the printed ones."""
    import pandas as pd

    records = []
    for stage in dict.fromkeys(trial.stage for trial in trials):
        whole = [trial for trial in trials if trial.stage == stage and not trial.stopped]
        unique = {trial.configuration: trial for trial in sorted(whole, key=_nearest, reverse=True)}
        for trial in sorted(unique.values(), key=_nearest)[:_SHOWN]:
            off = np.abs(list(trial.logs.values()))
            record: dict[str, Any] = {"stage": stage, "distance": trial.distance, "numbers": len(off)}
            record |= {f"within {p} %": int((off <= math.log(1.0 + p / 100.0)).sum()) for p in (5, 10)}
            record["settings"] = ", ".join(f"{name}={_word(value)}" for name, value in _turned(trial, settings))
            records.append(record)
    columns = ["stage", "distance", "numbers", "within 5 %", "within 10 %", "settings"]
    return pd.DataFrame(records, columns=columns)


def _nearest(trial: Trial) -> tuple[float, str, int]:
    return trial.distance, trial.study, trial.number


def _turned(trial: Trial, settings: Settings) -> list[tuple[str, Any]]:
    """Return the switches that a trial has at another value than the grid."""
    return [(name, value) for name, value in trial.values.items() if settings.usual.get(name) != value]


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def sentences(trials: Sequence[Trial], settings: Settings) -> list[str]:
    """Say how many configurations each stage tried, and the least distance."""
    found = []
    for stage in dict.fromkeys(stage.name for stage in settings.stages):
        mine = [trial for trial in trials if trial.stage == stage]
        if not mine:
            continue
        distinct = len({trial.configuration for trial in mine})
        whole = [trial.distance for trial in mine if not trial.stopped]
        least = f"the least distance is {min(whole):.4f}" if whole else "none ran to its end"
        found.append(
            f"{stage}: {len(mine)} configurations, {distinct} distinct, {len(mine) - len(whole)} stopped early; "
            f"{least}."
        )
    return found
