"""The ablation of the accurate preset: the gain of each ingredient, and leave-one-out errors of its weights."""

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
from fracbench.model.params import FlowParams
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact, file_stem

if TYPE_CHECKING:
    import pandas as pd

#: Parts of the experiment: none of the ingredients, all of them, and the grid the preset is chosen from.
PLAIN, ALL, CHOICE = "plain", "accurate", "choice"
#: No candidate of the choice: a preset for frames in gray must not ask for colour.
COLOUR = f"{ALL}+colour weights"
#: Prefix of the other parts' names, the change made there, and the part to compare with.
_CHANGES = {
    f"{PLAIN}/": ("added alone", PLAIN),
    f"{ALL}/": ("taken from the whole", ALL),
    f"{ALL}+": ("added to the whole", ALL),
}
_LEGEND = (
    f"`{PLAIN}` has none of the ingredients and `{PLAIN}/x` has x alone; `{ALL}` is the preset, `{ALL}/x` has all "
    f"but x, `{ALL}+x` has x on top. "
    "AEPE in pixels, AAE in degrees, `seconds` of computing as stored: each the mean over the sequences, then "
    "AEPE for each sequence."
)
_CHOICE_LEGEND = (
    "Among the preset, the preset with an ingredient (other than colour) taken away or added, and the settings of "
    f"`{CHOICE}`, the setting with the least mean AEPE on the other sequences is scored on each sequence "
    "(leave-one-out): its true flow does not influence the choice. `all in`: the setting with the least mean over "
    "all."
)


def accurate_study(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the ablation of the preset and its choice; see `fracbench.studies.base.Renderer`."""
    for part in (PLAIN, ALL, CHOICE):
        if part not in experiment.grids:
            raise InputError(f"experiment {experiment.name}: the grid `{part}` is missing")
    table = tidy(plan, rows)
    table["seconds"] = [rows[key].seconds if key in rows else math.nan for key in table["key"]]
    ablation = ablation_table(table[table["part"] != CHOICE])
    candidates = [str(part).startswith((ALL, CHOICE)) and part != COLOUR for part in table["part"]]
    choice = choice_table(table[candidates])
    lines = [*ablation_sentences(ablation), *choice_sentences(choice)]
    stem = file_stem(experiment.name, plan, results / TABLES)
    files = [
        # Seconds differ from machine to machine: they are in the text, not in the table to compare.
        tables.write_table(ablation.drop(columns="seconds"), stem),
        tables.write_table(choice, stem.with_name(f"{stem.name}_choice")),
        tables.write_markdown(
            stem,
            f"# {experiment.title}",
            _LEGEND,
            tables.to_markdown(_short(ablation)),
            "## Chosen without the sequence",
            _CHOICE_LEGEND,
            tables.to_markdown(choice),
            *lines,
            *plan.notices,
            *tables.footnote(rows, [ALL]),
        ),
    ]
    views = [(experiment.title, tables.rounded(_short(ablation))), ("Left out in turn", tables.rounded(choice))]
    return Artefact(files, views, lines)


def ablation_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each part of the ablation: ``part, seconds, AEPE [px], AAE [degrees]``, and by sequence.

    A mean over fewer sequences than planned would not be comparable: it is NaN.
    """
    import pandas as pd

    records = []
    for part, group in table.groupby("part", sort=False):
        degrees = group["aae"] * (180.0 / math.pi)
        record: dict[str, Any] = {"part": part, "seconds": group["seconds"].mean(skipna=False)}
        record |= {"AEPE": group["aepe"].mean(skipna=False), "AAE": degrees.mean(skipna=False)}
        record |= {f"AEPE {name}": value for name, value in zip(group["sequence"], group["aepe"], strict=True)}
        record |= {f"AAE {name}": value for name, value in zip(group["sequence"], degrees, strict=True)}
        records.append(record)
    return pd.DataFrame(records)


def choice_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return ``sequence, setting, AEPE, AAE``: the setting for each sequence that is best on the others.

    Of the part `CHOICE` each combination of varying parameters is a setting; every other part is one. The row
    ``left out`` has the means, ``all in`` the setting that is best on all. Where points failed, errors are NaN and
    settings empty.
    """
    import pandas as pd

    weights = table[table["part"] == CHOICE]
    varying = [name for name in FlowParams.names() if name in weights and weights[name].nunique() > 1]
    labels = [", ".join(f"{name}={value:g}" for name, value in zip(varying, row, strict=True))
              for row in table[varying].to_numpy()]  # fmt: skip
    names = [label if part == CHOICE else part for part, label in zip(table["part"], labels, strict=True)]
    table = table.assign(setting=names, degrees=table["aae"] * (180.0 / math.pi))
    # Settings in the order of the grid: of equally good ones the first is taken.
    order = list(dict.fromkeys(names)), list(dict.fromkeys(table["sequence"]))
    errors = table.pivot(index="setting", columns="sequence", values=["aepe", "degrees"])
    aepe, aae = (errors[metric].loc[order] for metric in ("aepe", "degrees"))
    columns = ["sequence", "setting", "AEPE", "AAE"]
    choice = None if aepe.isna().any(axis=None) else leave_one_out(aepe)
    if choice is None:
        unknown = [[name, "", math.nan, math.nan] for name in (*aepe, "left out", "all in")]
        return pd.DataFrame(unknown, columns=columns)
    records: list[list[Any]] = [
        [sequence, aepe.index[row], aepe[sequence].iloc[row], aae[sequence].iloc[row]]
        for sequence, row in zip(aepe, choice.left_out, strict=True)
    ]
    means = [sum(record[i] for record in records) / len(records) for i in (2, 3)]
    best = aepe.index[choice.all_in]
    records += [["left out", "", *means], ["all in", best, aepe.loc[best].mean(), aae.loc[best].mean()]]
    return pd.DataFrame(records, columns=columns)


def _short(ablation: pd.DataFrame) -> pd.DataFrame:
    """Return the ablation for reading: the angular errors of single sequences are in the table alone."""
    return ablation[[column for column in ablation if not column.startswith("AAE ")]]


def ablation_sentences(ablation: pd.DataFrame) -> list[str]:
    """State the change of AEPE by each ingredient alone, left out, and on top, where these are known."""
    aepe = ablation.set_index("part")["AEPE"]
    effects: dict[str, list[str]] = {}
    for part, error in aepe.items():
        for start, (words, whole) in _CHANGES.items():
            if str(part).startswith(start):
                percent = 100.0 * (error / aepe[whole] - 1.0)
                told = f"{words} {percent:+.1f} %" if math.isfinite(percent) else ""
                effects.setdefault(str(part).removeprefix(start), []).append(told)
    return [f"{name}: {', '.join(told)} AEPE." for name, told in effects.items() if all(told)]


def choice_sentences(choice: pd.DataFrame) -> list[str]:
    """State both means; nothing where points failed."""
    means = choice.set_index("sequence")
    if means["AEPE"].isna().any():
        return []
    left_out, all_in = means.loc["left out"], means.loc["all in"]
    return [
        f"Chosen on the other sequences: AEPE {left_out['AEPE']:.4f} px, AAE {left_out['AAE']:.3f} degrees; "
        f"chosen on all ({all_in['setting']}): {all_in['AEPE']:.4f} px, {all_in['AAE']:.3f} degrees."
    ]
