"""The report's section on the experiments beyond the paper, made from the tables and figures that they wrote."""

from __future__ import annotations

from fracbench.report.page.elements import Block, Details, Heading, Missing, Section, Text, demoted
from fracbench.report.page.exhibits import document, drawn, place
from fracbench.report.sources import Source, Sources

#: In the order in which they are told.
EXPERIMENTS = ("alpha_by_structure", "adaptive_alpha", "order_from_flow", "accurate")

_LEAD = (
    "The paper ends with the wish to “detect a priori the type of structures the image presents and adjust alpha "
    "accordingly”. Here the order of the gradient adapts from pixel to pixel: at each scale the structure tensor "
    "of the first frame sorts pixels into flat, edge, corner and texture, and each class has its own α. Then the "
    "flow itself chooses: it is the sum of two parts of different orders. Every "
    "choice by errors is scored leave-one-out, on another sequence than those it is made on; a choice by the "
    "true flow is an oracle bound. `make beyond` computes this section."
)


def beyond(sources: Sources) -> Section:
    """Return for each experiment beyond the paper the text before its first table, figures, and folded tables.

    Where they are missing, their command; nothing is planned or computed.
    """
    blocks: list[Block] = [Text(_LEAD)]
    for name in EXPERIMENTS:
        blocks += told(sources.outline(name), sources)
    blocks.append(document("docs/beyond.md", "The whole story: docs/beyond.md"))
    return Section("beyond", "Beyond the paper", "Beyond the paper", blocks)


def told(source: Source, sources: Sources) -> list[Block]:
    """Return an experiment's title, the text before its first table, its figures and its folded tables."""
    name = source.experiment.name
    heading = Heading(source.experiment.title, f"beyond-{name}")
    path = sources.find(f"tables/{name}{source.suffix}.md")
    if path is None:
        return [heading, Missing(f"the experiment {name}", source.command)]
    shown = place(path, sources.results).replace("`", "")
    lines = path.read_text(encoding="utf-8").splitlines()[1:]  # the title is the heading's
    first = next((i for i, line in enumerate(lines) if line.startswith(("|", "## "))), len(lines))
    said, rest = "\n".join(lines[:first]).strip(), "\n".join(lines[first:]).strip()
    folded: list[Block] = [Details(f"The tables: {shown}", [Text(demoted(rest, 2))])] if rest else []
    return [heading, Text(said, "answer"), *drawn(source, sources.results), *folded]
