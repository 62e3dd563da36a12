"""The report's sections besides the results: errata, gaps of the paper, conventions, provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from fracbench.data.regions import Region
from fracbench.evaluation.metrics import CONVENTIONS
from fracbench.harness.config.compose import group_options, load_config
from fracbench.harness.config.paths import asset
from fracbench.harness.run.point import canonical_value
from fracbench.harness.run.store import Row
from fracbench.model.params import FlowParams
from fracbench.report.claims.judging import PROTOCOLS
from fracbench.report.page.elements import Block, Cell, Column, Details, Section, Table, Text, code, demoted, plain
from fracbench.report.sources import Source

_PROTOCOLS = (*PROTOCOLS, "recommended")


def errata() -> Section:
    """Return docs/errata.md: misprints and gaps of the paper, and how each is read here."""
    text = asset("docs/errata.md").read_text(encoding="utf-8")
    _, _, body = text.partition("\n")  # its title is the section's
    return Section("errata", "Misprints", "Misprints and gaps of the paper", [Text(demoted(body, 1))])


# -- gaps of the paper -----------------------------------------------------------------------------

_OPEN = (
    "The paper does not give everything that a computation needs. These are our choices.\n\n"
    "- **TV-L1**, the method that the paper compares with: neither code nor parameters beyond Table 2 are given. "
    "Ours has Chambolle's dual step in place of split Bregman, and shares pyramid, warping, thresholding and "
    "stopping with the other methods: two columns of a table differ in the regulariser alone.\n"
    "- **Regions** A and B are boxes drawn on pictures. Ours are below; each figure on a region shows the spread "
    "over 25 shifted boxes.\n"
    "- **Gray** is floor(0.299 R + 0.587 G + 0.114 B), which is Middlebury's own conversion; both frames are "
    "stretched to 0..255 together.\n"
    "- **Warping** is bicubic, of the second frame and of its central-difference gradient; a sample that falls "
    "outside the frame counts as 0.\n"
    "- **Unknown pixels** of the true flow are left out of every mean.\n"
)


def open_choices() -> Section:
    """Return the gaps of the paper and our choices: parameters by protocol, regions."""
    return Section(
        "open",
        "Left open",
        "Gaps of the paper and our choices",
        [Text(_OPEN), _parameters(), _regions(), _table1()],
    )


def _parameters() -> Table:
    """Return the parameters that the paper does not fix, or that the protocols read differently."""
    configs = {name: load_config({"protocol": name}).params.as_dict() for name in _PROTOCOLS}
    rows = []
    for name in FlowParams.names():
        info = FlowParams.info(name)
        values = [canonical_value(configs[protocol][name]) for protocol in _PROTOCOLS]
        if "not" in info.paper_range.split() or len(set(values[:3])) > 1:
            cells = [Cell(value, tone="strong" if value != values[0] else "") for value in values]
            rows.append([Cell(name, info.text), Cell(info.paper_range or "nothing"), *cells])
    columns = [Column("parameter"), Column("the paper says"), *(Column(name) for name in _PROTOCOLS)]
    return Table("Parameters the paper leaves open, by protocol; bold: other than in the reference", columns, rows)


def _regions() -> Table:
    columns = [Column("region"), Column("rows", numeric=True), Column("columns", numeric=True)]
    columns += [Column(name, numeric=True) for name in ("λ", "θ", "λ_SB", "scales")]
    rows = []
    for name in group_options("region", own=False):
        config = load_config({"region": name})
        region, params = config.region, config.params
        assert isinstance(region, Region)
        values = (params.lambda_, params.theta, params.lambda_sb, params.n_scales)
        boxes = [f"{first}:{last}" for first, last in (region.rows, region.cols)]
        rows.append([Cell(name), *map(Cell, boxes), *(Cell(canonical_value(value)) for value in values)])
    return Table("Our boxes (first : one past the last) and the captions' parameters", columns, rows)


def _table1() -> Details:
    from fracbench.studies.paper.table1 import parameter_table

    shown = parameter_table().drop(columns="symbol")
    rows = [[Cell(str(value)) for value in record] for record in shown.itertuples(index=False)]
    table = Table("Parameters, with the paper's ranges and ours", [Column(name) for name in shown.columns], rows)
    return Details("Every parameter: the paper's Table 1, and those that it leaves out", [table])


# -- conventions -----------------------------------------------------------------------------------

_CONVENTIONS = (
    "- **Flow**: u1 to the right, u2 down, in pixels; frame 0 at (x, y) matches frame 1 at (x + u1, y + u2).\n"
    "- **Intensities** run from 0 to 255; λ depends on that scale (0.3 here is 76.5 for intensities 0 to 1).\n"
    "- **Regions**: a flow is computed from the region alone, as in the paper, unless a context is named; errors "
    "count inside the region only.\n"
    "- **Within 2 %** means an error at most 2 % above the smallest one.\n"
    "- **Agreement**: a number is within 5 % of the paper's if |ln(ours / paper)| is at most ln 1.05.\n"
    "- **α = 0**: the operator is the identity. Under `reflect` constants cost nothing for any α > 0, so that "
    "curves may jump between 0 and the next α.\n"
)


def conventions() -> Section:
    """Return units, averaging, and definitions of the page's words."""
    return Section("conventions", "Conventions", "Conventions", [Text(CONVENTIONS), Text(_CONVENTIONS)])


