"""Figures, pictures of each sequence and documents on the report's page, from the files that hold them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from fracbench.harness.config.paths import asset
from fracbench.report.claims.judging import SETTINGS
from fracbench.report.page.elements import (
    Block,
    Details,
    Heading,
    Missing,
    Picture,
    Section,
    Text,
    code,
    demoted,
    picture_file,
    plain,
)
from fracbench.report.page.gallery import gallery, missing_flows, scenes, shared_scale
from fracbench.report.sources import COMMITTED, SUFFIXES, Source, Sources, homes


def document(path: str, summary: str) -> Details:
    """Return a document of the project, folded; its headings have no anchors here."""
    text = re.sub(r"\[([^\]]+)\]\(#[^)]*\)", r"\1", asset(path).read_text(encoding="utf-8"))
    return Details(summary, [Text(demoted(text, 2))])


def answer_picture(sources: Sources) -> list[Block]:
    """Return the picture of the paper's numbers beside ours, if it has been drawn."""
    path = sources.find(f"figures/answer{sources.suffix}.png")
    if path is None:
        return []
    alt = (
        "marks for the paper and for our runs: on the left the best alpha of each of the six regions, on the "
        "right the end-point error of TV-L1-SB on each of the eight sequences"
    )
    caption = (
        "The paper's numbers (black) beside ours. Left: the order with the smallest AEPE on each region. Right: "
        f"Table 2. {place(path, sources.results)}, also as PDF and CSV."
    )
    return [picture_file(path, alt, caption)]


def place(path: Path, results: Path) -> str:
    """Return the words of a caption that say which file is shown, and whether it is a committed copy."""
    if path.is_relative_to(results):
        return f"File {code(str(path.relative_to(results)))}"
    return f"Committed copy: {code(f'{COMMITTED}/{path.parent.name}/{path.name}')}"


# -- figures -------------------------------------------------------------------------------------


def figures(sources: Sources, names: Iterable[str]) -> Section:
    """Return those of the experiments that are figures of the paper, drawn from the stored results."""
    blocks: list[Block] = []
    for source in (sources.get(name) for name in names if name.startswith("fig")):
        blocks.append(Heading(source.experiment.title, source.experiment.name))
        blocks += state(source)
        blocks += figures_of(source, sources.results)
    return Section("figures", "Figures", "The figures", blocks)


def figures_of(source: Source, results: Path) -> list[Block]:
    """Return an experiment's figures, or how to draw them once its points are there."""
    found = drawn(source, results)
    if not found and not source.n_missing:
        return [Missing(f"the drawing of {source.experiment.name}", source.command)]
    return found


def drawn(source: Source, results: Path) -> list[Block]:
    """Return an experiment's figures: the user's own, else the committed copies."""
    return [_figure(source, path, variant, results) for variant, path in figure_files(results, source).items()]


def figure_files(results: Path, source: Source) -> dict[str, Path]:
    """Return the PNG files of an experiment's artefact, for this data set and size, by variant.

    The variant is the part of the file's name after the experiment's, e.g. ``context``: ``""``, the figure itself,
    comes first, then the protocols. Where the results folder holds none, the committed copies take their place.
    """
    name, ending = source.experiment.name, source.suffix
    others = tuple(other for other in SUFFIXES if other and other != ending and not ending.endswith(other))
    found: dict[str, Path] = {}
    for home in homes(results):
        paths = [
            path for folder in ("figures", "private") for path in (home / folder).glob(f"{name}*{ending}.png")
        ]
        for path in sorted(paths):
            variant = path.stem.removeprefix(name).removesuffix(ending)
            if not path.stem.endswith(others) and (not variant or variant[0] == "_" != variant[1:2]):
                found[variant.removeprefix("_")] = path
        if found:
            break
    order = ["", *SETTINGS, *found]
    return dict(sorted(found.items(), key=lambda item: order.index(item[0])))


_VARIANTS = {
    "context": "With pixels of image around each region and the boundary `reflect`; the paper has neither.",
    "protocols": "Under each protocol.",
    "classes": "By class of pixels.",
    "scenes": "The scenes, under the colours of their classes.",
    "frames": "The first frames, under the colours of their classes.",
    "parts": "Both parts of the flow and their sum in the colours of one scale, and the share of q in its change.",
    "settings": "Against one setting of the images at a time, and against the local gradient of the true flow.",
    "flows": "By flow: a mark for each method.",
    "orders": "The first frames, under the colours of their classes and of the orders chosen by the true flow.",
}
_ALT = {
    "family": "curves of mean angular and mean end-point error against {x}, a line for each {family}",
    "adaptive_alpha": "gains in end-point error by sequence, and by class of pixels the orders that are best",
    "alpha_by_structure": "curves of the error relative to that at alpha 1, a panel a structure",
    "alpha_regions": "curves of mean angular and mean end-point error against alpha, two panels a region",
    "order_from_flow": "flow in colours: both parts and their sum, and a map of the part that carries the change",
    "fluids": "end-point errors of methods on particle images",
    "frames": "one frame of each of the eight sequences",
    "region_boxes": "frames of the sequences with the boxes of regions A and B drawn on them",
}


def _figure(source: Source, path: Path, variant: str, results: Path) -> Picture:
    experiment = source.experiment
    said = f"Protocol `{variant}`: {SETTINGS[variant]}." if variant in SETTINGS else _VARIANTS.get(variant, "")
    shows = _ALT.get(experiment.artefact, "drawn from the stored results").format_map(
        {"x": experiment.options.get("x", ""), "family": experiment.options.get("family", "")}
    )
    alt = ", ".join(part for part in (experiment.title, variant, shows) if part)
    return picture_file(path, alt, f"{said} {place(path, results)}, also as PDF.".strip())


def pictures(sources: Sources) -> Section:
    """Return frames, flows and error maps of each sequence."""
    intro = (
        "Each sequence is shown in gray, as the methods see it, with the true flow and three flows computed with "
        "Table 2's λ and θ. The end-point errors of a flow stand below it. The flows of a sequence share one "
        "scale of colours, which reaches a little beyond the largest true motion."
    )
    blocks: list[Block] = [Text(intro)]
    absent = missing_flows(sources)
    if absent:
        blocks.append(Missing(f"{len(absent)} flows", sources.typed("report")))
    shown = [] if absent else scenes(sources)
    top = shared_scale(shown)
    for scene in shown:
        blocks.append(Heading(scene.name, f"pictures-{scene.name.replace(' ', '-')}"))
        blocks.append(gallery(scene, top))
    return Section("pictures", "Flows", "Flows and their errors", blocks)


def state(source: Source) -> list[Block]:
    """Name the missing and the failed points of an experiment; nothing if it is complete."""
    name = source.experiment.name
    blocks: list[Block] = []
    if source.n_missing:
        some = "all" if source.n_missing == source.n_points else str(source.n_missing)
        blocks.append(Missing(f"{some} of the {source.n_points} points of {name}", source.command))
    if source.unfinished:
        bad = source.unfinished
        first = plain(str(bad[0].error))
        blocks.append(Text(f"{len(bad)} points of {name} failed or diverged; the first: {first}", "answer"))
    return blocks
