"""The confidence study: does the forward-backward distance of a flow find the pixels with the largest errors?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan, make_plan
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.studies import tables
from fracbench.studies.base import TABLES, Artefact, file_stem
from fracbench.studies.options import all_options

if TYPE_CHECKING:
    import pandas as pd

_LEGEND = (
    "AEPE in pixels. `left`: the part of it that is left where the given share of pixels, those with the largest "
    "forward-backward distance, is dropped; `best`: where those with the largest errors are. AUSE: the area "
    "between the two curves. `agree`: share of pixels where the flows forward and back agree, %; `AEPE agree` and "
    "`AEPE rest`: of these pixels and of the others."
)


def confidence(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the table of errors that are left; see `fracbench.studies.base.Renderer`."""
    table = sparsification_table(plan, rows)
    means = table.drop(columns="sequence").groupby("protocol", sort=False).mean().reset_index()
    stem = file_stem(experiment.name, plan, results / TABLES)
    text = [f"# {experiment.title}", _LEGEND, tables.to_markdown(means), tables.to_markdown(table)]
    files = [tables.write_table(table, stem), tables.write_markdown(stem, *text)]
    return Artefact(files, [(experiment.title, tables.rounded(means))], [_LEGEND])


def confidence_points(experiment: Experiment, plan: Plan) -> list[PlannedPoint]:
    """Return a point for each protocol and sequence: the check of its flow."""
    options = all_options(experiment)
    tokens = ["sequence=all", f"protocol={','.join(options['protocols'])}", f"dataset={plan.dataset}"]
    if plan.folder is not None:
        tokens.append(f"paths.data='{plan.folder}'")
    dropped = (("dropped", tuple(options["dropped"])),)
    return [
        replace(planned, point=replace(planned.point, score="confidence", options=dropped))
        for planned in make_plan(tokens).points
    ]


def errors_left(point: Point, folder: Path | None) -> dict[str, Any]:
    """Compute both flows of a pair, and the errors that are left as the least certain pixels are dropped.

    The result holds ``aepe`` [px], ``left`` and ``best``, the shares of it that are left by the forward-backward
    distance and by the error itself, ``ause``, ``agree``, the share of pixels where the flows agree, and
    ``aepe_agree`` and ``aepe_rest``.
    """
    import numpy as np

    from fracbench.evaluation.metrics import endpoint_error
    from fracbench.evaluation.sparsification import ause, remaining_error
    from fracbench.harness.run.compute_point import point_arrays
    from fracbench.methods.registry import get_method
    from fracbench.model.confidence import check_backward

    frame0, frame1, truth, inner = point_arrays(point, folder)
    estimate, dropped = get_method(point.method).compute, dict(point.options)["dropped"]
    flow, back = (estimate(*pair, point.params).flow for pair in ((frame0, frame1), (frame1, frame0)))
    check = check_backward(flow, back)
    errors = endpoint_error(flow, truth)[inner]
    distance, agrees = check.distance[inner], check.agrees[inner]
    known = ~np.isnan(errors)
    return {
        "aepe": float(errors[known].mean()),
        "left": remaining_error(errors, distance, dropped).tolist(),
        "best": remaining_error(errors, errors, dropped).tolist(),
        "ause": ause(errors, distance),
        "agree": float(agrees[known].mean()),
        "aepe_agree": float(errors[known & agrees].mean()),
        "aepe_rest": float(errors[known & ~agrees].mean()),
    }


def sparsification_table(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return a row for each protocol and sequence whose point is done; the columns are those of the legend."""
    import pandas as pd

    records = []
    for planned in plan.points:
        row = rows.get(planned.point.key)
        if planned.point.score != "confidence" or row is None or row.status != "done":
            continue
        found, options = row.result, dict(planned.point.options)
        shares = [f"{100 * share:g} %" for share in options["dropped"]]
        records.append(
            {
                "protocol": planned.labels["protocol"],
                "sequence": planned.labels["sequence"],
                "AEPE": found["aepe"],
                **{f"left {share}": left for share, left in zip(shares, found["left"], strict=True)},
                **{f"best {share}": best for share, best in zip(shares, found["best"], strict=True)},
                "AUSE": found["ause"],
                "agree": 100.0 * found["agree"],
                "AEPE agree": found["aepe_agree"],
                "AEPE rest": found["aepe_rest"],
            }
        )
    return pd.DataFrame(records)
