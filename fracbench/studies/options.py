"""The options of experiments, by the artefact that reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.config.records import record


@dataclass(frozen=True)
class Nothing:
    """For artefacts without options."""


@dataclass(frozen=True)
class Frames:
    """Of ``frames``: names of sequences."""

    sequences: list[str] | None = None


@dataclass(frozen=True)
class RegionBoxes:
    """Of ``region_boxes``: names of regions."""

    regions: list[str] | None = None


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
class AlphaRegions:
    """Of ``alpha_regions``: the captions' values, by region."""

    paper: Any = None  # checked where it is read, with the regions at hand


@dataclass(frozen=True)
class SolverStudy:
    """Of ``solver_study``: the size of its systems and where its sweeps end."""

    size: int | None = None
    alpha_step: float | None = None
    tol: float | None = None
    limit: int | None = None


@dataclass(frozen=True)
class Convergence:
    """Of ``convergence``: the problem, and the limits of the solvers."""

    region: str | None = None
    alphas: list[float] | None = None
    gap: float | None = None
    last_gap: float | None = None
    seconds: float | None = None
    iterations: int | None = None
    reference_iterations: int | None = None


@dataclass(frozen=True)
class AlphaByStructure:
    """Of ``alpha_by_structure``: the noise of the figure, and the paper's range of best alphas by structure."""

    shown_noise: float | None = None
    paper: Any = None  # checked where it is read


@dataclass(frozen=True)
class AdaptiveAlpha:
    """Of ``adaptive_alpha``: the side of a neighbourhood in pixels, and the number of sequences in the picture."""

    window: int = 32
    shown: int = 3

    def __post_init__(self) -> None:
        if self.window < 1 or self.shown < 0:
            raise InputError(f"option 'window' must be at least 1, 'shown' 0; got {self.window} and {self.shown}")


_BY_ARTEFACT: dict[str, type] = {
    "adaptive_alpha": AdaptiveAlpha,
    "alpha_by_structure": AlphaByStructure,
    "convergence": Convergence,
    "frames": Frames,
    "region_boxes": RegionBoxes,
    "family": Family,
    "alpha_regions": AlphaRegions,
    "solver_study": SolverStudy,
}


def require_options(experiment: Experiment) -> None:
    """Refuse options that the artefact does not know, or of another type.

    Parameters
    ----------
    experiment : Experiment
        The experiment.

    Raises
    ------
    InputError
        An unknown option (the nearest is offered), or a value of another type.
    """
    _record(experiment)


def all_options(experiment: Experiment) -> dict[str, Any]:
    """Return the options of an artefact that needs all of them.

    Parameters
    ----------
    experiment : Experiment
        The experiment.

    Returns
    -------
    dict
        By name.

    Raises
    ------
    InputError
        As for `require_options`, or an option is missing.
    """
    options = vars(_record(experiment))
    missing = [name for name, value in options.items() if value is None]
    if missing:
        raise InputError(f"experiment {experiment.name}: `options` must have {', '.join(missing)} as well")
    return options


def _record(experiment: Experiment) -> Any:
    kind = _BY_ARTEFACT.get(experiment.artefact, Nothing)
    return record(kind, experiment.options, f"experiment {experiment.name}, options")
