"""The report's section on fluids, made from the tables and figures that the experiment wrote."""

from __future__ import annotations

from dataclasses import replace

from fracbench.report.page.beyond import told
from fracbench.report.page.elements import Section, Text
from fracbench.report.page.exhibits import document
from fracbench.report.sources import Sources

_LEAD = (
    "Fluids move smoothly, and there the order matters most. Our flows, those of other programs and the "
    "cross-correlation of OpenPIV are compared on rendered particle images of known displacement and on the "
    "public pairs of Cai et al. `make fluids` computes this section."
)


def fluids(sources: Sources) -> Section:
    """Return the experiment on fluids as its files tell it; nothing is planned or computed."""
    source = sources.outline("fluids")
    # It has data of its own: no data set of the paper marks the names of its files.
    source = replace(source, plan=replace(source.plan, stand_in=False, foreign=False))
    blocks = [Text(_LEAD), *told(source, sources), document("docs/fluids.md", "The whole story: docs/fluids.md")]
    return Section("fluids", "Fluids", "Fluids", blocks)
