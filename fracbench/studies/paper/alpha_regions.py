"""Figures 6 and 7: errors against alpha on the regions, drawn from the parts of one experiment.

============= ==========================================================================================
``main``      the paper: region alone, ``boundary=zero``, lambda_sb swept
``band``      the same at the caption's lambda_sb, on boxes shifted about the region
``context``   ``boundary=reflect`` with pixels of image around the region
``protocols`` the other protocols
============= ==========================================================================================

All but ``main`` may be left out. ``options.paper`` holds the captions' best alpha of each region under
``aae`` and ``aepe``; the caption's ``lambda_sb`` is that of ``conf/region``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError
from fracbench.figures.panels import Curve, Panel, panel_grid
from fracbench.figures.style import BEHIND, METRICS, PALETTE, equation, symbol
from fracbench.harness.config.compose import load_config
from fracbench.harness.config.experiment import MAIN, Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, Artefact, best_values, file_stem

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

X = "alpha"
SB = "lambda_sb"
#: The experiments of the figures whose captions name best values.
CAPTIONED = ("fig6", "fig7")
BAND, CONTEXT, PROTOCOLS = "band", "context", "protocols"
_HEADINGS = {
    "": "the region alone, boundary zero",
    CONTEXT: "with context, boundary reflect",
    PROTOCOLS: "under each protocol, the region alone, boundary zero",
}
_COLUMNS = [
    "part", "protocol", "region", "sequence", "boundary", "context", "shift", SB, X, "aae", "aepe", "status",
]  # fmt: skip

_BEST = {"color": PALETTE[0], "marker": "o", "markersize": 3.5, "zorder": 3}
_CAPTION = {"color": "#404040", "linewidth": 1.1, "linestyle": "--", "zorder": 2.2}
_OTHER = {"color": BEHIND, "linewidth": 0.8, "zorder": 1.5}


def alpha_regions(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw Figure 6 or 7 as in the paper; then with context, and under the other protocols."""
    from fracbench.figures.cache import draw

    table = tidy(plan, rows).reindex(columns=_COLUMNS)
    if MAIN not in set(table["part"]):
        raise InputError(f"experiment {experiment.name}: artefact {experiment.artefact} needs the grid {MAIN!r}")
    story = _Regions(table, captions(experiment))
    folder = results / FIGURES
    artefact = Artefact(views=story.views())
    for kind in story.kinds():
        stem = file_stem(f"{experiment.name}{f'_{kind}' if kind else ''}", plan, folder)
        artefact.files += draw(stem, regions_figure, table, story.captions, kind, experiment.title)
    artefact.files.append(tables.write_table(table, file_stem(experiment.name, plan, folder)))
    if story.has(BAND):
        stem = file_stem(f"{experiment.name}_{BAND}", plan, folder)
        artefact.files.append(tables.write_table(story.band(), stem))
    return artefact


def regions_figure(
    table: pd.DataFrame, captions: Mapping[str, Mapping[str, float]], kind: str, title: str
) -> Figure:
    """Draw one figure of the regions from the tidy rows of all parts.

    `captions` is that of `captions`; `kind` is ``""`` for the paper's figure, ``"context"`` or ``"protocols"``.
    """
    story = _Regions(table, captions)
    compose = {"": story.main_panel, CONTEXT: story.context_panel, PROTOCOLS: story.protocols_panel}[kind]
    note = f"{equation(X, 0)}: the operator is the identity there" if kind == CONTEXT else ""
    return panel_grid(story.regions, compose, x=X, title=f"{title}\n{_HEADINGS[kind]}", note=note)


def captions(experiment: Experiment) -> dict[str, dict[str, float]]:
    """Return by region the ``lambda_sb, aae, aepe`` of the captions: where the errors are smallest.

    The experiment's option ``paper`` has the best alpha by error; the best lambda_sb is that of ``conf/region``.
    """
    try:
        given = dict(experiment.options.get("paper", {}))
        alphas = {str(name): {metric: float(said[metric]) for metric in METRICS} for name, said in given.items()}
    except (TypeError, ValueError, KeyError) as exc:
        wanted = "a mapping of regions to " + "{ " + ", ".join(f"{key}: NUMBER" for key in METRICS) + " }"
        raise InputError(f"experiment {experiment.name}: the option 'paper' must be {wanted}") from exc
    return {name: {SB: load_config({"region": name}).params.lambda_sb, **best} for name, best in alphas.items()}


