"""Errors of the flow in two parts relative to alpha = 1, beside the best single order and an oracle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.datasets.synthetic.mixed_structure import MIXED_STRUCTURE
from fracbench.data.datasets.synthetic.single_structure import SINGLE_STRUCTURE
from fracbench.errors import InputError
from fracbench.evaluation.resampling import held_out, leave_one_out, mean_interval

if TYPE_CHECKING:
    import pandas as pd

#: Endings of the parts of the experiment: `scenes/single` holds single orders, `scenes/parts` flows in two parts,
#: and likewise with the name of a protocol in the place of `scenes`.
SCENES, SINGLE, PARTS = "scenes", "/single", "/parts"
#: The rows of the geometric means over the scenes of one structure, and over those that mix two.
ALL, MIXED = "all of one structure", "all mixed"
METRICS = ("aepe", "aae")
#: The estimates of the scenes by their columns.
ESTIMATES = {
    "one": "the best single order for all scenes of one structure",
    "own": "the best single order for the scene",
    "oracle": "the best single order for each seed, by the truth",
    "parts": "flow in two parts",
}

Errors = NDArray[np.float64]


def setting_names(runs: pd.DataFrame) -> list[str]:
    """Return the name of each run's setting: its order, or its orders and the weight of the second part."""
    orders = runs["alpha"]
    if "alpha_flat" in runs:  # of a method with an order for each class; here they are equal
        orders = orders.fillna(runs["alpha_flat"])
    names = []
    for part, order, row in zip(runs["part"], orders, runs.to_dict("records"), strict=True):
        both = f"({order:g}, {row['alpha_smooth']:g}) {row['smooth_weight']:g}" if part.endswith(PARTS) else ""
        names.append(both or f"{order:g}")
    return names


def scene_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of the scenes, a row for each scene, noise and metric.

    Columns: ``scene, noise, metric, n``, the mean error ``at_1`` of alpha = 1, and for each of `ESTIMATES` the
    geometric mean over the seeds of its error relative to alpha = 1 with Student's interval: ``one, one_low,
    one_high`` and so on. Orders, and settings of the parts where there are several, are chosen on the other half
    of the seeds; `oracle` is a bound. The row `ALL` averages over the scenes of one structure, seed by seed, and
    the row `MIXED` over those that mix; ``own`` is there the best order for all of these. Seeds with an unknown
    error are left out.
    """
    import pandas as pd

    runs = runs[[str(part).startswith(SCENES) for part in runs["part"]]]
    runs = runs.assign(setting=setting_names(runs), scene=runs["sequence"].str.removeprefix("synthetic_"))
    runs = runs.assign(single=[str(part).endswith(SINGLE) for part in runs["part"]])
    records: list[dict[str, Any]] = []
    for (noise,), at_noise in runs.groupby(["noise"], sort=False):
        for metric in METRICS:
            found = _logs(at_noise, metric)
            lone = [name for name in found if name in SINGLE_STRUCTURE]
            if not found:
                continue
            # One setting for all scenes: the best on those of one structure together.
            scenes = [found[name] for name in lone or found]
            one = _by_halves(np.mean([single for single, _, _ in scenes], axis=0))
            both = _by_halves(np.mean([parts for _, parts, _ in scenes], axis=0))
            ratios = {name: _estimates(*logs[:2], one, both) for name, logs in found.items()}
            if lone:
                every = {key: np.mean([ratios[name][key] for name in lone], axis=0) for key in ESTIMATES}
                ratios[ALL] = every
            if mixed := [found[name][:2] for name in found if name in MIXED_STRUCTURE]:
                both_kinds = [np.mean(logs, axis=0) for logs in zip(*mixed, strict=True)]
                ratios[MIXED] = _estimates(both_kinds[0], both_kinds[1], one, both)
            for name, estimates in ratios.items():
                at_1 = found[name][2] if name in found else math.nan
                record = {"scene": name, "noise": noise, "metric": metric, "n": len(estimates["parts"])}
                record["at_1"] = at_1
                for key, values in estimates.items():
                    ends = [math.exp(value) for value in mean_interval(values)]
                    record |= {key: ends[0], f"{key}_low": ends[1], f"{key}_high": ends[2]}
                records.append(record)
    return pd.DataFrame(records)


def _logs(runs: pd.DataFrame, metric: str) -> dict[str, tuple[Errors, Errors, float]]:
    """Return by scene the logarithms of errors relative to alpha = 1, (seeds, settings).

    They are of the single orders and of the parts; the mean error at alpha = 1 follows. All scenes have the same
    seeds.
    """
    import pandas as pd

    errors = runs.assign(value=pd.to_numeric(runs[metric]).where(runs["status"] == "done"))
    single, parts = (
        errors[errors["single"] == kind].pivot(index=["scene", "seed"], columns="setting", values="value")
        for kind in (True, False)
    )
    if "1" not in single:
        raise InputError("errors are shown relative to alpha = 1, which the grid does not have")
    known = (single > 0).all(axis=1) & (parts > 0).all(axis=1).reindex(single.index, fill_value=False)
    whole = known.unstack("scene").fillna(False).all(axis=1)
    found = {}
    for scene in dict.fromkeys(runs["scene"]) if whole.any() else ():
        one, two = (table.loc[scene].loc[whole.index[whole]] for table in (single, parts))
        at_1 = one["1"].to_numpy()[:, None]
        found[scene] = np.log(one.to_numpy() / at_1), np.log(two.to_numpy() / at_1), float(at_1.mean())
    return found


def _by_halves(logs: Errors) -> NDArray[np.intp]:
    """Return for each seed the setting, of logs (seeds, settings), that is best on the other half of the seeds."""
    places = [int(logs[1::2].mean(axis=0).argmin()), int(logs[::2].mean(axis=0).argmin())]
    return np.array([places[i % 2] for i in range(len(logs))])


def _estimates(single: Errors, parts: Errors, one: NDArray[np.intp], both: NDArray[np.intp]) -> dict[str, Errors]:
    """Return each estimate's logarithms by seed; `one` and `both` are the settings chosen for all scenes."""
    seeds = np.arange(len(single))
    return {
        "one": single[seeds, one],
        "own": held_out(single),
        "oracle": single.min(axis=1),
        "parts": parts[seeds, both],
    }


