"""The answer in short: a picture of the paper's numbers beside ours, and the README's table of verdicts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import ensure_folder, write_text
from fracbench.errors import InputError
from fracbench.figures import style
from fracbench.figures.cache import draw
from fracbench.report.claims.claims import count_verdicts
from fracbench.report.claims.judging import (
    CONTEXT,
    SETTINGS,
    VERDICTS,
    Tables,
    UnjudgeableError,
    captioned_regions,
    near_best,
    published_table2,
    region_curve,
)
from fracbench.report.sources import Sources
from fracbench.studies import tables
from fracbench.studies.base import FLAT
from fracbench.studies.solvers.solver_study import printed_alphas

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLE = "The paper beside a recomputation: best α on its regions, and the errors of its Table 2"
#: Claims that the README shows, by id: the paper's main conclusions.
HEADLINES = (
    "table2-numbers",
    "table2-aae",
    "table2-aepe",
    "flat-close-to-0",
    "edges-between-1-and-1.5",
    "corners-between-1.5-and-2",
    "better-than-1",
    "depends-on-structure",
)
_MARKS = ("<!-- answer: written by `fracbench claims --readme README.md` -->", "<!-- end of the answer -->")
_PAPER = "paper"
#: Colour and marker by source.
_LOOKS = {
    _PAPER: ("black", "v"),
    "reference": (style.PALETTE[0], "o"),
    "published": (style.PALETTE[1], "D"),
    CONTEXT: (style.PALETTE[2], "s"),
}


def answer_table(sources: Sources) -> pd.DataFrame:
    """Return the numbers of the picture, one row a mark: ``panel, place, source, value, low, high``.

    Panel ``alpha`` has the order with the smallest AEPE on each region, at the lambda_SB of the paper's captions,
    and the range within 2 % of the best; panel ``aepe`` has the AEPE of TV-L1-SB in Table 2, in pixels.
    """
    import pandas as pd

    found = Tables(sources.load)
    records: list[tuple[Any, ...]] = []
    for region in captioned_regions():
        said = printed_alphas()[region]["aepe"]
        records.append(("alpha", region, _PAPER, said, said, said))
        for setting in ("reference", "published", CONTEXT):
            curve = region_curve(found, setting, region)
            near, best = near_best(curve, "aepe", "alpha"), curve.loc[curve["aepe"].idxmin(), "alpha"]
            records.append(("alpha", region, setting, best, near.min(), near.max()))
    printed = published_table2()
    parts = {_PAPER: printed[printed["method"] == "tvl1_sb"]}
    parts |= {name: found.points("table2", protocol=name, method="tvl1_sb") for name in ("reference", "published")}
    for name, part in parts.items():
        records += [("aepe", row.sequence, name, row.aepe, None, None) for row in part.itertuples()]
    return pd.DataFrame(records, columns=["panel", "place", "source", "value", "low", "high"])


def answer_figure(table: pd.DataFrame, title: str) -> Figure:
    """Draw `answer_table`: the best alpha of each region beside the errors of each sequence, one legend below."""
    with style.house_style():
        fig = style.new_figure(4.3)
        fig.suptitle(title)
        left, right = fig.subplots(1, 2)
        _draw_marks(left, table[table["panel"] == "alpha"])
        _draw_marks(right, table[table["panel"] == "aepe"])
        left.set(
            xlim=(-0.1, 2.1),
            xlabel=f"{style.symbol('alpha')} with the smallest AEPE at the paper's {style.symbol('lambda_sb')}\n"
            f"(bar: within {FLAT:.0%} of it)",
        )
        right.set(xlabel="AEPE of TV-L1-SB in Table 2 [px]", xscale="log")
        style.plain_ticks(right.xaxis, (1.0, 2.0, 5.0))
        handles, labels = left.get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return fig


def _draw_marks(ax: Axes, table: pd.DataFrame) -> None:
    """Draw a row for each place, and in it a mark for each source, one below the other."""
    places, names = list(table["place"].unique()), list(table["source"].unique())
    for i, name in enumerate(names):
        part = table[table["source"] == name].set_index("place").loc[places]
        rows = [row + 0.17 * (i - (len(names) - 1) / 2) for row in range(len(places))]
        colour, marker = _LOOKS[name]
        look: dict[str, Any] = {"color": colour, "zorder": 3}
        ax.hlines(rows, part["low"].astype(float), part["high"].astype(float), linewidth=2.5, alpha=0.45, **look)
        ax.plot(part["value"], rows, marker, markersize=5.5, label=name, linestyle="none", **look)
    ax.set_yticks(range(len(places)), places)
    ax.set_ylim(len(places) - 0.5, -0.5)
    ax.grid(axis="y", visible=False)
    for edge in range(1, len(places)):
        ax.axhline(edge - 0.5, color="#E3E3E3", linewidth=0.6, zorder=0)


def write_answer(sources: Sources) -> list[Path]:
    """Write the answer as Markdown and, where all points are there and not of scenes, the picture with its CSV."""
    note = sources.results / "tables" / f"answer{sources.suffix}.md"
    files = [write_text(answer_text(sources), note)]
    try:
        table = answer_table(sources)
    except UnjudgeableError:
        return files
    stem = ensure_folder(sources.results / "figures") / f"answer{sources.suffix}"
    return [*files, tables.write_table(table, stem), *draw(stem, answer_figure, table, TITLE)]


def answer_text(sources: Sources) -> str:
    """Return the answer in Markdown: the claims counted by protocol, then the main ones one by one."""
    judged = sources.judged
    counts = count_verdicts(judged)
    words = [word for word in VERDICTS if any(count[word] for count in counts.values())]
    lines = [f"| computed as | claims judged | {' | '.join(words)} |", _rule(2 + len(words))]
    for name, count in counts.items():
        numbers = " | ".join(str(number) for number in (count.total(), *(count[word] for word in words)))
        lines.append(f"| `{name}`: {SETTINGS.get(name, '')} | {numbers} |")
    shown = [item for name in HEADLINES for item in judged if item.claim.id == name]
    lines += ["", f"| among them | {' | '.join(f'`{name}`' for name in counts)} |", _rule(1 + len(counts))]
    for item in shown:
        place = item.claim.place.rpartition(", l.")[0]
        cells = " | ".join(item.words.get(name, "") for name in counts)
        lines.append(f"| “{item.claim.quote}” ({place}; `{item.claim.id}`) | {cells} |")
    return "\n".join(lines) + "\n"


def _rule(columns: int) -> str:
    return f"|{' --- |' * columns}"


def renew(readme: Path, sources: Sources) -> Path:
    """Put the answer between its markers in a Markdown file; return the file."""
    try:
        text = readme.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise InputError(f"{readme}: cannot be read") from exc
    first, last = map(re.escape, _MARKS)
    block = f"{_MARKS[0]}\n{answer_text(sources)}{_MARKS[1]}"
    renewed, found = re.subn(f"{first}.*?{last}", lambda _: block, text, count=1, flags=re.DOTALL)
    if not found:
        raise InputError(f"{readme}: has no block between {_MARKS[0]} and {_MARKS[1]}")
    return write_text(renewed, readme)
