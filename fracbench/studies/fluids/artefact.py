"""The study of fluids: its tables, sentences and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, TABLES, Artefact, file_stem
from fracbench.studies.fluids.sentences import sentences
from fracbench.studies.fluids.tables import (
    MEAN,
    flow_table,
    gradient_table,
    order_table,
    setting_table,
    with_names,
)

if TYPE_CHECKING:
    import pandas as pd

_LEGEND = (
    "AEPE in pixels, with Student's 95 % interval over the seeds of particles and noise, where there are "
    "several. `grid`: on every 8th pixel, where OpenPIV has its vectors; all others: on all pixels. Vorticity "
    "and divergence: root mean squares, a frame; `error` is that of the difference from the true flow, by the "
    "same central differences (of neighbours on the grid there), `own` that of the estimate itself. The "
    "velocity of every rendered flow is free of divergence, its displacement over a frame nearly so (`true`). "
    "A border of 16 pixels is left out. OpenPIV measures the displacement of the particles that are at a point "
    "in the first frame, as all others do; `symmetric` is its default, about the time between the frames. "
    "alpha = 1 is protocol fluid with that order and a weight of the data of 0.06. The mean over the flows of a "
    "dataset is taken seed by seed."
)
_WORDS = {
    "aepe": "AEPE", "aepe_grid": "AEPE grid", "vorticity": "vorticity error",
    "vorticity_grid": "vorticity error grid", "divergence": "divergence error",
    "own_divergence": "own divergence", "true_divergence": "true divergence",
}  # fmt: skip


def fluids(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the errors of flows of fluids; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures import style
    from fracbench.studies.fluids.figures import flow_panels, order_panels, setting_panels

    runs = with_names(tidy(plan, rows))
    flows, orders, settings = flow_table(runs), order_table(runs), setting_table(runs)
    gradients = gradient_table(plan, rows)
    lines = sentences(flows, orders, settings)
    means = _readable(flows[flows["flow"] == MEAN].drop(columns="flow")) if len(flows) else flows
    stem = file_stem(experiment.name, plan, results / TABLES)
    text = [f"# {experiment.title}", "\n".join(f"- {line}" for line in lines), *plan.notices, _LEGEND]
    text += ["## Means over flows", tables.to_markdown(means)] if len(means) else []
    text += ["## By flow", tables.to_markdown(_readable(flows[flows["flow"] != MEAN]))] if len(flows) else []
    text += ["## By order", tables.to_markdown(_by_order(orders))] if len(orders) else []
    text += ["## By setting of the images", tables.to_markdown(_across(settings))] if len(settings) else []
    text += ["## By local gradient", tables.to_markdown(_by_gradient(gradients))] if len(gradients) else []
    text += tables.footnote(rows, sorted(set(runs["protocol"])))
    files = [tables.write_markdown(stem, *text)]
    named = {"": flows, "_orders": orders, "_settings": settings, "_gradients": gradients}
    for ending, table in named.items():
        if len(table):
            path = file_stem(f"{experiment.name}{ending}", plan, results / TABLES)
            files.append(tables.write_table(table, path))
    drawings = {}
    if len(orders):
        drawings[""] = order_panels(orders, flows, "AEPE against the order")
    if len(settings):
        drawings["_settings"] = setting_panels(settings, gradients, "AEPE against settings of the images")
    if len(flows):
        drawings["_flows"] = flow_panels(flows, "Errors by flow")
    for ending, figure in drawings.items():
        files += style.save_figure(figure, file_stem(f"{experiment.name}{ending}", plan, results / FIGURES))
    return Artefact(files, [("Means over flows", means)] if len(means) else [], lines)


def _readable(flows: pd.DataFrame) -> pd.DataFrame:
    """Return errors by flow for reading: the interval beside its mean, without what the CSV alone needs."""
    keys = [key for key in ("dataset", "flow", "method", "n") if key in flows]
    shown = flows[[*keys, *_WORDS]].rename(columns=_WORDS)
    shown["AEPE"] = [
        f"{mean:.4f}" + (f" ({low:.4f} to {high:.4f})" if low == low else "")
        for mean, low, high in zip(flows["aepe"], flows["aepe_low"], flows["aepe_high"], strict=True)
    ]
    return shown


def _by_order(orders: pd.DataFrame) -> pd.DataFrame:
    """Return AEPE by flow, a column for each order, with the protocol's weight and, after it, with the best."""
    import pandas as pd

    named = {"protocol": "aepe", "best": "best_aepe"}
    wide = [
        orders.pivot(index=["dataset", "flow"], columns="alpha", values=column).reset_index().assign(weight=weight)
        for weight, column in named.items()
    ]
    table = pd.concat(wide, ignore_index=True)
    order = {key: i for i, key in enumerate(dict.fromkeys(zip(orders["dataset"], orders["flow"], strict=True)))}
    places = [order[key] for key in zip(table["dataset"], table["flow"], strict=True)]
    table = table.assign(place=places).sort_values("place", kind="stable").drop(columns="place")
    alphas = [column for column in table if isinstance(column, float)]
    table = table[["dataset", "flow", "weight", *alphas]]
    return table.rename(columns={alpha: f"α {alpha:g}" for alpha in alphas})


def _across(settings: pd.DataFrame) -> pd.DataFrame:
    """Return AEPE by setting and value, a column for each method."""
    names = list(dict.fromkeys(settings["method"]))
    wide = settings.pivot(index=["setting", "value"], columns="method", values="aepe").reset_index()
    order = list(dict.fromkeys(settings["setting"]))
    wide = wide.sort_values("setting", key=lambda column: column.map(order.index), kind="stable")
    return wide[["setting", "value", *names]].assign(value=[f"{value:g}" for value in wide["value"]])


def _by_gradient(gradients: pd.DataFrame) -> pd.DataFrame:
    names = list(dict.fromkeys(gradients["method"]))
    wide = gradients.pivot(index="gradient", columns="method", values="aepe").reset_index()
    return wide[["gradient", *names]].assign(gradient=[f"from {value:g}" for value in wide["gradient"]])
