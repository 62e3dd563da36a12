"""The report's sections on the results: verdicts, Table 2, and the two studies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fracbench.harness.run.tidy import METRICS
from fracbench.methods.registry import get_method
from fracbench.report.claims.claims import Judged, count_verdicts
from fracbench.report.claims.judging import FAILS, HOLDS, IN_PART, SETTINGS, UNKNOWN, published_table2
from fracbench.report.page.elements import Block, Cell, Column, Heading, Section, Table, Tallies, Tally, Text
from fracbench.report.page.exhibits import document, figures_of, state
from fracbench.report.page.gallery import sequence_name
from fracbench.report.sources import Sources
from fracbench.studies.paper.table2 import versus_published
from fracbench.studies.protocols import switch_sentences, switch_table
from fracbench.studies.solvers.solver_study import SOLVERS, printed_alphas, solver_sentences, solver_summary

if TYPE_CHECKING:
    import pandas as pd

#: Verdicts with the class that colours them, best first.
VERDICTS = {HOLDS: "holds", IN_PART: "part", FAILS: "fails", UNKNOWN: "unknown"}

_UNITS = {"aae": "AAE, rad", "aepe": "AEPE, px", "sdae": "SDAE, rad"}


def verdicts(judged: Sequence[Judged], pictures: Sequence[Block] = ()) -> Section:
    """Return the verdicts: their counts and the picture that sums them up first, then every claim."""
    counts = count_verdicts(judged)
    cards = [
        Tally(name, SETTINGS.get(name, ""), [(word, tone, count[word]) for word, tone in VERDICTS.items()])
        for name, count in counts.items()
    ]
    rows = [
        [_claim_cell(i, item), *(_verdict_cell(item, name) for name in counts)] for i, item in enumerate(judged)
    ]
    table = Table(
        f"{len(judged)} claims of the paper and their verdicts by the stored results",
        [Column("Claim"), *(Column(name) for name in counts)],
        rows,
        cards=True,
        filters=[word for word in VERDICTS if any(count[word] for count in counts.values())],
    )
    lead = (
        f"A computation can judge {len(judged)} sentences of the paper, each under up to {len(counts)} ways to "
        "compute. Every verdict follows from the stored results by the test below the claim; none is typed."
    )
    blocks = [Text(lead), Tallies(cards), *pictures, table]
    return Section("verdicts", "Claims", "Which claims hold", blocks)


def _claim_cell(number: int, item: Judged) -> Cell:
    claim = item.claim
    return Cell(f"“{claim.quote}”", f"{claim.place}\nTest: {claim.test}", sort=str(number))


def _verdict_cell(item: Judged, protocol: str) -> Cell:
    for verdict in item.verdicts:
        if verdict.protocol == protocol:
            word, order = verdict.verdict, list(VERDICTS).index(verdict.verdict)
            return Cell(word, verdict.evidence, VERDICTS[word], badge=True, sort=str(order))
    return Cell("")


# -- Table 2 -------------------------------------------------------------------------------------


def table2(sources: Sources) -> Section:
    """Return Table 2 under each protocol, the paper's number beside ours, and how well they agree."""
    source = sources.get("table2")
    blocks = state(source)
    if source.rows:
        both = versus_published(source.table, published_table2())
        names = list(both["protocol"].unique())
        parts = source.table.assign(part=source.table["protocol"])
        blocks.append(_overview(parts, dict.fromkeys(names, ()), "protocol"))
        blocks.append(Text(_TINTS))
        for name in names:
            blocks.append(Heading(f"Protocol {name}", f"table2-{name}"))
            said = SETTINGS.get(name, name)
            blocks.append(Text(f"{said[:1].upper()}{said[1:]}."))
            blocks.append(_wide(both[both["protocol"] == name], name))
    return Section("table2", "Table 2", "Table 2 beside the paper", blocks)


_TINTS = (
    "Ratios ours / paper are tinted: *green* within 5 %, *yellow* within 10 %, *red* further away. Bold: the "
    "smaller of the two methods' errors, by our numbers."
)


