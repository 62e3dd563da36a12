"""Table 1 of the paper: every parameter with its range, from the typed record of the parameters."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fracbench.data.files import ensure_folder, write_text
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import canonical_value
from fracbench.harness.run.store import Row
from fracbench.model.params import FlowParams, ParamInfo, public_name
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact

if TYPE_CHECKING:
    import pandas as pd


def table1(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write Table 1 from the typed record of the parameters; see `fracbench.studies.base.Renderer`."""
    table = parameter_table()
    stem = ensure_folder(results / TABLES) / experiment.name  # the same on any data and any grid
    shown = table.assign(symbol=[f"${symbol}$" if symbol else "" for symbol in table["symbol"]])
    markdown = shown.to_markdown(index=False, disable_numparse=True)
    escaped = shown.apply(lambda column: column if column.name == "symbol" else column.map(_latex))
    caption = _latex(experiment.title)
    latex = escaped.to_latex(index=False, escape=False, caption=caption, column_format="llp{6cm}lll")
    files = [
        tables.write_table(table, stem),
        tables.write_markdown(stem, f"# {experiment.title}", markdown),
        write_text(latex, stem.with_name(f"{stem.name}.tex")),
    ]
    return Artefact(files, [(experiment.title, table.drop(columns="symbol"))])


def parameter_table() -> pd.DataFrame:
    """Return a row of text for each parameter.

    ``symbol`` (LaTeX), ``parameter`` (its name on the command line), ``meaning``, ``paper`` (the range of Table 1,
    or the paper's words elsewhere), ``allowed``, ``default`` (`recommended`).
    """
    import pandas as pd

    hints, defaults = typing.get_type_hints(FlowParams), FlowParams()
    records = []
    for name, hint in hints.items():
        info, default = FlowParams.info(name), getattr(defaults, name)
        records.append(
            {
                "symbol": info.symbol,
                "parameter": public_name(name),
                "meaning": info.text,
                "paper": info.paper_range,
                "allowed": _allowed(hint, info),
                "default": _unset(info) if default is None else canonical_value(default),
            }
        )
    return pd.DataFrame(records)


def _allowed(hint: Any, info: ParamInfo) -> str:
    options = typing.get_args(hint)
    if typing.get_origin(hint) is Literal:
        return ", ".join(options)
    if hint is bool:
        return "true, false"
    whole = "whole, " if hint is int or int in options else ""
    unset = f"; or {_unset(info)}" if type(None) in options else ""
    if info.high == float("inf"):
        return f"{whole}{'>' if info.open_low else '>='} {info.low:g}{unset}"
    return f"{whole}{'(' if info.open_low else '['}{info.low:g}, {info.high:g}]{unset}"


def _unset(info: ParamInfo) -> str:
    """Return the word for a parameter left to the program: the meaning explains it, as in ``auto: ...``."""
    return "auto" if "auto:" in info.text else "none"


def _latex(text: str) -> str:
    escaped = text.replace("_", r"\_").replace("^", r"\^{}").replace("%", r"\%")
    return escaped.replace(">=", r"$\geq$").replace(">", "$>$")
