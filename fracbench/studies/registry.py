"""The registry of renderers, one for each kind of artefact that an experiment can name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.store import Row
from fracbench.studies.accurate import accurate_study
from fracbench.studies.alpha_map.artefact import adaptive_alpha
from fracbench.studies.base import Artefact, Renderer
from fracbench.studies.confidence import confidence
from fracbench.studies.fluid_protocol import fluid_protocol
from fracbench.studies.fluids.artefact import fluids
from fracbench.studies.infimal.artefact import order_from_flow
from fracbench.studies.options import require_options
from fracbench.studies.paper.alpha_regions import alpha_regions
from fracbench.studies.paper.figures import family, frames, region_boxes
from fracbench.studies.paper.table1 import table1
from fracbench.studies.paper.table2 import protocol_claims, table2
from fracbench.studies.protocol_search.artefact import protocol_search
from fracbench.studies.protocols import protocol_study
from fracbench.studies.solvers.convergence_study import convergence
from fracbench.studies.solvers.solver_study import solver_study
from fracbench.studies.structure.artefact import alpha_by_structure
from fracbench.studies.sweep import sweep

RENDERERS: dict[str, Renderer] = {
    "accurate_study": accurate_study,
    "adaptive_alpha": adaptive_alpha,
    "alpha_by_structure": alpha_by_structure,
    "alpha_regions": alpha_regions,
    "confidence": confidence,
    "convergence": convergence,
    "family": family,
    "fluid_protocol": fluid_protocol,
    "fluids": fluids,
    "frames": frames,
    "order_from_flow": order_from_flow,
    "protocol_claims": protocol_claims,
    "protocol_search": protocol_search,
    "protocol_study": protocol_study,
    "region_boxes": region_boxes,
    "solver_study": solver_study,
    "sweep": sweep,
    "table1": table1,
    "table2": table2,
}


def require_renderer(experiment: Experiment, plan: Plan | None = None) -> Renderer:
    """Return the renderer that an experiment names; refuse an unknown one, and options that it does not have.

    If a plan is given, refuse regions as well that its dataset does not have.
    """
    if experiment.artefact not in RENDERERS:
        raise unknown_name("artefact", experiment.artefact, RENDERERS, f"experiment {experiment.name}")
    require_options(experiment)
    if plan is not None and plan.foreign and "regions" in experiment.options:
        raise InputError(f"{experiment.name}: regions belong to Middlebury; dataset={plan.dataset} has none")
    return RENDERERS[experiment.artefact]


def render(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Write the artefact that an experiment names from its points and their rows, by key."""
    return require_renderer(experiment)(experiment, plan, rows, results)
