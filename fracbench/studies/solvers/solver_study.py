"""Is the paper's best alpha where its printed solver stops converging? Sweeps alone, and whole runs with each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fracbench.data.files import ensure_folder, write_text
from fracbench.data.regions import Region
from fracbench.errors import InputError
from fracbench.harness.config.experiment import Experiment, load_experiment
from fracbench.harness.run.grid_points import PlannedPoint
from fracbench.harness.run.plan import Plan
from fracbench.harness.run.point import NO_DATA, Point
from fracbench.harness.run.store import Row
from fracbench.harness.run.tidy import tidy
from fracbench.model.params import FlowParams
from fracbench.studies import tables
from fracbench.studies.base import Artefact, file_stem
from fracbench.studies.options import all_options
from fracbench.studies.paper.alpha_regions import CAPTIONED, captions
from fracbench.studies.solvers.spectral_radius import SWEEPS, jacobi_limit

if TYPE_CHECKING:
    import pandas as pd

#: Solvers of the u-step, as the study names them.
SOLVERS: Mapping[str, str] = {"jacobi": "Jacobi (printed)", "gauss_seidel": "Gauss-Seidel", "exact": "exact"}
#: Columns of the tables of whole runs.
_COLUMNS = ["region", "sequence", "theta", "lambda_sb", "u_solver", "alpha", "aae", "aepe"]
_COLUMNS += ["iterations", "inner_iterations", "stop", "status"]
#: A best alpha this near to the limit, or to the paper's (one step of its grid), counts as there.
NEAR_LIMIT, NEAR_PAPER = 0.2, 0.1 + 1e-9


def solver_study(experiment: Experiment, plan: Plan, rows: Mapping[str, Row], results: Path) -> Artefact:
    """Compare the solvers of the u-step, alone and in whole runs; see `fracbench.studies.base.Renderer`."""
    from fracbench.figures.cache import draw
    from fracbench.studies.solvers.solver_study_figure import solver_panels

    options = all_options(experiment)
    runs = tidy(plan, rows)
    pairs = runs.drop_duplicates("region").set_index("region")[["theta", "lambda_sb"]]
    summary = solver_summary(runs, pairs, printed_alphas())
    lines = solver_sentences(runs, summary)

    def stem(kind: str, folder: str = "tables") -> Path:
        return file_stem(experiment.name + kind, plan, ensure_folder(results / folder))

    spectra = spectra_table(plan, rows)
    size, notes = options["size"], [*plan.notices, *tables.footnote(rows, ["reference"])]
    text = [
        f"# {experiment.title}\n",
        _SOLVER_LEGEND + "\n",
        tables.to_markdown(_short(summary)) + "\n",
        "\n\n".join(lines),
    ]
    text += [f"\n## The u-system alone, {size} x {size} pixels\n", _SPECTRA_LEGEND.format(**options) + "\n"]
    text += [tables.to_markdown(_side_by_side(spectra)) + "\n", "\n\n".join(notes)]
    files = [
        tables.write_table(summary, stem("")),
        tables.write_table(spectra, stem("_spectra")),
        tables.write_table(runs[_COLUMNS], stem("_runs")),
        write_text("\n".join(text) + "\n", stem("").with_name(f"{stem('').name}.md")),
        *draw(stem("", "figures"), solver_panels, spectra, runs, summary, experiment.title),
    ]
    return Artefact(files, [(experiment.title, _short(summary))], lines)


_SOLVER_LEGEND = (
    "The order alpha with the smallest errors, as printed and as each solver of the u-step reports it. `limit` is "
    "the order above which the printed fixed point (Jacobi, signs corrected) diverges on a large image with d "
    "and b held (docs/errata.md, item 3); inside Algorithm 4 the shrinkage bounds it, and it oscillates instead."
)
_SPECTRA_LEGEND = (
    "Spectral radius of a sweep (above 1 it diverges), and in brackets the sweeps to a relative residual of "
    "{tol:g} from u = v, noise (none: not within {limit}); Jacobi / Gauss-Seidel. The exact solver takes one step."
)


def spectrum_points(experiment: Experiment, plan: Plan) -> list[PlannedPoint]:
    """Return a point for each region and each alpha from 0 to 2: the spectra of the u-system of a square."""
    options = all_options(experiment)
    step, size = options["alpha_step"], options["size"]
    if not step > 0.0:
        raise InputError(f"experiment {experiment.name}: option 'alpha_step' must be above 0, got {step:g}")
    alphas = [alpha for alpha in np.round(np.arange(0.0, 2.0 + step / 2.0, step), 6).tolist() if alpha <= 2.0]
    square = Region("square", NO_DATA, (0, size), (0, size))
    first: dict[str, PlannedPoint] = {}
    for planned in plan.points:
        first.setdefault(planned.labels["region"], planned)
    points = []
    for planned in first.values():
        method, params = planned.point.method, planned.point.params
        for alpha in alphas:
            system = {"alpha": alpha, "theta": params.theta, "lambda_sb": params.lambda_sb, "boundary": "zero"}
            point = Point(
                method,
                FlowParams().replace(system),
                dataset=NO_DATA,
                sequence=NO_DATA,
                region=square,
                context=0,
                data_digest="",
                score="spectrum",
                options=(("tol", options["tol"]), ("limit", options["limit"])),
            )
            points.append(replace(planned, point=point))
    return points


def spectra_table(plan: Plan, rows: Mapping[str, Row]) -> pd.DataFrame:
    """Return how fast the sweeps converge for each region's u-system and alpha.

    Columns: ``region, theta, lambda_sb, alpha``, and for each sweep its ``radius`` (four digits) and ``sweeps``
    (empty where the tolerance is not reached); both are empty where a point is not done.
    """
    import pandas as pd

    records = []
    for planned in plan.points:
        point, row = planned.point, rows.get(planned.point.key)
        if point.score == "spectrum":
            record: dict[str, Any] = {"region": planned.labels["region"]}
            record |= {name: getattr(point.params, name) for name in ("theta", "lambda_sb", "alpha")}
            for sweep in SWEEPS:
                for name in (f"{sweep} radius", f"{sweep} sweeps"):
                    record[name] = row.result.get(name) if row is not None else None
            records.append(record)
    table = pd.DataFrame(records).astype({f"{sweep} radius": "float" for sweep in SWEEPS})
    return table.astype({f"{sweep} sweeps": "Int64" for sweep in SWEEPS})


def printed_alphas() -> dict[str, dict[str, float]]:
    """Return the best alpha and lambda_sb of the captions of Figures 6 and 7, by region."""
    figures = (captions(load_experiment(name)) for name in CAPTIONED)
    return {region: values for figure in figures for region, values in figure.items()}


def solver_summary(
    runs: pd.DataFrame, pairs: pd.DataFrame, printed: Mapping[str, Mapping[str, float]]
) -> pd.DataFrame:
    """Put the best alpha of each solver beside the paper's and beside the limit of the printed sweep.

    Columns: ``region, theta, lambda_sb, limit``, then for AAE and AEPE the best alpha in the paper and with each
    solver, and that solver's error there; NaN where a point of the curve failed.
    """
    import pandas as pd

    records = []
    for region, (theta, mu) in pairs.iterrows():
        record: dict[str, Any] = {"region": region, "theta": theta, "lambda_sb": mu}
        record["limit"] = round(jacobi_limit(float(theta), float(mu)), 4)
        for metric in ("aae", "aepe"):
            record[f"{metric} paper"] = float(printed[str(region)][metric])
            for solver in SOLVERS:
                curve = runs[(runs["region"] == region) & (runs["u_solver"] == solver)]
                whole = len(curve) > 0 and curve[metric].notna().all()
                best = curve.loc[curve[metric].idxmin()] if whole else None
                record[f"{metric} {solver}"] = math.nan if best is None else float(best["alpha"])
                record[f"{metric} {solver} error"] = math.nan if best is None else float(best[metric])
        records.append(record)
    return pd.DataFrame(records)


def _short(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the summary for reading: alphas with two digits, without the errors."""
    shown = summary[[column for column in summary if not column.endswith(" error")]].copy()
    for column in shown.columns[1:]:
        shown[column] = [("" if math.isnan(value) else f"{value:.3g}") for value in shown[column]]
    return shown


