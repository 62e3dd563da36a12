"""Speed against peers: every contender on every sequence, interleaved in one process, warm, threads pinned."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from fracbench.errors import InputError, unknown_name
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.provenance import peak_mib, reset_peak
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES

#: The contender that ratios are relative to.
YARDSTICK = "opencv_tvl1"


@dataclass(frozen=True)
class Contender:
    """A method with its parameters, under a name of its own.

    Attributes
    ----------
    name : str
        In tables.
    method : str
        In the registry.
    params : mapping
        On top of the sequence's own (Table 2) and of the method's defaults, or of the protocol's.
    protocol : str
        The protocol whose parameters are taken; empty for the method's own.
    """

    name: str
    method: str
    params: Mapping[str, Any] = field(default_factory=dict)
    protocol: str = ""


def _ours() -> list[Contender]:
    fractional = [
        Contender(
            f"tvl1_sb_alpha {boundary} alpha {alpha}", "tvl1_sb_alpha", {"boundary": boundary, "alpha": alpha}
        )
        for boundary in ("reflect", "zero")
        for alpha in ("1", "1.2", "1.7")
    ]
    own = FlowParams()
    fast = {
        name: getattr(own, name) for name in ("u_solver", "inner", "coupling", "epsilon", "max_iter", "n_warps")
    }
    two_orders = {f"alpha_{name}": "1" if name == "flat" else "1.2" for name in CLASSES}
    beyond = [
        Contender("tvl1_sb_alpha_map 2 orders", "tvl1_sb_alpha_map", {**two_orders, **fast}),
        Contender("accurate", "tvl1_sb_alpha_map", protocol="accurate"),
    ]
    return [Contender("tvl1", "tvl1"), Contender("tvl1_sb", "tvl1_sb", fast), *fractional, *beyond]


_PEERS = (
    "opencv_tvl1", "opencv_tvl1_deep", "opencv_dis", "opencv_farneback",
    "skimage_tvl1", "skimage_tvl1_ipol", "skimage_ilk",
)  # fmt: skip


def contenders(only: Sequence[str] = ()) -> list[Contender]:
    """Return the contenders: ours, and the peers that are installed.

    Parameters
    ----------
    only : sequence of str, optional
        Names, or beginnings of names; all if empty.

    Returns
    -------
    list of Contender
        Ours first.

    Raises
    ------
    InputError
        A name that none begins with; a peer named whose program is missing.
    """
    everyone = [*_ours(), *(Contender(name, name) for name in _PEERS)]
    if not only:
        return [contender for contender in everyone if _installed(contender.method)]
    for name in only:
        if not any(contender.name.startswith(name) for contender in everyone):
            raise unknown_name("contender", name, [contender.name for contender in everyone])
    chosen = [contender for contender in everyone if contender.name.startswith(tuple(only))]
    for contender in chosen:
        get_method(contender.method).require()
    return chosen


def _installed(method: str) -> bool:
    try:
        get_method(method).require()
    except InputError:
        return False
    return True


def run(
    racers: Sequence[Contender],
    tokens: Sequence[str],
    *,
    repeats: int,
    threads: int,
    on_lap: Callable[[], None] | None = None,
) -> list[dict[str, Any]]:
    """Time contenders; one record for each and each sequence.

    Parameters
    ----------
    racers : sequence of Contender
        From `contenders`.
    tokens : sequence of str
        Overrides that choose the sequences.
    repeats : int
        Timed rounds; the median counts. A round runs every contender once on every sequence.
    threads : int
        Threads of the solver and of OpenCV; BLAS has one.
    on_lap : callable, optional
        Called after each timed estimate.

    Returns
    -------
    list of dict
        ``contender, sequence, seconds, aae, aepe, peak_mib, n_pixels``; the peak is what the estimate takes
        beyond what the process held before.
    """
    from threadpoolctl import threadpool_limits

    from fracbench.evaluation.metrics import flow_errors
    from fracbench.methods import peers
    from fracbench.model.kernels.threads import use_threads

    plans = {
        name: make_plan((*tokens, f"protocol={name or 'recommended'}")) for name in {r.protocol for r in racers}
    }
    plan = next(iter(plans.values()))
    seconds: dict[tuple[str, str], list[float]] = {}
    records: dict[tuple[str, str], dict[str, Any]] = {}
    peers.opencv_threads = threads
    with use_threads(threads), threadpool_limits(1):
        for round_number in range(repeats + 1):  # round 0 warms up: compilation, caches
            for i, planned in enumerate(plan.points):
                frame0, frame1, truth, inner = point_arrays(planned.point, plan.folder)
                for racer in racers:
                    method = get_method(racer.method)
                    params = _params(racer, plans[racer.protocol].points[i].point.canonical)
                    reset_peak()
                    before = peak_mib()
                    started = time.perf_counter()
                    flow = method.estimate(frame0, frame1, params).flow
                    took = time.perf_counter() - started
                    place = (racer.name, planned.labels["sequence"])
                    if round_number:
                        seconds.setdefault(place, []).append(took)
                        if on_lap is not None:
                            on_lap()
                    if round_number != 1:
                        continue
                    errors = flow_errors(flow[(slice(None), *inner)], truth[(slice(None), *inner)])
                    records[place] = {
                        "contender": racer.name,
                        "sequence": planned.labels["sequence"],
                        "aae": errors.aae,
                        "aepe": errors.aepe,
                        "peak_mib": float(np.maximum((peak_mib() or math.nan) - (before or math.nan), 0.0)),
                        "n_pixels": errors.n_pixels + errors.n_unknown,
                    }
    return [{**record, "seconds": median(seconds[place])} for place, record in records.items()]


def _params(racer: Contender, sequence_params: Mapping[str, str]) -> FlowParams:
    if racer.protocol:
        return FlowParams().replace(sequence_params).replace(racer.params)
    method = get_method(racer.method)
    table2 = {name: sequence_params[name] for name in ("lambda", "theta", "n_scales", "lambda_sb")}
    return FlowParams().replace(method.defaults).replace(table2).replace(racer.params)