# -- provenance ------------------------------------------------------------------------------------


def provenance(found: Sequence[Source]) -> Section:
    """Return where the numbers come from, by stored rows alone: experiments, machines, versions, commits."""
    rows = all_rows(found)
    blocks: list[Block] = [_experiments(found)]
    if rows:
        blocks.insert(0, Text(_origin(rows)))
    return Section("provenance", "Provenance", "Where the numbers come from", blocks)


def all_rows(found: Iterable[Source]) -> list[Row]:
    """Return the distinct rows of some experiments, by key."""
    distinct = {key: row for source in found for key, row in source.rows.items()}
    return [distinct[key] for key in sorted(distinct)]


def newest(rows: Sequence[Row]) -> str:
    """Return the day of the newest row, or ``""``."""
    return max((row.created for row in rows), default="")[:10]


def _experiments(found: Sequence[Source]) -> Table:
    columns = [Column("experiment"), *(Column(name, numeric=True) for name in ("points", "stored", "not done"))]
    columns += [Column("seconds", numeric=True), Column("newest row", numeric=True), Column("command")]
    cells = []
    for source in found:
        rows = list(source.rows.values())
        seconds = f"{sum(row.seconds or 0.0 for row in rows):.0f}"
        values = (source.n_points, len(rows), len(source.unfinished), seconds, newest(rows), source.command)
        cells.append([Cell(source.experiment.name, source.experiment.title), *(Cell(str(v)) for v in values)])
    return Table("Experiments on this page; points that several share are computed once", columns, cells)


def _origin(rows: Sequence[Row]) -> str:
    """Return one paragraph a kind of origin, the most frequent value first."""
    origins = [row.provenance for row in rows]
    versions = [
        plain(", ".join(f"{name} {version}" for name, version in sorted(origin.get("versions", {}).items())))
        for origin in origins
    ]
    lines = {
        "Points": [f"{len(rows)} stored, {sum(row.seconds or 0.0 for row in rows):.0f} s of computing"],
        "Solver version": _ranked(str(row.solver_version) for row in rows),
        "Processor": _ranked(plain(str(origin.get("cpu") or "")) for origin in origins),
        "Python": _ranked(plain(str(origin.get("python") or "")) for origin in origins),
        "Versions": _ranked(versions),
        "Commit": _ranked(_commit(origin.get("commit"), origin.get("dirty")) for origin in origins),
        "Rows written": [f"{min(row.created for row in rows)[:10]} to {newest(rows)}"],
    }
    return "\n".join(f"- **{name}**: {'; '.join(values)}" for name, values in lines.items() if values)


def _commit(commit: str | None, dirty: bool | None) -> str | None:
    return None if commit is None else f"{code(commit[:12])}{' with local changes' if dirty else ''}"


def _ranked(values: Iterable[str | None]) -> list[str]:
    counts = Counter(str(value) for value in values if value)
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return [value if len(ranked) == 1 else f"{value} ({count} points)" for value, count in ranked]