def _side_by_side(spectra: pd.DataFrame) -> pd.DataFrame:
    """Return the spectra for reading: a row an alpha, a column a region."""
    cells = {}
    for sweep in SWEEPS:
        counts = spectra[f"{sweep} sweeps"].astype("object").where(spectra[f"{sweep} sweeps"].notna(), "none")
        cells[sweep] = spectra[f"{sweep} radius"].map("{:.3f}".format) + " (" + counts.astype(str) + ")"
    known = spectra["jacobi radius"].notna()
    shown = spectra.assign(cell=(cells["jacobi"] + " / " + cells["gauss_seidel"]).where(known, ""))
    shown["alpha"] = shown["alpha"].map("{:g}".format)
    return shown.pivot_table("cell", "alpha", "region", aggfunc="first", sort=False).reset_index()


def solver_sentences(runs: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Answer whether the paper's best alpha is where its solver stops converging."""
    limits, n = summary["limit"], len(summary)
    beyond = {metric: int((summary[f"{metric} paper"] > limits).sum()) for metric in ("aae", "aepe")}
    sentences = [
        f"The printed sweep stops converging at alpha {limits.min():.2f} to {limits.max():.2f}, by region; "
        f"the paper's best alpha is beyond that on {beyond['aae']} of {n} by AAE, on {beyond['aepe']} by AEPE."
    ]
    names = {"paper": "In the paper", **{solver: f"With {name}" for solver, name in SOLVERS.items()}}
    for source, name in names.items():
        parts = [_against_limit(summary, metric, source) for metric in ("aae", "aepe")]
        sentences.append(f"{name}, the best alpha is {'; '.join(parts)}.")
    return [*sentences, *_excess_of_jacobi(runs, summary)]


def _excess_of_jacobi(runs: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Say how much larger the errors are with the printed sweep, where it converges and where it does not."""
    both = runs.pivot_table("aepe", ["region", "alpha"], "u_solver", dropna=False)
    if not {"jacobi", "exact"} <= set(both):
        return []
    both["limit"] = both.index.get_level_values("region").map(summary.set_index("region")["limit"])
    both["log"] = np.log(both["jacobi"] / both["exact"])
    alphas = both.index.get_level_values("alpha")
    ranges = {"from 1 to its limit": (alphas >= 1.0) & (alphas <= both["limit"]), "beyond": alphas > both["limit"]}
    means = {name: float(np.exp(both["log"][chosen].mean())) for name, chosen in ranges.items() if chosen.any()}
    parts = ", ".join(f"{mean:.2f} times {name}" for name, mean in means.items() if math.isfinite(mean))
    return [f"AEPE with Jacobi against exact: {parts} (geometric means)."] if parts else []


def _against_limit(summary: pd.DataFrame, metric: str, source: str) -> str:
    """Say how the best alphas of one source lie to the limits and to the paper's."""
    alphas, limits, n = summary[f"{metric} {source}"], summary["limit"], len(summary)
    if alphas.isna().any():
        return f"not known by {metric.upper()}, as points failed"
    near = int(((alphas - limits).abs() <= NEAR_LIMIT).sum())
    text = (
        f"by {metric.upper()} within {NEAR_LIMIT:g} of the limit on {near} of {n} regions, with a rank "
        f"correlation of {_rank_correlation(alphas, limits)}"
    )
    if source == "paper":
        return text
    agree = int(((alphas - summary[f"{metric} paper"]).abs() <= NEAR_PAPER).sum())
    return f"{text}, and within {NEAR_PAPER:.1g} of the paper's on {agree}"


def _rank_correlation(a: pd.Series, b: pd.Series) -> str:
    """Return Spearman's rank correlation as text; it needs two different values on each side."""
    if a.nunique() < 2 or b.nunique() < 2:
        return "none"
    return f"{np.corrcoef(a.rank(), b.rank())[0, 1]:+.2f}"
