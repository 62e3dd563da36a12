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
from fracbench.studies.base import FIGURES, TABLES, Artefact, file_stem
from fracbench.studies.paper.table2 import printed_table
from fracbench.studies.protocol_search import analysis
from fracbench.studies.protocol_search.analysis import Question, word
from fracbench.studies.protocol_search.picture import value_grid
from fracbench.studies.protocol_search.records import Trial, TrialTable, compressed
from fracbench.studies.protocol_search.space import Settings, settings_of

if TYPE_CHECKING:
    import pandas as pd

#: Configurations of a stage in the table.
_SHOWN = 5


def protocol_search(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Show the best configurations, and what they tell of each switch; see `fracbench.studies.base.Renderer`.

    The tables of switches, values and pairs have a part for each set of methods that a stage searches; the figure,
    the halves and the numbers are about the stage with the most methods.
    """
    from fracbench.figures.cache import draw

    settings = settings_of(experiment, plan)
    kept = trial_table(experiment, plan, settings)
    trials = kept.read()
    printed = printed_numbers(plan)
    asked = questions(trials, settings)
    by_methods: dict[str, dict[str, pd.DataFrame]] = {"switches": {}, "values": {}, "pairs": {}}
    for name, each in asked.items():
        by_methods["switches"][name] = analysis.switch_table(each)
        by_methods["values"][name] = analysis.value_table(each)
        by_methods["pairs"][name] = analysis.pair_table(each)
    found = {part: _joined(each) for part, each in by_methods.items()}
    lines = sentences(trials, settings)
    most = max(settings.stages, key=lambda stage: len(stage.methods)).name
    last = asked.get(most)
    if last is not None:
        sequences = list(dict.fromkeys(planned.labels["sequence"] for planned in plan.points))
        found["halves"] = analysis.half_table(last, sequences, settings.usual)
        found["numbers"] = analysis.number_table(last, printed)
        lines += tellings(last, by_methods["switches"][most], found["halves"], found["numbers"])
    table = best_table(trials, settings)
    stem = file_stem(experiment.name, plan, results / TABLES)
    text = [f"# {experiment.title}", _LEGEND, tables.to_markdown(table), *lines]
    for part, legend in _LEGENDS.items():
        if part in found and len(found[part]):
            text += [legend, tables.to_markdown(found[part])]
    notes = [*plan.notices, *tables.footnote(rows, ["published"])] if rows else plan.notices
    files = [tables.write_table(table, stem), tables.write_markdown(stem, *text, *notes)]
    beside = {part: file_stem(f"{experiment.name}_{part}", plan, stem.parent) for part in (*found, "trials")}
    files += [tables.write_table(each, beside[part]) for part, each in found.items()]
    files.append(beside["trials"].with_name(f"{beside['trials'].name}.csv.gz"))
    with atomic_path(files[-1]) as path:
        path.write_bytes(compressed(kept.text(trials)))
    if last is not None:
        drawn = by_methods["switches"][most], by_methods["values"][most]
        files += draw(file_stem(experiment.name, plan, results / FIGURES), value_grid, *drawn, last.least)
    return Artefact(files, [(experiment.title, tables.rounded(table))], lines)


_LEGEND = (
    "Distance: RMS of ln(ours / printed) over the numbers of Table 2 that the stage is about. Each row is a "
    "configuration; switches at their value in the grid are left out. The file of trials has all configurations "
    "and ln(ours / printed) of all numbers that they computed. Least distances are minima over what was tried, so "
    "they are optimistic for the run as a whole, and too large for a value that few runs have."
)
_SHARE = f"{analysis.BEST:.0%}"
_LEGENDS = {
    "switches": (
        "## Switches\n\n"
        f"`share of best`: of the best {_SHARE} of the configurations, those with the best run's value. "
        "`importance`: for being among the nearest tenth (PED-ANOVA; all switches add up to 1). A switch is "
        f"`told` if all runs with another value are at least {analysis.TOLD:g} times as far from the table as the "
        f"best run, `open` if one is at most {analysis.OPEN:g} times as far, else `likely`. The CSV of values has "
        "the least distance and the shares of each value."
    ),
    "pairs": (
        "## Pairs that trade off\n\n"
        "With the first value alone (the other switch as in the best run), with the other alone, and with both: "
        "the least distances. The gain is the logarithm of the smaller of the first two over the last."
    ),
    "halves": (
        "## Halves\n\n"
        "The run that is best on four sequences, its distance there and on the other four, the least distance "
        "of any run on these, and that of the grid's own run."
    ),
    "numbers": (
        "## Numbers\n\n"
        f"The best run beside the printed numbers, the range of ours / printed in the best {_SHARE}, and the "
        "floor: the smallest factor between ours and the printed number in any run. A number is explained if one "
        f"of the best {_SHARE} is within {analysis.MET:.0%} of it."
    ),
}


def questions(trials: Sequence[Trial], settings: Settings) -> dict[str, Question]:
    """Return a question for each set of methods that a stage searches, if a configuration ran to its end."""
    stages = {stage.name: stage for stage in settings.stages}
    found = {name: analysis.question(trials, settings, stage.methods) for name, stage in stages.items()}
    return {name: each for name, each in found.items() if len(each.order)}


def _joined(by_methods: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return tables below each other, with a first column that names the methods."""
    import pandas as pd

    parts = [table.assign(methods=name) for name, table in by_methods.items() if len(table)]
    if not parts:
        return pd.DataFrame(columns=["methods"])
    joined = pd.concat(parts, ignore_index=True)
    return joined[["methods", *joined.columns.drop("methods")]]


def tellings(asked: Question, switches: pd.DataFrame, halves: pd.DataFrame, numbers: pd.DataFrame) -> list[str]:
    """Say how close the best run is, what is told of the switches, and what no run explains."""
    off = np.abs(asked.logs[asked.order[0]])
    within = {p: int((off <= math.log(1.0 + p / 100.0)).sum()) for p in (5, 10)}
    found = [
        f"The nearest run is at a distance of {asked.least:.4f}: of {len(off)} numbers {within[5]} are within 5 "
        f"%, {within[10]} within 10 %."
    ]
    better = _better(numbers)
    if better:
        found.append(f"In it TV-L1-SB is better than TV-L1 by {better}.")
    of = {
        verdict: ", ".join(f"{row['switch']}={row['best value']}" for _, row in part.iterrows())
        for verdict, part in switches.groupby("verdict")
    }
    found.append(
        f"Told: {of.get('told', 'none')}. Likely: {of.get('likely', 'none')}. All other switches are open; those "
        f"of which a value is excluded: {_excluded(switches)}."
    )
    if len(halves) > 1:
        first, other = halves.iloc[0], halves.iloc[-1]
        ratio = halves["ratio"]
        found.append(
            f"Chosen on {first['chosen on']}, a run has {first['distance there']:.3f} there and "
            f"{first['distance on the others']:.3f} on the others; chosen on these, {other['distance there']:.3f} "
            f"and {other['distance on the others']:.3f}. Over all {len(halves)} halves the ratio is "
            f"{ratio.median():.2f} in the median, from {ratio.min():.2f} to {ratio.max():.2f}."
        )
        usual = halves["grid's run on the others"]
        if usual.notna().all():
            nearer = int((halves["distance on the others"] < usual).sum())
            found.append(
                f"On the other half, the chosen run is nearer than the grid's own in {nearer} of {len(halves)} "
                f"cases; medians {halves['distance on the others'].median():.3f} and {usual.median():.3f}."
            )
    left = numbers[~numbers["explained"]]
    named = ", ".join(f"{row['sequence']} {row['method']} {row['metric'].upper()}" for _, row in left.iterrows())
    found.append(f"Numbers that none of the best runs explains: {named or 'none'}.")
    return found


def _better(numbers: pd.DataFrame) -> str:
    """Say by which errors, and on how many sequences, the second method is better than the first."""
    errors = numbers.pivot_table("best run", ["metric", "sequence"], "method", sort=False)
    if not {"tvl1", "tvl1_sb"} <= set(errors.columns):
        return ""
    smaller = (errors["tvl1_sb"] < errors["tvl1"]).groupby(level="metric").agg(["sum", "size"])
    rows = [(metric, smaller.loc[metric]) for metric in ("aae", "aepe")]
    return " and by ".join(f"{metric.upper()} on {row['sum']} of {row['size']} sequences" for metric, row in rows)


def _excluded(switches: pd.DataFrame) -> str:
    part = switches[(switches["verdict"] == "open") & (switches["excluded"] > 0)]
    return "; ".join(f"{row['switch']} is {row['not excluded']}" for _, row in part.iterrows()) or "none"


def trial_table(experiment: Experiment, plan: Plan, settings: Settings) -> TrialTable:
    """Return the table to which a search appends its trials."""
    return TrialTable(plan.config.results / RUNS / f"{experiment.name}_trials{plan.mark}.csv", settings)


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
            record["settings"] = ", ".join(f"{name}={word(value)}" for name, value in _turned(trial, settings))
            records.append(record)
    columns = ["stage", "distance", "numbers", "within 5 %", "within 10 %", "settings"]
    return pd.DataFrame(records, columns=columns)


def _nearest(trial: Trial) -> tuple[float, str, int]:
    return trial.distance, trial.study, trial.number


def _turned(trial: Trial, settings: Settings) -> list[tuple[str, Any]]:
    """Return the switches that a trial has at another value than the grid."""
    return [(name, value) for name, value in trial.values.items() if settings.usual.get(name) != value]


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
