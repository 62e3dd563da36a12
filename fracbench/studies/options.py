"""The options of experiments, by the artefact that reads them."""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from typing import Any

from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.records import record


@dataclass(frozen=True)
class Family:
    """Of ``family``: see `fracbench.studies.paper.figures.family`."""

    x: str | None = None
    family: str | None = None
    styles: list[str] | None = None
    shade: list[float] | None = None
    logx: bool = False
    logy: bool = False

    def __post_init__(self) -> None:
        from fracbench.figures.style import caption_style

        if self.shade is not None and len(self.shade) != 2:
            raise InputError(f"option 'shade' must be two numbers, got {self.shade}")
        if self.styles == []:
            raise InputError("option 'styles' must name a line or a marker for each curve, e.g. --*")
        for style in self.styles or ():
            caption_style(style)


@dataclass(frozen=True)
class AdaptiveAlpha:
    """Of ``adaptive_alpha``: the side of a neighbourhood in pixels, and the number of sequences in the picture."""

    window: int = 32
    shown: int = 3

    def __post_init__(self) -> None:
        if self.window < 1 or self.shown < 0:
            raise InputError(f"option 'window' must be at least 1, 'shown' 0; got {self.window} and {self.shown}")


@dataclass(frozen=True)
class ProtocolSearch:
    """Of ``protocol_search``: see `fracbench.studies.protocol_search.space.Settings`."""

    space: dict[str, Any] = field(default_factory=dict)
    stages: list[Any] = field(default_factory=list)
    first: list[str] = field(default_factory=list)
    stop_above: float = 0.25
    stop_within: float = 1.5
    batch: int = 20

    def __post_init__(self) -> None:
        if self.batch < 1 or not self.stop_above > 0.0 or not self.stop_within >= 1.0:
            raise InputError(
                f"option 'batch' must be at least 1, 'stop_above' above 0, 'stop_within' at least 1; "
                f"got {self.batch}, {self.stop_above:g} and {self.stop_within:g}"
            )
        for part, switches in self.space.items():
            if not isinstance(switches, dict):
                raise InputError(f"option 'space' must have lists of values by switch in {part}, got {switches!r}")


_BY_ARTEFACT: dict[str, type] = {
    "adaptive_alpha": AdaptiveAlpha,
    "family": Family,
    "protocol_search": ProtocolSearch,
}
#: Types of the options of other artefacts. An artefact that is in neither dictionary has no options.
_TYPES: dict[str, dict[str, Any]] = {
    "frames": {"sequences": list[str] | None},
    "region_boxes": {"regions": list[str] | None},
    "alpha_regions": {"paper": Any},  # the captions' values, checked where the regions are at hand
    "alpha_by_structure": {"shown_noise": float | None, "paper": Any},  # the paper's ranges, checked likewise
    "solver_study": {"size": int | None, "alpha_step": float | None, "tol": float | None, "limit": int | None},
    "confidence": {"protocols": list[str] | None, "dropped": list[float] | None},
    "convergence": {
        "region": str | None,
        "alphas": list[float] | None,
        "gap": float | None,
        "last_gap": float | None,
        "seconds": float | None,
        "iterations": int | None,
        "reference_iterations": int | None,
    },
}


def require_options(experiment: Experiment) -> Any:
    """Return the typed options of an experiment; refuse unknown ones and values of another type."""
    artefact = experiment.artefact
    fields = [(name, kind, None) for name, kind in _TYPES.get(artefact, {}).items()]
    kind = _BY_ARTEFACT.get(artefact) or make_dataclass("Options", fields)
    return record(kind, experiment.options, f"experiment {experiment.name}, options")


def all_options(experiment: Experiment) -> dict[str, Any]:
    """Return the options, by name, of an artefact that needs all of them."""
    options = vars(require_options(experiment))
    missing = [name for name, value in options.items() if value is None]
    if missing:
        raise InputError(f"experiment {experiment.name}: `options` must have {', '.join(missing)} as well")
    return options


def required_option(experiment: Experiment, name: str) -> Any:
    """Return an option that the artefact needs."""
    if name not in experiment.options:
        raise InputError(f"experiment {experiment.name}: artefact {experiment.artefact} needs the option {name!r}")
    return experiment.options[name]
