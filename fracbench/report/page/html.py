"""The report: one HTML file with all results, which needs neither other files nor a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fracbench.data.files import ensure_folder, write_text
from fracbench.harness.config.experiment import list_experiments
from fracbench.harness.run.store import RUNS
from fracbench.report.claims import claims
from fracbench.report.page import background, exhibits
from fracbench.report.page import sections as pages
from fracbench.report.page.beyond import beyond
from fracbench.report.page.elements import Section, render_page
from fracbench.report.page.fluids import fluids
from fracbench.report.sources import Sources

_TITLE = "Fractional optical flow: does the paper hold?"

_LEAD = (
    "The paper is S. Gh. Bardeji, I. N. Figueiredo, E. Sousa, *Optical flow with fractional order regularization: "
    "variational model and solution method* ([arXiv:1512.01398](https://arxiv.org/abs/1512.01398)). fracbench "
    "computed its tables and figures anew, with a solver written and tested from its equations, and this page "
    "gives a verdict on every claim of the paper that can be tested."
)

_DATA = {"synthetic": "synthetic scenes in place of Middlebury", "middlebury": "Middlebury, 8 sequences"}


def write_report(sources: Sources) -> Path:
    """Write the report, ``runs/report.html``, from the stored points; missing ones are named, with their command.

    The page shows Middlebury's frames, so it goes below ``runs``, which is never committed. Its name tells scenes
    from Middlebury, and small forms, which show two sequences in pictures, from whole ones.
    """
    return write_text(page(sources), ensure_folder(sources.results / RUNS) / f"report{sources.suffix}.html")


def page(sources: Sources) -> str:
    """Return the report as HTML; equal stores and figures give equal text."""
    names = [name for name in experiments() if sources.only is None or name in sources.only]
    found = [sources.get(name) for name in names]
    rows = background.all_rows(found)
    missing = sum(source.n_missing for source in found)
    facts = [
        ("Data", _DATA.get(sources.dataset, f"dataset {sources.dataset} in place of Middlebury")),
        ("Points stored", f"{len(rows)}{f', {missing} missing' if missing else ''}"),
        ("Newest result", background.newest(rows) or "none yet"),
    ]
    if sources.small:
        facts.append(("Form", "small: thinned grids, for a trial; the verdicts mean nothing"))
    if sources.only is None:
        return render_page(_TITLE, _LEAD, facts, sections(sources, names))
    lead = f"This page shows some of the paper's experiments ({', '.join(names)}) and judges none of its claims."
    return render_page("Fractional optical flow: chosen experiments", lead, facts, chosen_sections(sources, names))


def experiments() -> list[str]:
    """Return the experiments of the page: tables, figures, studies, and those that only the claims read."""
    known = list_experiments()
    numbered = [name for kind in ("table", "fig") for name in known if name.removeprefix(kind).isdigit()]
    return [*dict.fromkeys([*numbered, "protocol_study", "solver_study", *claims.EXPERIMENTS])]


def sections(sources: Sources, names: Sequence[str]) -> list[Section]:
    """Return the parts of the page in their order: the answer first."""
    return [
        pages.verdicts(sources.judged, exhibits.answer_picture(sources)),
        pages.protocol_study(sources),
        pages.table2(sources),
        exhibits.figures(sources, names),
        exhibits.pictures(sources),
        pages.solver_study(sources),
        beyond(sources),
        fluids(sources),
        background.errata(),
        background.open_choices(),
        background.conventions(),
        background.provenance([sources.get(name) for name in names]),
    ]


def chosen_sections(sources: Sources, names: Sequence[str]) -> list[Section]:
    """Return the parts of the page about some experiments alone."""
    own = {
        "protocol_study": [pages.protocol_study],
        "table2": [pages.table2, exhibits.pictures],
        "solver_study": [pages.solver_study],
        "fluids": [fluids],
    }
    told = [part(sources) for name, parts in own.items() if name in names for part in parts]
    figures = [exhibits.figures(sources, names)] if set(names) - set(own) else []
    last = [background.conventions(), background.provenance([sources.get(name) for name in names])]
    return [*told, *figures, *last]
