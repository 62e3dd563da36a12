"""The subcommands with their words and options, in the order of ``fracbench --help``."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fracbench import __version__
from fracbench.commands.parser import Moved, Parser

_Add = Callable[[str, str], argparse.ArgumentParser]

_EXITS = "exit codes: 0 done, 1 a check did not hold, 2 bad input, 3 finished but some points failed"
_GRID_HELP = (
    "A grid is a value (alpha=1.2), a range a:b:step with both ends (0:2:0.1), a list (1,2,5), several of these "
    "(0:1:0.25,1.5), log(1e-3:1:7) for 7 values of constant ratio, or Hydra's range() and choice(). Several keys "
    "give all combinations; zip(lambda,theta)=(0.3,0.3),(0.4,0.4) varies keys together. region=all and "
    f"region=grove2_* choose regions by name ({_EXITS})."
)
_GRID = "keys with their grids, e.g. alpha=0:2:0.1 region=grove2_A"
_SETTINGS = "settings: dataset=NAME, paths.data=FOLDER, paths.results=FOLDER, parallel=NAME, parallel.KEY=VALUE"
_STORED = "settings: dataset=NAME, paths.data=FOLDER, paths.results=FOLDER"
_PARAMETERS = "parameters, e.g. alpha=1.2, or protocol=accurate"
_PROCESSES = "number of worker processes (default: 2)"
_MOVED = "has moved: python {}, in a checkout"

#: Two commands to start from, below the help of each subcommand.
EXAMPLES = {
    "sweep": ("alpha=0:2:0.1 region=grove2_A", "sequence=all method=tvl1,tvl1_sb lambda=log(0.03:3:7) --dry-run"),
    "table": ("2", "2 --small"),
    "figure": ("6", "3 --jobs 4"),
    "experiment": ("accurate --dry-run", "convergence"),
    "report": ("--dry-run", "--only table2,fig6"),
    "claims": ("", "paths.results=results"),
    "run": ("sequence=venus alpha=1.2", "region=grove2_A protocol=published"),
    "config": ("protocol=accurate sequence=venus", "table2"),
    "estimate": ("a.png b.png -o flow.flo", "a.png b.png -o flow.flo protocol=accurate --confidence trust.png"),
    "estimate-sequence": ("clip -o flows", "'clip/*.png' -o flows protocol=fast --jobs 4"),
    "check": ("", "table2 --jobs 4"),
    "status": ("", "alpha_by_structure --json"),
    "compare": ("results/runs other/results/runs", "HEAD~1 HEAD"),
    "bench": ("sequence=venus --repeats 3", "--only fast,opencv_dis"),
    "data": ("", "dataset=folder paths.data=pairs"),
    "warmup": ("", "tvl1_sb_alpha"),
    "methods": ("", ""),
}

_AXES = (
    "Axes of these files: x to the right, y and v up, origin at the lower left corner; pixels, and with --scale "
    "and --dt mm, mm/s and 1/s. Vorticity is positive counter-clockwise."
)

_KEYS: dict[str, Any] = {"nargs": "*", "metavar": "KEY=VALUE"}
_NUMBER: dict[str, Any] = {"type": int, "metavar": "N"}
_FILE: dict[str, Any] = {"type": Path, "metavar": "FILE"}
_METHOD: dict[str, Any] = {"metavar": "NAME", "help": "name of a method, see fracbench methods"}


def build_parser() -> Parser:
    """Return the parser of the command line; `command` in its result is the name of the subcommand."""
    parser = Parser(
        prog="fracbench",
        description="Reproduce, check and extend the paper 'Optical flow with fractional order regularization' "
        "(arXiv:1512.01398). A point is one flow to compute: a method with its parameters on one pair of images. "
        "Finished points are stored, so that no command computes a point twice.",
        epilog=f"fracbench COMMAND --help explains a command; {_EXITS}",
    )
    parser.add_argument("--version", action="version", version=f"fracbench {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(name: str, text: str) -> argparse.ArgumentParser:
        more = f"{_GRID_HELP} " if name == "sweep" else ""
        examples = dict.fromkeys(f"  fracbench {name} {words}".rstrip() for words in EXAMPLES[name])
        sub: Parser = subparsers.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            epilog="\n".join([*textwrap.wrap(more, 78), *([""] if more else []), "examples:", *examples]),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(command=name, parser=sub)
        return sub

    _add_grids(add)
    _add_paper(add)
    _add_flows(add)
    _add_upkeep(add)
    return parser


def _add_grids(add: _Add) -> None:
    sweep = add("sweep", "compute all points of a grid of parameters; write a CSV and a plot")
    _add_points(sweep, _GRID, "KEY=GRID")
    table = add("table", "compute a table of the paper and write it")
    table.add_argument("number", help="number of the table, e.g. 2")
    figure = add("figure", "compute a figure of the paper and draw it")
    figure.add_argument("number", help="number of the figure, e.g. 6")
    experiment = add("experiment", "compute an experiment of experiments/; write its tables and figures")
    experiment.add_argument("name", help="name of the experiment's file, without .yaml")
    for parser in (table, figure, experiment):
        _add_points(parser, _SETTINGS)


def _add_points(
    parser: argparse.ArgumentParser, text: str, metavar: str = "KEY=VALUE", *, rerun: bool = True
) -> None:
    parser.add_argument("overrides", nargs="*", metavar=metavar, help=text)
    parser.add_argument("--jobs", help=_PROCESSES, **_NUMBER)
    parser.add_argument(
        "--timeout", metavar="SECONDS", help="stop each point that takes longer (default: no limit)"
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print the number of points and the expected minutes; compute nothing",
    )
    parser.add_argument("--cfg", action="store_true", help="print the configuration; compute nothing")
    parser.add_argument(
        "--small", action="store_true", help="try few values of each grid; the names of the files end in _small"
    )
    if rerun:
        parser.add_argument("--rerun", choices=["failed"], help="recompute the points that failed before")


def _add_paper(add: _Add) -> None:
    report = add("report", "compute the whole paper, judge its claims and write one HTML page")
    _add_points(report, _SETTINGS, rerun=False)
    report.add_argument("--beyond", action="store_true", help="run the experiments beyond the paper instead")
    report.add_argument("--only", default="", metavar="NAME,...", help="compute these experiments alone")
    claims = add("claims", "judge the paper's claims by the stored results; compute nothing")
    claims.add_argument("overrides", help=_STORED, **_KEYS)
    claims.add_argument("--small", action="store_true", help="judge the results of report --small")
    claims.add_argument("--readme", help="renew the text between the answer's markers in FILE", **_FILE)


def _add_flows(add: _Add) -> None:
    run = add("run", "compute one flow of a data set; write it as .flo and as a colour picture")
    run.add_argument("overrides", help="sequence, method, parameters, e.g. sequence=venus alpha=1.2", **_KEYS)
    config = add("config", "print the configuration that these words stand for; compute nothing")
    config.add_argument(
        "words", nargs="*", metavar="NAME|KEY=GRID", help="keys with their grids, or the name of one experiment"
    )
    estimate = add("estimate", "compute the flow between two images of your own")
    estimate.add_argument("frame0", type=Path, help="first image")
    estimate.add_argument("frame1", type=Path, help="second image, of the same size")
    estimate.add_argument("overrides", help=_PARAMETERS, **_KEYS)
    estimate.add_argument(
        "-o", "--output", required=True, help="file of the flow: .flo, or .png in KITTI's format", **_FILE
    )
    estimate.add_argument("--color", help="colour picture (default: beside the flow, NAME.color.png)", **_FILE)
    estimate.add_argument("--truth", help="true flow, .flo or KITTI's .png; prints the errors", **_FILE)
    estimate.add_argument(
        "--mask", help="picture that is not black where the frames' pixels do not count", **_FILE
    )
    estimate.add_argument("--initial-flow", help="flow to start from, .flo or KITTI's .png", **_FILE)
    estimate.add_argument("--confidence", help="picture of the trust in each pixel; doubles the time", **_FILE)
    _add_field(estimate)
    estimate.add_argument("--threads", default=1, help="number of threads (default: 1)", **_NUMBER)
    estimate.add_argument("--method", **_METHOD)
    clip = add("estimate-sequence", "compute the flows of a clip, from each frame to the next")
    clip.add_argument("frames", nargs="+", metavar="FRAMES", help="images, folders, globs in quotes, or one video")
    clip.add_argument("overrides", help=_PARAMETERS, **_KEYS)
    clip.add_argument(
        "-o", "--output", required=True, type=Path, metavar="FOLDER", help="folder of the flows and their pictures"
    )
    clip.add_argument("--jobs", default=2, help=_PROCESSES, **_NUMBER)
    clip.add_argument("--method", **_METHOD)
    clip.add_argument(
        "--max-motion", type=float, metavar="PX", help="speed of the full colours (default: from the flows)"
    )
    clip.add_argument("--pairs", action="store_true", help="frames 1 and 2, 3 and 4, ... are pairs, as in PIV")
    clip.add_argument(
        "--mask", help="picture that is not black where the pixels of all frames do not count", **_FILE
    )
    axes = textwrap.fill(f"One file a flow, on one colour scale. {_AXES}", 78)
    field = clip.add_argument_group("velocity fields", axes)
    field.add_argument("--arrows", action="store_true", help="write NAME.arrows.png: arrows over the magnitude")
    field.add_argument("--vorticity", action="store_true", help="write NAME.vorticity.png")
    field.add_argument("--csv", action="store_true", help="write NAME.csv with OpenPIV's columns")
    field.add_argument("--netcdf", action="store_true", help="write NAME.nc, all pixels (extra piv)")
    _add_units(field)


def _add_field(estimate: argparse.ArgumentParser) -> None:
    field = estimate.add_argument_group("velocity field, e.g. of particle images", textwrap.fill(_AXES, 78))
    field.add_argument("--arrows", help="arrows over the magnitude, .png or .pdf", **_FILE)
    field.add_argument("--vorticity", help="colour picture of the vorticity, .png or .pdf", **_FILE)
    field.add_argument(
        "--csv",
        help="table with OpenPIV's columns: x, y, u, v, flags (1: with --confidence, the flow back disagrees), "
        "mask; .csv has commas, .txt is the file of openpiv.tools.save (tabs, '# ' before the names)",
        **_FILE,
    )
    field.add_argument("--netcdf", help="all pixels, .nc by the CF conventions (extra piv)", **_FILE)
    _add_units(field)


def _add_units(field: argparse._ArgumentGroup) -> None:
    field.add_argument("--grid", type=int, metavar="PX", help="step of arrows and table (default: 16)")
    field.add_argument("--scale", type=float, metavar="MM_PER_PX", help="size of a pixel in mm")
    field.add_argument("--dt", type=float, metavar="SECONDS", help="time from the first image to the second")


def _add_upkeep(add: _Add) -> None:
    check = add("check", "recompute the stored tables of results/reference and compare them cell by cell")
    check.add_argument("names", nargs="*", metavar="NAME", help="stored tables (default: all)")
    check.add_argument("--jobs", default=2, help=_PROCESSES, **_NUMBER)
    check.add_argument("--update", action="store_true", help="rewrite the stored tables instead; needs --reason")
    check.add_argument("--reason", default="", metavar="TEXT", help="why the numbers change; stored beside them")
    spread = "tools/spread.py [NAME...] [--update]"
    check.add_argument(
        "--spread", nargs=0, help=_MOVED.format("tools/spread.py"), action=Moved, const={"": spread}
    )
    status = add("status", "show how far experiments are, and the commands that resume them")
    status.add_argument(
        "words", nargs="*", metavar="NAME|KEY=VALUE", help=f"names of experiments (default: all); {_STORED}"
    )
    status.add_argument("--json", action="store_true", help="print JSON instead of a table")
    compare = add("compare", "compare two stores, or the stored tables of two commits, cell by cell")
    for side in ("first", "second"):
        compare.add_argument(
            side, help="a store of results or its folder, STORE@COMMIT for the rows of one commit, or a commit"
        )
    bench = add("bench", "measure the speed of our methods and of the installed peers (OpenCV, scikit-image)")
    bench.add_argument("overrides", help="e.g. sequence=venus (default: all)", **_KEYS)
    bench.add_argument("--repeats", default=5, help="timed rounds; the median counts (default: 5)", **_NUMBER)
    bench.add_argument("--threads", default=1, help="threads of the solver and of OpenCV (default: 1)", **_NUMBER)
    bench.add_argument(
        "--only", default="", metavar="NAME,...", help="only contenders whose names begin with one of these"
    )
    scripts = {"size": "benchmarks/growth.py", "jobs": "benchmarks/jobs.py", "roofline": "benchmarks/roofline.py"}
    bench.add_argument(
        "--study", choices=[*scripts], help=_MOVED.format("benchmarks/STUDY.py"), action=Moved, const=scripts
    )
    data = add("data", "list the datasets, show where their files are, and check those of Middlebury")
    data.add_argument("overrides", help="dataset=NAME and paths.data=FOLDER", **_KEYS)
    data.add_argument("--download", action="store_true", help="download Middlebury's missing files first")
    warmup = add("warmup", "compile the solver now, e.g. while an image of a container is built")
    warmup.add_argument("methods", nargs="*", metavar="METHOD", help="default: all of our own")
    add("methods", "list the methods and the parameters that each depends on")
