"""Table 2 of the paper: its numbers beside ours, the distance between them, and the artefact that shows both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import ensure_folder, write_text
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.paths import asset
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import METRICS, tidy
from fracbench.methods.registry import get_method
from fracbench.studies import tables
from fracbench.studies.base import Artefact, file_stem

if TYPE_CHECKING:
    import pandas as pd


def table2(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write Table 2 as CSV, Markdown and LaTeX, a part a protocol; see `fracbench.studies.base.Renderer`."""
    import pandas as pd

    published = pd.read_csv(asset("results/published/table2.csv"))
    comparison = versus_published(tidy(plan, rows), published)
    stem = file_stem(experiment.name, plan, ensure_folder(results / "tables"))
    protocols = list(comparison["protocol"].unique())
    artefact = Artefact()
    parts, latex = [f"# {experiment.title}\n"], []
    for protocol in protocols:
        table, sentences = wide(comparison, protocol), summary(comparison, protocol)
        parts += [f"## Protocol `{protocol}`\n", tables.to_markdown(table) + "\n", "\n".join(sentences) + "\n"]
        latex.append(tables.to_latex(table, f"{experiment.title} (protocol {protocol})"))
        artefact.views.append((f"{experiment.title}, protocol {protocol}", tables.rounded(table)))
        artefact.lines += [f"{protocol}: {sentence}" for sentence in sentences]
    notes = [*plan.notices, *tables.footnote(rows, protocols)]
    parts.append("\n\n".join(notes) + "\n")
    latex += ["% " + line for line in notes]
    artefact.lines += notes
    # Written last, so that a table that cannot be laid out replaces none of them.
    artefact.files = [
        tables.write_table(comparison, stem),
        write_text("\n".join(parts), stem.with_name(stem.name + ".md")),
        write_text("\n".join(latex) + "\n", stem.with_name(stem.name + ".tex")),
    ]
    return artefact


def versus_published(table: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Put the paper's numbers beside ours, one row a number.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tidy`, with one row for each protocol, sequence and method.
    published : pandas.DataFrame
        Columns ``sequence, method, aae, aepe, sdae``.

    Returns
    -------
    pandas.DataFrame
        ``protocol, sequence, method, metric, published, ours, ratio``; `published` is NaN for a synthetic
        scene, which the paper does not have.
    """
    keys = ["sequence", "method"]
    ours = table.melt(["protocol", *keys], list(METRICS), "metric", "ours")
    theirs = published.melt(keys, list(METRICS), "metric", "published")
    both = ours.merge(theirs, on=[*keys, "metric"], how="left", validate="many_to_one")
    both["ratio"] = both["ours"] / both["published"]
    order = {metric: i for i, metric in enumerate(METRICS)}
    # melt() goes through the metrics one by one: bring the numbers of a row together again.
    both["_row"] = list(range(len(table))) * len(METRICS)
    both["_metric"] = both["metric"].map(order)
    both = both.sort_values(["_row", "_metric"]).reset_index(drop=True)
    return both[["protocol", *keys, "metric", "published", "ours", "ratio"]]


def distance(ratio: Any) -> float:
    """Return the root mean square of ``ln(ours / published)``, the distance between two tables.

    Parameters
    ----------
    ratio : array_like
        Ratios ours / published.

    Returns
    -------
    float
        0 for equal tables; 0.1 is about 10 %. NaN if a ratio is.
    """
    return float(np.sqrt(np.mean(np.log(np.asarray(ratio, np.float64)) ** 2)))


def wide(comparison: pd.DataFrame, protocol: str) -> pd.DataFrame:
    """Lay the comparison for one protocol out as the paper's table.

    Parameters
    ----------
    comparison : pandas.DataFrame
        From `versus_published`.
    protocol : str
        Which protocol.

    Returns
    -------
    pandas.DataFrame
        A row for each sequence and method; for each error the published number, ours, and their ratio.
    """
    import pandas as pd

    part = comparison[comparison["protocol"] == protocol]
    rows = []
    for (sequence, method), group in part.groupby(["sequence", "method"], sort=False):
        row: dict[str, Any] = {"sequence": sequence, "method": get_method(str(method)).label}
        for metric, published, ours, ratio in zip(
            group["metric"], group["published"], group["ours"], group["ratio"], strict=True
        ):
            name = metric.upper()
            row.update({f"{name} paper": published, f"{name} ours": ours, f"{name} ratio": ratio})
        rows.append(row)
    return pd.DataFrame(rows).dropna(axis="columns", how="all")


def summary(comparison: pd.DataFrame, protocol: str) -> list[str]:
    """Say in sentences how far a protocol is from the paper, and whether SB is better.

    Parameters
    ----------
    comparison : pandas.DataFrame
        From `versus_published`.
    protocol : str
        Which protocol.

    Returns
    -------
    list of str
        Sentences, computed from the numbers.
    """
    part = comparison[comparison["protocol"] == protocol]
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
