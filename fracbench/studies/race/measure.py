"""Speed against peers: every contender on every sequence, interleaved in one process, warm, threads pinned."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from fracbench.errors import InputError, unknown_name
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import make_plan
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES

#: The contender that ratios are relative to.
YARDSTICK = "opencv_tvl1"
_PEERS = (
    "opencv_tvl1", "opencv_tvl1_deep", "opencv_dis", "opencv_farneback",
    "skimage_tvl1", "skimage_tvl1_ipol", "skimage_ilk",
)  # fmt: skip


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
        Contender("accurate", "tvl1_sb_alpha_map", protocol="accurate"),
        Contender("fast", "tvl1_sb", protocol="fast"),
    ]
    return [Contender("tvl1", "tvl1"), Contender("tvl1_sb", "tvl1_sb", fast), *fractional, *beyond]


def contenders(only: Sequence[str] = ()) -> list[Contender]:
    """Return our contenders, then the installed peers; with `only`, those whose names begin so.

    A name in `only` that no contender begins with, or whose program is missing, is an `InputError`.
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
    peers.opencv_threads = threads
    with use_threads(threads), threadpool_limits(1):
        for round_number in range(repeats + 1):  # round 0 warms up: compilation, caches
            for i, planned in enumerate(plan.points):
                frame0, frame1, truth, inner = point_arrays(planned.point, plan.folder)
                for racer in racers:
                    method = get_method(racer.method)
                    params = _params(racer, plans[racer.protocol].points[i].point.canonical)
                    started = time.perf_counter()
                    flow = method.estimate(frame0, frame1, params).flow
                    took = time.perf_counter() - started
                    place = (racer.name, planned.labels["sequence"])
                    if round_number == 0:
                        errors = flow_errors(flow[(slice(None), *inner)], truth[(slice(None), *inner)])
                        records[place] = {
                            "contender": racer.name,
                            "sequence": planned.labels["sequence"],
                            "aae": errors.aae,
                            "aepe": errors.aepe,
                            "n_pixels": errors.n_pixels + errors.n_unknown,
                        }
                    else:
                        seconds.setdefault(place, []).append(took)
                        on_lap()
    return [{**record, "seconds": median(seconds[place])} for place, record in records.items()]


def _params(racer: Contender, sequence_params: Mapping[str, str]) -> FlowParams:
    if racer.protocol:
        return FlowParams().replace(sequence_params).replace(racer.params)
    method = get_method(racer.method)
    table2 = {name: sequence_params[name] for name in ("lambda", "theta", "n_scales", "lambda_sb")}
    return FlowParams().replace(method.defaults).replace(table2).replace(racer.params)
