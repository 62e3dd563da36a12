"""Table 2 of the paper: its numbers beside ours, the distance between them, and the artefact that shows both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import write_text
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.paths import asset
from fracbench.harness.run.grid_points import PlannedPoints
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import METRICS, tidy
from fracbench.methods.registry import get_method
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact, file_stem

if TYPE_CHECKING:
    import pandas as pd


def table2(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write Table 2 as CSV, Markdown and LaTeX, a part a protocol; see `fracbench.studies.base.Renderer`."""
    comparison = versus_published(tidy(plan, rows), printed_table())
    stem = file_stem(experiment.name, plan, results / TABLES)
    protocols = list(comparison["protocol"].unique())
    artefact = Artefact()
    text, latex = [f"# {experiment.title}"], []
    for protocol in protocols:
        table, sentences = wide(comparison, protocol), summary(comparison, protocol)
        text += [f"## Protocol `{protocol}`", tables.to_markdown(table), "\n".join(sentences)]
        latex.append(tables.to_latex(table, f"{experiment.title} (protocol {protocol})"))
        artefact.views.append((f"{experiment.title}, protocol {protocol}", tables.rounded(table)))
        artefact.lines += [f"{protocol}: {sentence}" for sentence in sentences]
    notes = [*plan.notices, *tables.footnote(rows, protocols)]
    latex += ["% " + line for line in notes]
    artefact.lines += notes
    # Written last, so that a table that cannot be laid out replaces none of them.
    artefact.files = [
        tables.write_table(comparison, stem),
        tables.write_markdown(stem, *text, *notes),
        write_text("\n".join(latex) + "\n", stem.with_name(stem.name + ".tex")),
    ]
    return artefact


def protocol_claims(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write Table 2 from the part of that name: the other parts are for `fracbench.report.claims.further`."""
    points = [planned for planned in plan.points if planned.labels["part"] == "table2"]
    return table2(experiment, replace(plan, points=PlannedPoints(points)), rows, results)


def printed_table() -> pd.DataFrame:
    """Return Table 2 as the paper prints it."""
    import pandas as pd

    return pd.read_csv(asset("results/published/table2.csv"))


def versus_published(table: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Put the paper's numbers beside ours: ``protocol, sequence, method, metric, published, ours, ratio``.

    `published` is NaN for a synthetic scene, which the paper does not have.
    """
    keys = ["sequence", "method"]
    ours = table.melt(["protocol", *keys], list(METRICS), "metric", "ours")
    theirs = published.melt(keys, list(METRICS), "metric", "published")
    both = ours.merge(theirs, on=[*keys, "metric"], how="left", validate="many_to_one")
    both["ratio"] = both["ours"] / both["published"]
    # melt() goes through the metrics one by one: bring the numbers of a row together again.
    rows = np.arange(len(both)).reshape(len(METRICS), -1).T.ravel()
    return both[["protocol", *keys, "metric", "published", "ours", "ratio"]].iloc[rows].reset_index(drop=True)


def distance(ratio: Any) -> float:
    """Return the root mean square of ``ln(ours / published)``: 0 for equal tables, 0.1 for about 10 %."""
    return float(np.sqrt(np.mean(np.log(np.asarray(ratio, np.float64)) ** 2)))


def wide(comparison: pd.DataFrame, protocol: str) -> pd.DataFrame:
    """Lay the comparison for one protocol out as the paper's table: a row for each sequence and method."""
    import pandas as pd

    part = comparison[comparison["protocol"] == protocol]
    rows = []
    for (sequence, method), group in part.groupby(["sequence", "method"], sort=False):
        row: dict[str, Any] = {"sequence": sequence, "method": get_method(str(method)).label}
        for number in group.itertuples():
            name = number.metric.upper()
            row |= {f"{name} paper": number.published, f"{name} ours": number.ours, f"{name} ratio": number.ratio}
        rows.append(row)
    return pd.DataFrame(rows).dropna(axis="columns", how="all")


def summary(comparison: pd.DataFrame, protocol: str) -> list[str]:
    """Say in sentences how far a protocol is from the paper, and whether SB is better."""
    part = comparison[comparison["protocol"] == protocol]
    if part["ours"].isna().all():
        return ["No errors: the true flow is not known, or every point failed."]
    sentences = []
    if part["published"].notna().all():
        off = np.abs(np.log(part["ratio"]))
        sentences.append(
            f"Distance to the paper (RMS of ln(ours / published), {len(part)} numbers): "
            f"{distance(part['ratio']):.3f}; {(off <= np.log(1.05)).sum()} numbers within 5 %, "
            f"{(off <= np.log(1.10)).sum()} within 10 %."
        )
    by_method = part.pivot_table("ours", ["sequence", "metric"], "method", sort=False, dropna=False)
    if {"tvl1", "tvl1_sb"} <= set(by_method.columns):
        better = (by_method["tvl1_sb"] < by_method["tvl1"]).unstack("metric")
        n = len(better)
        sentences.append(
            f"TV-L1-SB is better than TV-L1 on {int(better['aae'].sum())} of {n} sequences by AAE, on "
            f"{int(better['aepe'].sum())} of {n} by AEPE (paper: 8 of 8 by both)."
        )
    # A mean over fewer sequences than the others' would not be comparable.
    means = part.groupby(["method", "metric"], sort=False)["ours"].agg(lambda ours: ours.mean(skipna=False))
    for method in part["method"].unique():
        aae, aepe = means[method, "aae"], means[method, "aepe"]
        sentences.append(f"Mean of {get_method(method).label}: AAE {aae:.4f} rad, AEPE {aepe:.4f} px.")
    return sentences
