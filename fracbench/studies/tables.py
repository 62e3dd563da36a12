"""Tables as files: CSV with all digits, Markdown and LaTeX rounded, and the footnote of their origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fracbench.data.files import atomic_path, write_text
from fracbench.evaluation.metrics import CONVENTIONS
from fracbench.harness.run.store import Row
from fracbench.model import SOLVER_VERSION

if TYPE_CHECKING:
    import pandas as pd


def footnote(rows: Mapping[str, Row], protocols: Sequence[str]) -> list[str]:
    """Return the footnote of a table as paragraphs: conventions, protocols, versions, commit."""
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
    """Write a table as CSV, with all digits, to a path given without suffix."""
    path = stem.with_name(f"{stem.name}.csv")
    with atomic_path(path) as temporary:  # in parts: the text of a million rows would take 0.5 GiB
        table.to_csv(temporary, index=False, lineterminator="\n")
    return path


def write_markdown(stem: Path, *paragraphs: str) -> Path:
    """Write paragraphs, with a blank line between two, as the Markdown file of an artefact."""
    return write_text("\n\n".join(paragraphs) + "\n", stem.with_name(f"{stem.name}.md"))


def to_markdown(table: pd.DataFrame) -> str:
    """Return a table as Markdown, numbers rounded for reading."""
    return str(rounded(table).to_markdown(index=False, disable_numparse=True, stralign="right"))


def to_latex(table: pd.DataFrame, caption: str) -> str:
    """Return a table as LaTeX (booktabs), numbers rounded for reading."""
    shown = rounded(table)
    columns = "ll" + "r" * (shown.shape[1] - 2)
    caption = caption.replace("_", r"\_")
    return str(shown.to_latex(index=False, escape=True, caption=caption, column_format=columns))


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Return a copy with numbers as text: four digits after the point, ratios two."""
    shown = table.copy()
    for column in shown.columns:
        if shown[column].dtype.kind == "f":
            digits = 2 if str(column).endswith("ratio") else 4
            shown[column] = [("" if np.isnan(value) else f"{value:.{digits}f}") for value in shown[column]]
    return shown
