"""The paper's claims under further protocols, from the points of one experiment (artefact ``protocol_claims``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fracbench.report.claims.claims import Judged, evaluate

if TYPE_CHECKING:
    import pandas as pd

#: The experiment's part for each experiment that the rules read, and what these call the part there.
_PARTS = {
    "table2": ("table2", "main"),
    "fig2": ("fig2", "main"),
    "fig3": ("fig3", "main"),
    "fig4": ("fig4", "main"),
    "fig6": ("regions", "protocols"),
    "fig7": ("regions", "protocols"),
    "regions_lambda_sb": ("regions_lambda_sb", "main"),
}


def judge_further(table: pd.DataFrame) -> list[Judged]:
    """Judge the project's claims under each protocol of a tidy table, whose parts are those of `_PARTS`."""

    def load(experiment: str) -> pd.DataFrame | None:
        part, name = _PARTS[experiment]
        rows = table[table["part"] == part]
        return rows.assign(part=name) if len(rows) else None

    return evaluate(load, settings=tuple(dict.fromkeys(table["protocol"])))