def frame_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of whole sequences, a row for each protocol and sequence, and their means.

    Columns: ``protocol, sequence``, and for single orders and for the parts, each chosen on the other sequences
    (leave-one-out), the setting, AEPE in pixels and AAE in degrees: ``single, single_aepe, single_aae, parts,
    parts_aepe, parts_aae``; `gain` is how much smaller the AEPE of the parts is, per cent.
    """
    import pandas as pd

    runs = runs[[not str(part).startswith(SCENES) for part in runs["part"]]]
    runs = runs.assign(setting=setting_names(runs), protocol=[str(part).split("/")[0] for part in runs["part"]])
    records = []
    for protocol, rows in runs.groupby("protocol", sort=False):
        sequences = list(dict.fromkeys(rows["sequence"]))
        columns = {kind: _left_out(rows, kind, sequences) for kind in (SINGLE, PARTS)}
        for i, sequence in enumerate([*sequences, "mean"]):
            record: dict[str, Any] = {"protocol": protocol, "sequence": sequence}
            for kind, found in columns.items():
                name = kind.removeprefix("/")
                record |= dict(zip((name, f"{name}_aepe", f"{name}_aae"), found[i], strict=True))
            record["gain"] = 100.0 * (1.0 - record["parts_aepe"] / record["single_aepe"])
            records.append(record)
    return pd.DataFrame(records)


def _left_out(rows: pd.DataFrame, kind: str, sequences: list[str]) -> list[tuple[str, float, float]]:
    """Return setting, AEPE and AAE for each sequence, chosen on the others, and their means."""
    rows = rows[[str(part).endswith(kind) for part in rows["part"]]]
    names = list(dict.fromkeys(rows["setting"]))
    aepe, aae = (
        rows.pivot(index="setting", columns="sequence", values=metric).loc[names, sequences].to_numpy(np.float64)
        for metric in METRICS
    )
    choice = leave_one_out(aepe)
    if choice is None:
        return [("", math.nan, math.nan)] * (len(sequences) + 1)
    found = [(names[row], float(aepe[row, m]), math.degrees(aae[row, m])) for m, row in enumerate(choice.left_out)]
    means = [float(np.mean([item[k] for item in found])) for k in (1, 2)]
    return [*found, ("", means[0], means[1])]


def sentences(scenes: pd.DataFrame, frames: pd.DataFrame) -> list[str]:
    """State the errors of the flow in two parts: by scene and noise, and by protocol."""
    lines = []
    by_aepe = scenes[scenes["metric"] == METRICS[0]] if len(scenes) else scenes
    for row in by_aepe.to_dict("records"):
        lines.append(
            f"{row['scene']}, noise {row['noise']}: AEPE of the flow in two parts {_change(row['parts'])} of that "
            f"of alpha = 1 ({_change(row['parts_low'])} to {_change(row['parts_high'])}), one order "
            f"{_change(row['one'])}, the scene's own order {_change(row['own'])}."
        )
    for row in frames[frames["sequence"] == "mean"].to_dict("records") if len(frames) else ():
        of_protocol = frames[(frames["protocol"] == row["protocol"]) & (frames["sequence"] != "mean")]
        better = int((of_protocol["gain"] > 0).sum())
        lines.append(
            f"protocol {row['protocol']}, left out: AEPE {row['parts_aepe']:.4f} px in two parts, "
            f"{row['single_aepe']:.4f} px with one order; better on {better} of {len(of_protocol)} sequences."
        )
    return lines


def _change(ratio: float) -> str:
    return f"{100.0 * ratio:.0f} %"