def _overview(table: pd.DataFrame, grids: Mapping[str, Sequence[str]], word: str) -> Table:
    """Return how far each part of a table is from the paper, and how often TV-L1-SB is better, a row a part."""
    agreement, better, means = "numbers met", "TV-L1-SB better", "mean AEPE, px"
    columns = [
        Column(word),
        *(Column(name, "distance", True) for name in ("all", "TV-L1", "TV-L1-SB")),
        *(Column(name, agreement, True) for name in ("to 5 %", "to 10 %")),
        *(Column(name, better, True) for name in ("AAE", "AEPE")),
        *(Column(name, means, True) for name in ("TV-L1", "TV-L1-SB")),
    ]
    rows = []
    for found in switch_table(table, published_table2(), grids).to_dict("records"):
        whole = math.isfinite(found["distance"])
        counts = [str(found[f"within {percent} %"]) if whole else "" for percent in (5, 10)]
        distances = [_number(found[f"distance{method}"], 3) for method in ("", " tvl1", " tvl1_sb")]
        aepe = [_number(found[f"AEPE {method}"], 4) for method in ("tvl1", "tvl1_sb")]
        counts += [str(found[f"SB better, {metric}"]) if all(aepe) else "" for metric in ("AAE", "AEPE")]
        name = ", ".join(part for part in (found["protocol"], found["set to"]) if part)
        rows.append([Cell(name), *map(Cell, (*distances, *counts, *aepe))])
    n, sequences = len(METRICS) * table.groupby("part").size().max(), table["sequence"].nunique()
    caption = (
        f"Distance: root mean square of ln(ours / paper); 0 is equal, 0.1 about 10 %. Counts are of {n} numbers "
        f"and of {sequences} sequences; in the paper TV-L1-SB is better on all."
    )
    return Table(caption, columns, rows)


def _wide(part: pd.DataFrame, protocol: str) -> Table:
    """Lay one protocol's comparison out as the paper's table."""
    columns = [Column("sequence"), Column("method")]
    words = ("paper", "ours", "ratio") if part["published"].notna().any() else ("ours",)
    columns += [Column(word, unit, True) for unit in _UNITS.values() for word in words]
    best = part.groupby(["sequence", "metric"])["ours"].min()
    rows = []
    for (sequence, method), group in part.groupby(["sequence", "method"], sort=False):
        row = [Cell(sequence_name(str(sequence))), Cell(get_method(str(method)).label)]
        by_metric = group.set_index("metric")
        for metric in _UNITS:
            found = by_metric.loc[metric]
            strong = "strong" if found["ours"] == best[sequence, metric] else ""
            cells = {
                "paper": Cell(_number(found["published"], 4)),
                "ours": Cell(_number(found["ours"], 4), tone=strong),
                "ratio": Cell(_number(found["ratio"], 2), tone=_tint(found["ratio"])),
            }
            row += [cells[word] for word in words]
        rows.append(row)
    return Table(f"Table 2, protocol {protocol}", columns, rows)


def _tint(ratio: float) -> str:
    if not math.isfinite(ratio) or ratio <= 0:
        return ""
    off = abs(math.log(ratio))
    return "close" if off <= math.log(1.05) else "near" if off <= math.log(1.10) else "far"


def _number(value: Any, digits: int) -> str:
    return f"{value:.{digits}f}" if value is not None and math.isfinite(value) else ""


# -- why Table 2 is worse --------------------------------------------------------------------------


def protocol_study(sources: Sources) -> Section:
    """Return the effect on Table 2 of each switch between the reference and the published protocol."""
    source = sources.get("protocol_study")
    blocks = state(source)
    if source.rows:
        found = switch_table(source.table, published_table2(), source.experiment.grids)
        blocks += [Text(sentence, "answer") for sentence in switch_sentences(found)]
        blocks.append(_overview(source.table, source.experiment.grids, "switch changed"))
        blocks += figures_of(source, sources.results)
    blocks.append(document("docs/protocol.md", "The whole story: docs/protocol.md"))
    return Section("why", "Why ten times worse", "Why Table 2 is ten times worse than a correct run", blocks)


def solver_study(sources: Sources) -> Section:
    """Return the comparison of the printed sweep, Gauss-Seidel and the exact u-step."""
    source = sources.get("solver_study")
    blocks = state(source)
    if source.rows:
        pairs = source.table.drop_duplicates("region").set_index("region")[["theta", "lambda_sb"]]
        summary = solver_summary(source.table, pairs, printed_alphas())
        blocks += [Text(sentence, "answer") for sentence in solver_sentences(source.table, summary)]
        blocks.append(_solvers(summary))
        blocks += figures_of(source, sources.results)
    return Section("solvers", "Solvers", "Is the best α where the printed solver stops converging?", blocks)


def _solvers(summary: pd.DataFrame) -> Table:
    """Lay the summary of the solver study out: the best alpha of the paper and of each solver."""
    columns = [Column("region"), *(Column(name, numeric=True) for name in ("θ", "λ_SB", "limit of α"))]
    columns += [
        Column(name, f"best α by {metric.upper()}", True)
        for metric in ("aae", "aepe")
        for name in ("paper", *SOLVERS.values())
    ]
    keys = ["theta", "lambda_sb", "limit"]
    keys += [f"{metric} {name}" for metric in ("aae", "aepe") for name in ("paper", *SOLVERS)]
    rows = [
        [
            Cell(str(found["region"])),
            *(Cell("" if math.isnan(found[key]) else f"{found[key]:.3g}") for key in keys),
        ]
        for found in summary.to_dict("records")
    ]
    caption = "Limit: the order above which the printed fixed-point sweep (Jacobi) diverges on a large image"
    return Table(caption, columns, rows)