class _Regions:
    """The rows of the experiment, and the curves and bands of its panels."""

    def __init__(self, table: pd.DataFrame, captions: Mapping[str, Mapping[str, float]]) -> None:
        self.table = table
        self.captions = captions
        self.regions = [str(name) for name in table["region"].unique()]
        self.scenes = dict(zip(table["region"], table["sequence"], strict=True))

    def has(self, part: str) -> bool:
        return bool((self.table["part"] == part).any())

    def part(self, part: str, region: str) -> pd.DataFrame:
        return self.table[(self.table["part"] == part) & (self.table["region"] == region)]

    def kinds(self) -> list[str]:
        """Return the kinds of figure that can be drawn: see `regions_figure`."""
        return ["", *(part for part in (CONTEXT, PROTOCOLS) if self.has(part))]

    def band(self) -> pd.DataFrame:
        """Return the smallest and largest errors over the shifted boxes, for each region and alpha."""
        boxes = self.table[self.table["part"] == BAND]
        ranges = boxes.groupby(["region", X], sort=False)[list(METRICS)].agg(["min", "max"])
        ends = {"min": "low", "max": "high"}
        ranges.columns = [f"{metric}_{ends[end]}" for metric, end in ranges.columns]
        return ranges.reset_index()

    def main_panel(self, region: str, metric: str) -> Panel:
        rows = self.part(MAIN, region)
        said = self._caption(region)
        best = rows.loc[rows[metric].idxmin(), SB] if rows[metric].notna().any() else None
        curves = [
            Curve(part, f"other {symbol(SB)} in {rows[SB].min():g} to {rows[SB].max():g}", _OTHER)
            for value, part in rows.groupby(SB)
            if value not in (best, said.get(SB))
        ]
        if said.get(SB) != best:
            curves += self._caption_curve(region, f"{symbol(SB)} of the paper's caption")
        if best is not None:
            label = f"the {symbol(SB)} with the smallest error"
            curves.append(Curve(rows[rows[SB] == best], label, _BEST, starred=True))
        heading = [self._name(region)]
        if best is not None:
            paper = f" (paper: {said[SB]:g})" if SB in said else ""
            heading.append(f"best {equation(SB, best)}{paper}")
        boxes = self.part(BAND, region)
        return Panel(
            "\n".join(heading),
            curves,
            self.band().query("region == @region") if len(boxes) else None,
            f"smallest to largest over {boxes['shift'].nunique()} shifted boxes ({symbol(SB)} of the caption)",
            said.get(metric),
        )

    def context_panel(self, region: str, metric: str) -> Panel:
        rows = self.part(CONTEXT, region)
        boundary, pixels = rows["boundary"].iloc[0], rows["context"].iloc[0]
        label = f"boundary {boundary}, {pixels} pixels of context"
        curves = self._caption_curve(region, "boundary zero, the region alone")
        curves.append(Curve(rows, label, _BEST, starred=True, ringed=True))
        return Panel(self._heading(region), curves, published=self._caption(region).get(metric))

    def protocols_panel(self, region: str, metric: str) -> Panel:
        curves = self._caption_curve(region, None, _BEST, starred=True)
        for i, (name, rows) in enumerate(self.part(PROTOCOLS, region).groupby("protocol", sort=False), start=1):
            look = _BEST | {"color": PALETTE[i % len(PALETTE)], "marker": "sD^v"[i % 4]}
            curves.append(Curve(rows, f"protocol {name}", look, starred=True))
        return Panel(self._heading(region), curves, published=self._caption(region).get(metric))

    def _caption_curve(
        self, region: str, label: str | None, look: Mapping[str, Any] = _CAPTION, *, starred: bool = False
    ) -> list[Curve]:
        """Return the curve of ``main`` at the caption's lambda_sb, if both are there."""
        rows = self.part(MAIN, region)
        rows = rows[rows[SB] == self._caption(region).get(SB)]
        if not len(rows):
            return []
        return [Curve(rows, label or f"protocol {rows['protocol'].iloc[0]}", look, starred=starred)]

    def _caption(self, region: str) -> Mapping[str, float]:
        return self.captions.get(region, {})

    def _name(self, region: str) -> str:
        scene = self.scenes[region]
        return f"{region}: {scene}" if scene.startswith("synthetic") else region

    def _heading(self, region: str) -> str:
        said = self._caption(region).get(SB)
        return self._name(region) if said is None else f"{self._name(region)}, {equation(SB, said)}"

    def views(self) -> list[tuple[str, pd.DataFrame]]:
        """Return the best values over lambda_sb and alpha, then over alpha at the caption's lambda_sb."""
        done = self.table[self.table["status"] == "done"]
        main = done["part"] == MAIN
        swept = best_values(done[main], ["region"], [SB, X])
        for metric in METRICS:
            captions = [self.captions.get(region) for region in swept["region"]]
            published = [f"{said[SB]:g}, {said[metric]:g}" if said else "" for said in captions]
            swept.insert(swept.columns.get_loc(metric.upper()) + 1, f"{metric.upper()} paper at", published)
        at_caption = done[SB] == done["region"].map({name: said[SB] for name, said in self.captions.items()})
        fixed = done[(main & at_caption) | done["part"].isin([CONTEXT, PROTOCOLS])]
        names = ["region", "protocol", "boundary", "context"]
        return [
            (f"Where the errors are smallest: {SB}, {X} (boundary zero, the region alone)", swept),
            (f"Where the errors are smallest: {X} (at the caption's {SB})", best_values(fixed, names, [X])),
        ]
