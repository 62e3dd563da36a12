"""Figures 1 to 5 of the paper: the frames, the boxes of the regions, and the families of error curves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.datasets.registry import load_sequence
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.compose import SequenceConfig, load_config
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.model.params import FlowParams
from fracbench.studies import tables
from fracbench.studies.base import FIGURES, PRIVATE, Artefact, best_values, file_stem
from fracbench.studies.options import required_option

if TYPE_CHECKING:
    from numpy.typing import NDArray


def frames(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw one frame of each sequence in ``options.sequences``, or of the scenes that stand in for them."""
    from fracbench.figures.cache import draw
    from fracbench.figures.pictures import frame_panel

    names = required_option(experiment, "sequences")
    items = [_frame(load_config({"sequence": name}).sequence, plan) for name in names]
    stem = file_stem(experiment.name, plan, results / PRIVATE)
    return Artefact(draw(stem, frame_panel, items, columns=4, title=experiment.title))


def region_boxes(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw the regions in ``options.regions`` on the frames of their sequences, and list their bounds."""
    import pandas as pd

    from fracbench.figures.cache import draw
    from fracbench.figures.pictures import frame_panel

    pictures: dict[str, tuple[str, NDArray[Any]]] = {}
    boxes: dict[str, dict[str, tuple[int, int, int, int]]] = {}
    records = []
    for name in required_option(experiment, "regions"):
        config = load_config({"region": name})
        region, key = config.region, config.sequence.key
        if region is None:
            raise InputError(f"experiment {experiment.name}: {name!r} is no region")
        pictures.setdefault(key, _frame(config.sequence, plan))
        if plan.dataset == "middlebury":
            box = (*region.rows, *region.cols)
        else:  # the scenes are small: they stand in for regions as a whole
            height, width = pictures[key][1].shape[:2]
            box = (0, height, 0, width)
        boxes.setdefault(key, {})[name.rpartition("_")[2]] = box
        bounds = dict(zip(("first_row", "stop_row", "first_column", "stop_column"), box, strict=True))
        records.append({"region": name, "picture": pictures[key][0], **bounds})
    stem = file_stem(experiment.name, plan, results / PRIVATE)
    table = pd.DataFrame(records)
    files = draw(stem, frame_panel, [*pictures.values()], boxes=[*boxes.values()], title=experiment.title)
    files.append(tables.write_table(table, file_stem(experiment.name, plan, results / FIGURES)))
    return Artefact(files, [(experiment.title, table)])


def _frame(sequence: SequenceConfig, plan: Plan) -> tuple[str, NDArray[Any]]:
    """Return the title and the first frame of a sequence, or of its stand-in."""
    name, dataset = sequence.name, sequence.dataset
    if dataset != plan.dataset == "synthetic":
        name, dataset = sequence.stand_in or name, "synthetic"
    loaded = load_sequence(name, dataset, plan.folder)
    title = f"{sequence.name}\n(scene {name})" if name != sequence.name else name
    return title, loaded.frame0 if loaded.frame0_color is None else loaded.frame0_color


def family(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Draw errors against ``options.x``, one line for each ``options.family`` and method, a figure a protocol.

    The other options, ``styles``, ``shade``, ``logx`` and ``logy``, are those of
    `fracbench.figures.curves.line_family`.
    """
    from fracbench.figures.cache import draw
    from fracbench.figures.curves import line_family

    options = experiment.options
    x, hue = required_option(experiment, "x"), required_option(experiment, "family")
    table = tidy(plan, rows)
    swept = [name for name in FlowParams.names() if name in table.columns]
    for name in (x, hue):
        if name not in swept:
            raise unknown_name("parameter", str(name), swept, f"experiment {experiment.name}, options")
    table = table[["protocol", "sequence", "method", hue, x, "aae", "aepe", "status"]]
    looks = {name: options[name] for name in ("styles", "shade", "logx", "logy") if name in options}
    folder = results / FIGURES
    artefact = Artefact()
    for protocol, part in table.groupby("protocol", sort=False):
        place = f"{', '.join(part['sequence'].unique())}, " if plan.stand_in or plan.foreign else ""
        title = f"{experiment.title}\n{place}protocol {protocol}"
        stem = file_stem(f"{experiment.name}_{protocol}", plan, folder)
        artefact.files += draw(stem, line_family, part, x=x, family=hue, title=title, **looks)
    artefact.files.append(tables.write_table(table, file_stem(experiment.name, plan, folder)))
    best = best_values(table[table["status"] == "done"], ["protocol", "method"], [hue, x])
    artefact.views.append((f"Where the errors are smallest: {hue}, {x}", best))
    return artefact
