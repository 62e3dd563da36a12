"""The study of the best alpha for each structure: its tables, sentences and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.datasets.registry import load_sequence
from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, PRIVATE, TABLES, Artefact, file_stem
from fracbench.studies.structure.tables import (
    ALL,
    BY_CLASS,
    SCENES,
    best_table,
    curve_table,
    long_table,
    sentences,
)

if TYPE_CHECKING:
    import pandas as pd

_LEGEND = (
    "`best` is the alpha with the smallest error relative to alpha = 1, in the geometric mean over seeds (scenes) "
    f"or sequences (classes of pixels, `{ALL}`: all of them), with the interval of 2000 bootstrap resamples. The "
    "gain over alpha = 1, with Student's interval, is taken at the alpha that is best for the other half of the "
    "seeds or sequences: an alpha chosen on the same data always gains something. `paper`: section 4.2, where "
    "flat is close to 0, read as up to 0.3; `costs`: the best alpha in that range against the best of all. Under "
    "`reflect`, alpha = 0 is apart: the operator is the identity there. Parameters: conf/sequence."
)


def alpha_by_structure(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw errors against alpha by structure, and the classes; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures.cache import draw
    from fracbench.studies.structure.figures import structure_panels

    runs, paper = tidy(plan, rows), _paper(experiment)
    errors = long_table(runs)
    best, curves = best_table(errors, paper), curve_table(errors)
    shown, lines = _readable(best), sentences(best)

    def stem(kind: str, folder: str) -> Path:
        return file_stem(f"{experiment.name}{kind}", plan, results / folder)

    text = [f"# {experiment.title}", _LEGEND, "\n".join(f"- {line}" for line in lines), tables.to_markdown(shown)]
    text += [*plan.notices, *tables.footnote(rows, sorted(set(runs["protocol"])))]
    files = [tables.write_table(best, stem("", TABLES)), tables.write_table(curves, stem("_curves", TABLES))]
    files.append(tables.write_markdown(stem("", TABLES), *text))
    for part, kind in ((SCENES, ""), (BY_CLASS, "_classes")):
        chosen = _of_figure(curves, part, experiment.options.get("shown_noise"))
        if len(chosen):
            files += draw(stem(kind, FIGURES), structure_panels, chosen, paper, _heading(experiment, chosen))
    files += _pictures(plan, stem)
    return Artefact(files, [(experiment.title, tables.rounded(shown))], lines)


def _paper(experiment: Experiment) -> dict[str, tuple[float, float]]:
    """Return the paper's ranges, checked."""
    try:
        said = dict(experiment.options.get("paper") or {})
        return {str(name): (float(low), float(high)) for name, (low, high) in said.items()}
    except (TypeError, ValueError) as exc:
        wanted = "a mapping of structures to [LOWEST, HIGHEST] alpha"
        raise InputError(f"experiment {experiment.name}: the option 'paper' must be {wanted}") from exc


def _of_figure(curves: pd.DataFrame, part: str, noise: Any) -> pd.DataFrame:
    """Return the curves by AEPE of one part and one noise: the one asked for, or else the first."""
    chosen = curves[(curves["part"] == part) & (curves["metric"] == "aepe")]
    wanted = chosen["noise"] == ("" if noise is None else f"{noise:g}")
    return chosen[wanted if wanted.any() else chosen["noise"].isin(chosen["noise"].head(1))]


def _heading(experiment: Experiment, chosen: pd.DataFrame) -> str:
    noise, n = chosen["noise"].iloc[0], int(chosen["n"].max())
    if chosen["part"].iloc[0] == BY_CLASS:
        return f"{experiment.title}\nAEPE within classes of pixels, {n} sequences"
    return f"{experiment.title}\nAEPE on scenes of one structure, {n} seeds, noise {noise}"


def _readable(best: pd.DataFrame) -> pd.DataFrame:
    """Return the table for reading: intervals in one cell, percentages with one digit."""

    def between(low: str, high: str, digits: int) -> list[str]:
        ends = zip(best[low], best[high], strict=True)
        return ["" if a != a or b != b else f"{a:.{digits}f} to {b:.{digits}f}" for a, b in ends]

    shown = best[["structure", "noise", "boundary", "metric", "n"]].copy()
    shown["best"] = best["best"].map("{:g}".format)
    shown["95 %"] = between("best_low", "best_high", 1)
    shown["error at 1"] = best["error_at_1"]
    shown["gain %"] = ["" if gain != gain else f"{gain:.1f}" for gain in best["gain"]]
    shown["gain 95 %"] = between("gain_low", "gain_high", 1)
    shown["paper"] = between("paper_low", "paper_high", 1)
    shown["costs %"] = ["" if cost != cost else f"{cost:.1f}" for cost in best["costs"]]
    shown["verdict"] = best["verdict"]
    return shown


def _pictures(plan: Plan, stem: Any) -> list[Path]:
    """Draw the first frames with their classes: the scenes' to publish, Middlebury's in the private folder."""
    from fracbench.figures.cache import draw
    from fracbench.figures.pictures import frame_panel
    from fracbench.studies.structure.figures import CLASS_COLOURS, class_overlay

    scenes = dict.fromkeys((planned.point.dataset, planned.point.sequence) for planned in plan.points)
    title = f"Classes of pixels: {', '.join(f'{colour} {name}' for name, (colour, _) in CLASS_COLOURS.items())}"
    files: list[Path] = []
    for dataset, kind, place, columns in (
        ("synthetic", "_scenes", FIGURES, 3),
        ("middlebury", "_frames", PRIVATE, 4),
    ):
        names = [name for of, name in scenes if of == dataset]
        names.sort(key=lambda name: SINGLE_STRUCTURE.index(name) if name in SINGLE_STRUCTURE else -1)
        folder = plan.folder if dataset == "middlebury" else None
        items = [(name, class_overlay(load_sequence(name, dataset, folder).frame0)) for name in names]
        if items:
            files += draw(stem(kind, place), frame_panel, items, columns=columns, title=title)
    return files
