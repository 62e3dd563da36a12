"""The interface of renderers: their output, and the names of their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row

if TYPE_CHECKING:
    import pandas as pd

#: A value counts as good as the best if its error is at most this much larger.
FLAT = 0.02
FIGURES = "figures"
#: Where pictures with Middlebury's frames in them go: the frames are not ours to publish.
PRIVATE = "private"


@dataclass
class Artefact:
    """The output of a renderer.

    Attributes
    ----------
    files : list of Path
        Files written.
    views : list of (str, pandas.DataFrame)
        Tables for the terminal, with their titles; cells are strings.
    lines : list of str
        Sentences for the terminal.
    """

    files: list[Path] = field(default_factory=list)
    views: list[tuple[str, pd.DataFrame]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)


Renderer = Callable[[Experiment, Plan, Mapping[str, Row], Path], Artefact]


def file_stem(name: str, plan: Plan, folder: Path) -> Path:
    """Return an artefact's path without suffix; its name marks synthetic scenes and thinned grids."""
    return folder / f"{name}{'_synthetic' if plan.stand_in else ''}{'_small' if plan.small else ''}"


def best_values(table: pd.DataFrame, names: list[str], numbers: list[str]) -> pd.DataFrame:
    """Return for each combination of names where the errors are smallest, and how flat the minimum is.

    Parameters
    ----------
    table : pandas.DataFrame
        Finished rows of a sweep.
    names, numbers : list of str
        Varying keys.

    Returns
    -------
    pandas.DataFrame
        Strings, for reading: the best values and errors; for one swept number the range within 2 % of the best.
        ``any`` stands for a number that the method does not depend on.
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
