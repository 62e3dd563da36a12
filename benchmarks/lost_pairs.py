"""Tell where `protocol=fluid` breaks as particles are lost between the frames, and whether its own check notices.

The check is the share of pixels at which the flows forward and back agree; it needs no truth.
"""

from __future__ import annotations

import argparse
import sys

import common
import numpy as np

from fracbench.api import estimate_flow
from fracbench.commands.bench import results_stem, write_results
from fracbench.data.datasets.registry import load_sequence

FLOWS = ("lamb_oseen", "mixing_layer", "solenoidal")
SHARES = (0.05, 0.2, 0.4, 0.6)
SEEDS = range(3)
BORDER = 16  # pixels that are not scored


def errors(flow: str, lost: float, seed: int, border: int = BORDER) -> tuple[float, float]:
    """Return the AEPE (px) of a rendered flow, and the share of pixels that agree, without a border."""
    pair = load_sequence(flow, "particles", noise=3.0, seed=seed, lost=lost)
    result = estimate_flow(pair.frame0, pair.frame1, protocol="fluid", confidence=True)
    assert pair.truth is not None and result.confidence is not None
    inner = slice(border, -border)
    distances = np.hypot(*(result.flow - pair.truth))[inner, inner]
    return float(distances.mean()), float(result.confidence.agrees[inner, inner].mean())


def measure(arguments: argparse.Namespace) -> None:
    """Compute, print and write the table."""
    stem = results_stem(arguments.overrides, "lost_pairs")
    records = []
    for lost in SHARES:
        for flow in FLOWS:
            for seed in SEEDS:
                aepe, agree = errors(flow, lost, seed)
                records.append({"lost": lost, "flow": flow, "seed": seed, "aepe": aepe, "agree": agree})
    write_results(
        records, stem, "Lost pairs and the check forward and back", "AEPE in pixels; agree: share of pixels"
    )


def main(argv: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    return common.run(measure, common.parser(__doc__, repeats=False), argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
