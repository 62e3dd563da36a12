"""The interface of renderers: their output, and the names of their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import ensure_folder
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row

if TYPE_CHECKING:
    import pandas as pd

#: A value counts as good as the best if its error is at most this much larger.
FLAT = 0.02
TABLES, FIGURES = "tables", "figures"
#: Where pictures with Middlebury's frames in them go: the frames are not ours to publish.
PRIVATE = "private"


@dataclass
class Artefact:
    """The output of a renderer: files, tables of text with titles and sentences for the terminal."""

    files: list[Path] = field(default_factory=list)
    views: list[tuple[str, pd.DataFrame]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)


#: A function of the experiment, its points, their rows by key, and the results folder.
Renderer = Callable[[Experiment, Plan, Mapping[str, Row], Path], Artefact]


def file_stem(name: str, plan: Plan, folder: Path) -> Path:
    """Make the folder and return a path in it, no suffix; the name marks other data, and thinned grids."""
    return ensure_folder(folder) / f"{name}{plan.mark}"


def best_values(table: pd.DataFrame, names: list[str], numbers: list[str]) -> pd.DataFrame:
    """Return the values of `numbers` with the smallest errors, as text, for each combination of `names`.

    For a single number, the range within 2 % of the best is added. ``any`` stands for a number that the method
    does not depend on.
    """
    import pandas as pd

    records = []
    groups = table.groupby(names, sort=False, dropna=False) if names else [((), table)]
    for values, part in groups:
        record: dict[str, Any] = dict(zip(names, values, strict=True))
        for metric in ("aae", "aepe"):
            best = part.loc[part[metric].idxmin()] if part[metric].notna().any() else None
            shown = "none" if best is None else ", ".join(_number(best[number]) for number in numbers)
            record[f"{metric.upper()} best at"] = shown
            record[metric.upper()] = "" if best is None else f"{best[metric]:.4f}"
            if len(numbers) == 1 and best is not None:
                near = part[part[metric] <= (1.0 + FLAT) * best[metric]][numbers[0]]
                record[f"{metric.upper()} within {FLAT:.0%}"] = f"{_number(near.min())} to {_number(near.max())}"
        records.append(record)
    return pd.DataFrame(records)


def _number(value: float) -> str:
    return "any" if np.isnan(value) else f"{value:g}"
