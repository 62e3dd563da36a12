"""Tables: tidy rows of a plan, and the paper beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import write_text
from fracbench.evaluation.metrics import CONVENTIONS
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import METRICS
from fracbench.methods.registry import get_method
from fracbench.model import SOLVER_VERSION

if TYPE_CHECKING:
    import pandas as pd


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
        0 for equal tables; .1 is about 10 %. NaN if a ratio is.
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


def footnote(rows: Mapping[str, Row], protocols: Sequence[str]) -> list[str]:
    """Return what a reader must know of a table: conventions, protocols, versions, commit.

    Parameters
    ----------
    rows : mapping of str to Row
        The rows the table is made of.
    protocols : sequence of str
        The protocols in it.

    Returns
    -------
    list of str
        Paragraphs.
    """
    origins = {_origin(row) for row in rows.values()}
    return [
        CONVENTIONS,
        f"Protocols ({', '.join(protocols)}): see conf/protocol and docs/protocol.md. Parameters of each "
        "sequence: conf/sequence.",
        f"Solver version {SOLVER_VERSION}; computed with {'; '.join(sorted(origins))}.",
    ]


def _origin(row: Row) -> str:
    origin = row.provenance
    versions = ", ".join(f"{name} {version}" for name, version in sorted(origin.get("versions", {}).items()))
    commit = origin.get("commit")
    at = f"commit {commit[:12]}{' with local changes' if origin.get('dirty') else ''}" if commit else "no commit"
    return f"{versions}, Python {origin.get('python')}, {at}"


def write_table(table: pd.DataFrame, stem: Path) -> Path:
    """Write a table as CSV, with all digits, atomically.

    Parameters
    ----------
    table : pandas.DataFrame
        The table.
    stem : Path
        Path without suffix.

    Returns
    -------
    Path
        The file.
    """
    return write_text(table.to_csv(index=False, lineterminator="\n"), stem.with_name(stem.name + ".csv"))


def to_markdown(table: pd.DataFrame) -> str:
    """Return a table as Markdown, numbers rounded for reading."""
    return str(rounded(table).to_markdown(index=False, disable_numparse=True, stralign="right"))


def to_latex(table: pd.DataFrame, caption: str) -> str:
    """Return a table as LaTeX (booktabs), numbers rounded for reading."""
    shown = rounded(table)
    columns = "ll" + "r" * (shown.shape[1] - 2)
    return str(
        shown.to_latex(index=False, escape=True, caption=caption.replace("_", r"\_"), column_format=columns)
    )


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Return a copy with numbers as text: four digits after the point, ratios two."""
    shown = table.copy()
    for column in shown.columns:
        if shown[column].dtype.kind == "f":
            digits = 2 if str(column).endswith("ratio") else 4
            shown[column] = [("" if np.isnan(value) else f"{value:.{digits}f}") for value in shown[column]]
    return shown
