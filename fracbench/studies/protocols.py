"""The protocol study: the distance to the printed Table 2 as the switches of the protocols are turned."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, TABLES, Artefact, file_stem
from fracbench.studies.paper.table2 import distance, printed_table, versus_published

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def protocol_study(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Show the distance to the printed Table 2 as switches are turned; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures.cache import draw

    table = switch_table(tidy(plan, rows), printed_table(), experiment.grids)
    lines = switch_sentences(table)
    stem = file_stem(experiment.name, plan, results / TABLES)
    notes = [*plan.notices, *tables.footnote(rows, ["reference", "published"])]
    text = [f"# {experiment.title}", _SWITCH_LEGEND, tables.to_markdown(table), *lines, *notes]
    drawn = draw(file_stem(experiment.name, plan, results / FIGURES), switch_dots, table, experiment.title)
    files = [tables.write_table(table, stem), tables.write_markdown(stem, *text), *drawn]
    return Artefact(files, [(experiment.title, tables.rounded(table))], lines)


_SWITCH_LEGEND = (
    "Distance: RMS of ln(ours / printed) over the numbers of Table 2 (AAE, AEPE, SDAE of both methods), 0 if all "
    "are met, about 2.3 where ours are ten times smaller. Each row is the protocol in the first column with the "
    "switches in the second turned to the other protocol's setting; a method that does not use a switch keeps its "
    "numbers. AEPE in pixels, mean over the sequences."
)


def switch_table(table: pd.DataFrame, published: pd.DataFrame, grids: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Return a row for each part of the study; part ``a/b+c`` is part ``a`` with the switches b and c turned.

    Columns: ``protocol, switch, set to``, distances (all, TV-L1, TV-L1-SB), numbers within 5 and 10 %, sequences
    on which TV-L1-SB is better, mean AEPE [px]. Distances are NaN where points failed or nothing is printed.
    """
    import pandas as pd

    comparison = versus_published(table.assign(protocol=table["part"]), published)
    records = []
    for part, group in comparison.groupby("protocol", sort=False):
        base, _, switch = str(part).partition("/")
        settings = [token for token in grids[str(part)] if token not in grids[base]]
        errors = group.pivot_table("ours", ["sequence", "metric"], "method", dropna=False)
        aepe = errors.xs("aepe", level="metric")
        better = (errors["tvl1_sb"] < errors["tvl1"]).groupby("metric").sum()
        off = np.abs(np.log(group["ratio"]))
        record: dict[str, Any] = {"protocol": base, "switch": switch, "set to": ", ".join(settings)}
        record["distance"] = distance(group["ratio"])
        for method in ("tvl1", "tvl1_sb"):
            record[f"distance {method}"] = distance(group[group["method"] == method]["ratio"])
        record |= {f"within {p} %": int((off <= math.log(1.0 + p / 100.0)).sum()) for p in (5, 10)}
        record |= {f"SB better, {metric.upper()}": int(better[metric]) for metric in ("aae", "aepe")}
        # A mean over fewer sequences than the others' would not be comparable.
        record |= {f"AEPE {method}": aepe[method].mean(skipna=False) for method in ("tvl1", "tvl1_sb")}
        records.append(record)
    return pd.DataFrame(records)


def switch_sentences(table: pd.DataFrame) -> list[str]:
    """Say for each protocol which switch moves the distance most, and the effect of those turned together."""
    sentences = []
    for protocol, group in table.groupby("protocol", sort=False):
        start, turned = group[group["switch"] == ""], group[group["switch"] != ""]
        together = turned["switch"].str.contains("+", regex=False)
        if len(start) != 1 or together.all() or group["distance"].isna().any():
            continue
        base, alone = float(start["distance"].iloc[0]), turned[~together]
        most = alone.loc[(alone["distance"] - base).abs().idxmax()]
        rest = alone.drop(index=most.name)["distance"]
        sentence = f"From {protocol} (distance {base:.3f}), {most['set to']} alone leads to {most['distance']:.3f}"
        if len(rest):
            sentence += f", each other switch alone to between {rest.min():.3f} and {rest.max():.3f}"
        for _, row in turned[together].iterrows():
            sentence += f"; {row['set to']} together lead to {row['distance']:.3f}"
        sentences.append(sentence + ".")
    return sentences


#: Method, name, marker, and its face: an open one around the other shows both where they agree.
_DOTS = (("tvl1", "TV-L1", "o", None), ("tvl1_sb", "TV-L1-SB", "s", "none"))
_LINE = 0.5  # half the height of a line of text, in rows


def switch_dots(table: pd.DataFrame, title: str) -> Figure:
    """Draw the distance to Table 2, jointly and for each method, beside the mean AEPE, for each row of a table."""
    from fracbench.figures.style import PALETTE, house_style, new_figure, plain_ticks

    places, labels, place = [], [], 0.0
    for i, (protocol, switch, setting) in enumerate(table[["protocol", "switch", "set to"]].to_numpy()):
        labels.append(setting.replace(", ", "\n") if switch else f"protocol {protocol}")
        half = _LINE * max(labels[-1].count("\n") - 1, 0)  # the space of a tall label above and below its middle
        place += half + (1.7 if i and not switch else 1.0)
        places.append(-place)
        place += half
    with house_style():
        fig = new_figure(0.36 * place + 1.6)
        fig.suptitle(title)
        left, right = fig.subplots(1, 2, sharey=True)
        left.barh(places, table["distance"], height=0.55, color="#D9D9D9", label="both methods")
        for color, (method, name, marker, face) in zip(PALETTE, _DOTS, strict=False):
            look: dict[str, Any] = {"color": color, "marker": marker, "linestyle": "none", "label": name}
            look |= {"markerfacecolor": face or color, "markersize": 5 if face is None else 8}
            left.plot(table[f"distance {method}"], places, **look)
            right.plot(table[f"AEPE {method}"], places, **look)
        if table["distance"].isna().all():
            left.text(0.5, 0.5, "nothing printed to compare with", transform=left.transAxes, ha="center")
        left.set(xlabel="distance to the printed Table 2\n(RMS of ln(ours / printed))", yticks=places)
        left.set_yticklabels(labels)
        right.set(xlabel="mean AEPE [px]", xscale="log")
        plain_ticks(right.xaxis)
        for ax in (left, right):
            ax.grid(axis="y", visible=False)
        left.set_xlim(left=0.0)
        fig.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return fig
