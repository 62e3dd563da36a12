"""Speed against peers: every contender on every sequence, interleaved in one process, warm, threads pinned."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from fracbench.errors import FracbenchError, InputError, unknown_name
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import make_plan
from fracbench.methods.registry import METHODS, get_method, method_names
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES

_log = logging.getLogger(__name__)

#: The contender that ratios are relative to.
YARDSTICK = "opencv_tvl1"


@dataclass(frozen=True)
class Contender:
    """A registered method under the name that the table shows, and how its parameters are set.

    `params` go on top of the sequence's (Table 2) and the method's defaults, or of the protocol if one is named.
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
        Contender("tvl1_sb_alpha_ic", "tvl1_sb_alpha_ic", {"alpha": "1", **fast}),
        Contender("accurate", "tvl1_sb_alpha_ic", protocol="accurate"),
        Contender("fast", "tvl1_sb", protocol="fast"),
        Contender("fluid", "tvl1_sb_alpha_map", protocol="fluid"),
    ]
    return [Contender("tvl1", "tvl1"), Contender("tvl1_sb", "tvl1_sb", fast), *fractional, *beyond]


def contenders(only: Sequence[str] = ()) -> list[Contender]:
    """Return the contenders: ours, installed peers, methods of other packages; with `only`, those so named.

    A name in `only` that no contender begins with, or that cannot be used, is an `InputError`.
    """
    ours = _ours()
    raced = {contender.method for contender in ours}
    names = [name for name in dict.fromkeys((*METHODS, *method_names())) if name not in raced]
    everyone = [*ours, *(Contender(name, name) for name in names)]
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
    except InputError as exc:
        if method not in METHODS:
            _log.warning("%s", exc)
        return False
    return True


def run(
    racers: Sequence[Contender], tokens: Sequence[str], *, repeats: int, threads: int, on_lap: Callable[[], None]
) -> list[dict[str, Any]]:
    """Time contenders on the sequences that `tokens` choose; return a record for each contender and sequence.

    A round runs every contender once on every sequence; the median over the rounds counts. `threads` are those of
    the solver and of OpenCV; BLAS has one. `on_lap` is called after each timed estimate.
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
    failed: list[Contender] = []
    peers.opencv_threads = threads
    with use_threads(threads), threadpool_limits(1):
        for round_number in range(repeats + 1):  # round 0 warms up: compilation, caches
            for i, planned in enumerate(plan.points):
                frame0, frame1, truth, inner = point_arrays(planned.point, plan.folder)
                for racer in [racer for racer in racers if racer not in failed]:
                    method = get_method(racer.method)
                    params = _params(racer, plans[racer.protocol].points[i].point.canonical)
                    started = time.perf_counter()
                    try:
                        flow = method.compute(frame0, frame1, params).flow
                    except FracbenchError as exc:
                        _log.warning("%s is left out: %s", racer.name, exc)
                        failed.append(racer)
                        continue
                    took = time.perf_counter() - started
                    place = (racer.name, planned.labels["sequence"])
                    if round_number == 0:
                        scored = None
                        if truth is not None:
                            scored = flow_errors(flow[(slice(None), *inner)], truth[(slice(None), *inner)])
                        records[place] = {
                            "contender": racer.name,
                            "sequence": planned.labels["sequence"],
                            "aae": scored.aae if scored else math.nan,
                            "aepe": scored.aepe if scored else math.nan,
                            "n_pixels": flow[(0, *inner)].size,
                        }
                    else:
                        seconds.setdefault(place, []).append(took)
                        on_lap()
    left = [place for place in records if place[0] not in {racer.name for racer in failed}]
    if not left:
        raise FracbenchError("bench: no contender has finished")
    return [{**records[place], "seconds": median(seconds[place])} for place in left]


def _params(racer: Contender, sequence_params: Mapping[str, str]) -> Any:
    if racer.protocol:
        return FlowParams().replace(sequence_params).replace(racer.params)
    method = get_method(racer.method)
    if method.params is not FlowParams:
        return method.replace(method.start(), racer.params)
    table2 = {name: sequence_params[name] for name in ("lambda", "theta", "n_scales", "lambda_sb")}
    return FlowParams().replace(method.defaults).replace(table2).replace(racer.params)
