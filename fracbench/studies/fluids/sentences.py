"""The goals of the study of fluids, each with its figure and a verdict, and where other methods are better."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fracbench.studies.fluids.tables import ALPHA_1, MEAN, OPENPIV, OURS

if TYPE_CHECKING:
    import pandas as pd

PARTICLES, PIV = "particles", "piv"
#: The goals: the largest share of an error of others, and the largest error on the public pairs in pixels.
SHARE, VORTICITY_SHARE, PIV_AEPE = 0.4, 0.5, 0.090


def sentences(flows: pd.DataFrame, orders: pd.DataFrame, settings: pd.DataFrame) -> list[str]:
    """State every goal with its figure and verdict, then where another method has less error than ours."""
    lines = _on_particles(flows) + _on_piv(flows)
    lines += _against_alpha_1(flows, orders) + _best_orders(orders)
    return [*lines, *_large_displacements(settings), *_losses(flows, settings)]


def _on_particles(flows: pd.DataFrame) -> list[str]:
    means = _means(flows, PARTICLES)
    if OURS not in means.index:
        return []
    ours, lines = means.loc[OURS], []
    others = means[[not name.startswith((OPENPIV, OURS, ALPHA_1)) for name in means.index]]["aepe"].dropna()
    if OPENPIV in means.index:
        piv = means.loc[OPENPIV]
        lines.append(_share("AEPE", ours["aepe"], OPENPIV, piv["aepe"], SHARE, "px"))
        lines.append(_share("AEPE on its grid", ours["aepe_grid"], OPENPIV, piv["aepe_grid"], SHARE, "px"))
    if len(others):
        best = others.idxmin()
        lines.append(_share("AEPE", ours["aepe"], f"the best of the others, {best}", others[best], SHARE, "px"))
    if OPENPIV in means.index:
        words = "RMS error of vorticity on its grid"
        lines.append(
            _share(words, ours["vorticity_grid"], OPENPIV, piv["vorticity_grid"], VORTICITY_SHARE, "a frame")
        )
    return lines


def _share(error: str, ours: float, name: str, theirs: float, goal: float, unit: str) -> str:
    share = ours / theirs
    if math.isnan(share):
        return f"Rendered flows, {error}: not known for ours and {name}, as points failed."
    return (
        f"Rendered flows, {error}: {ours:.4f} {unit}, {share:.2f} times that of {name} ({theirs:.4f}); goal: at "
        f"most {goal:g}, {_verdict(share <= goal)}."
    )


def _on_piv(flows: pd.DataFrame) -> list[str]:
    means = _means(flows, PIV)
    if OURS not in means.index:
        return []
    error = means.loc[OURS, "aepe"]
    if math.isnan(error):
        return ["Public pairs: the mean AEPE is not known, as points failed."]
    return [
        f"Public pairs, mean AEPE: {error:.4f} px with the protocol, chosen on these pairs among others; "
        f"goal, out of sample: at most {PIV_AEPE:.3f} px (conf/protocol/fluid.yaml has that figure)."
    ]


def _against_alpha_1(flows: pd.DataFrame, orders: pd.DataFrame) -> list[str]:
    """Compare ours with alpha = 1 under the weight that is best for it, flow by flow."""
    if not len(orders) or not len(flows):
        return []
    one = orders[(orders["alpha"] == 1.0) & (orders["flow"] != MEAN)].set_index(["dataset", "flow"])["best_aepe"]
    ours = flows[flows["method"] == OURS].set_index(["dataset", "flow"])["aepe"].reindex(one.index)
    share = (ours / one).dropna()
    if not len(share):
        return []
    worse = ", ".join(f"{flow} ({value:.2f} times)" for (_, flow), value in share[share > 1.0].items())
    told = f"{_verdict(not worse)}: {worse}" if worse else _verdict(True)
    return [
        f"Beside alpha = 1 with the weight of the data that is best for it on each flow: {share.min():.2f} to "
        f"{share.max():.2f} times its AEPE; goal: worse on no flow, {told}."
    ]


def _best_orders(orders: pd.DataFrame) -> list[str]:
    if not len(orders):
        return []
    known = orders[(orders["flow"] != MEAN) & orders["aepe"].notna()]
    best = known.loc[known.groupby(["dataset", "flow"], sort=False)["aepe"].idxmin()]
    told = ", ".join(f"{flow} {alpha:g}" for flow, alpha in zip(best["flow"], best["alpha"], strict=True))
    return [f"The best single order of the grid by flow: {told}."]


def _large_displacements(settings: pd.DataFrame) -> list[str]:
    part = settings[(settings["setting"] == "displacement") & (settings["value"] == 10.0)].set_index("method")[
        "aepe"
    ]
    if not {OURS, OPENPIV} <= set(part.dropna().index):
        return []
    ours, theirs = part[OURS], part[OPENPIV]
    return [
        f"At a displacement of 10 px: AEPE {ours:.3f} px, OpenPIV {theirs:.3f} px; goal: below it, "
        f"{_verdict(ours < theirs)}."
    ]


def _losses(flows: pd.DataFrame, settings: pd.DataFrame) -> list[str]:
    """Name flows and settings where another method, alpha = 1 among them, has a smaller AEPE than ours."""
    lines = []
    for (_, flow), part in flows[flows["flow"] != MEAN].groupby(["dataset", "flow"], sort=False):
        lines += _better(part, str(flow))
    for (setting, value), part in settings.groupby(["setting", "value"], sort=False):
        lines += _better(part, f"{setting} {value:g}")
    return [f"Where another method is better: {'; '.join(lines) or 'nowhere'}."] if len(flows) else []


def _better(part: pd.DataFrame, where: str) -> list[str]:
    errors = part.set_index("method")["aepe"]
    if OURS not in errors or math.isnan(errors[OURS]):
        return [f"{where}, where ours failed"] if OURS in errors else []
    less = errors[errors < errors[OURS]].sort_values()
    return [f"{where} ({less.index[0]} {less.iloc[0]:.3f} px, ours {errors[OURS]:.3f})"] if len(less) else []


def _means(flows: pd.DataFrame, dataset: str) -> pd.DataFrame:
    import pandas as pd

    if not len(flows):
        return pd.DataFrame(columns=["aepe"])
    return flows[(flows["dataset"] == dataset) & (flows["flow"] == MEAN)].set_index("method")


def _verdict(reached: bool) -> str:
    return "reached" if reached else "missed"
