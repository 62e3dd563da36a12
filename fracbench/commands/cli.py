"""The command line: one thin function for each subcommand."""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from fracbench import __version__
from fracbench.commands import console
from fracbench.commands.parser import Parser
from fracbench.errors import RESUME, FracbenchError, InputError

if TYPE_CHECKING:
    from fracbench.harness.config.experiment import Experiment

EXIT_DONE, EXIT_CHECK, EXIT_INPUT, EXIT_FAILED = 0, 1, 2, 3
EXIT_INTERRUPTED = 130  # what a shell reports for SIGINT
_EXITS = "exit codes: 0 done, 1 a check did not hold, 2 bad input, 3 finished but some points failed"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line with `argv` (default: the program's arguments) and return its exit code."""
    console.show_log()
    try:
        return _dispatch(list(sys.argv[1:] if argv is None else argv))
    except FracbenchError as exc:
        console.complain(str(exc))
        return EXIT_INPUT
    except KeyboardInterrupt:
        console.complain(f"interrupted; {RESUME}")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone, e.g. `| head`: not an error, but nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE


def _dispatch(argv: list[str]) -> int:
    try:
        arguments = _build_parser().parse_words(argv)
        command: Callable[[argparse.Namespace], int | None] = arguments.command
        return command(arguments) or EXIT_DONE
    finally:
        sys.stdout.flush()  # later, nobody could catch the error of a reader that has gone


def console_entry() -> NoReturn:
    """Run the command line and leave with its exit code: the console script."""
    sys.exit(main())


_Add = Callable[..., argparse.ArgumentParser]


def _build_parser() -> Parser:
    parser = Parser(
        prog="fracbench",
        description="Reproduce, check and extend the paper 'Optical flow with fractional order regularization' "
        "(arXiv:1512.01398). A point is one flow to compute: a method with its parameters on one pair of images. "
        "Finished points are stored, so that no command computes a point twice.",
        epilog=f"fracbench COMMAND --help explains a command; {_EXITS}",
    )
    parser.add_argument("--version", action="version", version=f"fracbench {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(name: str, command: Callable[[argparse.Namespace], int | None], text: str, **more: Any) -> Any:
        sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", **more)
        sub.set_defaults(command=command, parser=sub)
        return sub

    # The order is that of `fracbench --help`.
    _add_grids(add)
    _add_paper(add)
    _add_flows(add)
    _add_upkeep(add)
    return parser


_GRID_HELP = (
    "A grid is a value (alpha=1.2), a range a:b:step with both ends (0:2:0.1), a list (1,2,5), several of these "
    "(0:1:0.25,1.5), log(1e-3:1:7) for 7 values of constant ratio, or Hydra's range() and choice(). Several keys "
    "give all combinations; zip(lambda,theta)=(0.3,0.3),(0.4,0.4) varies keys together. region=all and "
    f"region=grove2_* choose regions by name ({_EXITS})."
)
_GRID = "keys with their grids, e.g. alpha=0:2:0.1 region=grove2_A"
_SETTINGS = "settings: dataset=NAME, paths.data=FOLDER, paths.results=FOLDER, parallel=NAME, parallel.KEY=VALUE"
_STORED = "settings: dataset=NAME, paths.data=FOLDER, paths.results=FOLDER"


def _add_grids(add: _Add) -> None:
    sweep = add(
        "sweep", _sweep, "compute all points of a grid of parameters; write a CSV and a plot", epilog=_GRID_HELP
    )
    _add_points(sweep, _GRID, "KEY=GRID")
    table = add("table", partial(_numbered, "table"), "compute a table of the paper and write it")
    table.add_argument("number", help="number of the table, e.g. 2")
    figure = add("figure", partial(_numbered, "fig"), "compute a figure of the paper and draw it")
    figure.add_argument("number", help="number of the figure, e.g. 6")
    experiment = add(
        "experiment", _experiment, "compute an experiment of experiments/; write its tables and figures"
    )
    experiment.add_argument("name", help="name of the experiment's file, without .yaml")
    for parser in (table, figure, experiment):
        _add_points(parser, _SETTINGS)


def _add_points(
    parser: argparse.ArgumentParser, text: str, metavar: str = "KEY=VALUE", *, rerun: bool = True
) -> None:
    parser.add_argument("overrides", nargs="*", metavar=metavar, help=text)
    parser.add_argument("--jobs", type=int, metavar="N", help="number of worker processes (default: 2)")
    parser.add_argument(
        "--timeout", metavar="SECONDS", help="stop each point that takes longer (default: no limit)"
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print the number of points and the expected minutes; compute nothing",
    )
    parser.add_argument(
        "--small", action="store_true", help="try few values of each grid; the names of the files end in _small"
    )
    if rerun:
        parser.add_argument("--rerun", choices=["failed"], help="recompute the points that failed before")


def _add_paper(add: _Add) -> None:
    report = add("report", _report, "compute the whole paper, judge its claims and write one HTML page")
    _add_points(report, _SETTINGS, rerun=False)
    report.add_argument("--beyond", action="store_true", help="run the experiments beyond the paper instead")
    report.add_argument("--only", default="", metavar="NAME,...", help="compute these experiments alone")
    claims = add("claims", _claims, "judge the paper's claims by the stored results; compute nothing")
    claims.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help=_STORED)
    claims.add_argument("--small", action="store_true", help="judge the results of report --small")
    claims.add_argument(
        "--readme", type=Path, metavar="FILE", help="renew the text between the answer's markers in FILE"
    )


def _add_flows(add: _Add) -> None:
    run = add("run", _run, "compute one flow of a data set; write it as .flo and as a colour picture")
    run.add_argument(
        "overrides",
        nargs="*",
        metavar="KEY=VALUE",
        help="sequence, method, parameters, e.g. sequence=venus alpha=1.2",
    )
    estimate = add("estimate", _estimate, "compute the flow between two images of your own")
    estimate.add_argument("frame0", type=Path, help="first image")
    estimate.add_argument("frame1", type=Path, help="second image, of the same size")
    estimate.add_argument(
        "overrides", nargs="*", metavar="KEY=VALUE", help="parameters, e.g. alpha=1.2, or protocol=accurate"
    )
    file: dict[str, Any] = {"type": Path, "metavar": "FILE"}
    estimate.add_argument(
        "-o", "--output", required=True, help="file of the flow: .flo, or .png in KITTI's format", **file
    )
    estimate.add_argument("--color", help="colour picture (default: beside the flow, NAME.color.png)", **file)
    estimate.add_argument("--truth", help="true flow, .flo or KITTI's .png; prints the errors", **file)
    estimate.add_argument("--mask", help="picture that is not black where the frames' pixels do not count", **file)
    estimate.add_argument("--initial-flow", help="flow to start from, .flo or KITTI's .png", **file)
    estimate.add_argument("--confidence", help="picture of the trust in each pixel; doubles the time", **file)
    estimate.add_argument("--threads", type=int, default=1, metavar="N", help="number of threads (default: 1)")
    estimate.add_argument("--method", metavar="NAME", help="name of a method, see fracbench methods")
    clip = add(
        "estimate-sequence",
        _estimate_sequence,
        "compute the flows of a clip, from each frame to the next",
    )
    clip.add_argument("frames", nargs="+", metavar="FRAMES", help="images, folders, globs in quotes, or one video")
    clip.add_argument(
        "overrides", nargs="*", metavar="KEY=VALUE", help="parameters, e.g. alpha=1.2, or protocol=accurate"
    )
    clip.add_argument(
        "-o", "--output", required=True, type=Path, metavar="FOLDER", help="folder of the flows and their pictures"
    )
    clip.add_argument("--jobs", type=int, default=2, metavar="N", help="number of worker processes (default: 2)")
    clip.add_argument("--method", metavar="NAME", help="name of a method, see fracbench methods")
    clip.add_argument(
        "--max-motion", type=float, metavar="PX", help="speed of the full colours (default: from the flows)"
    )


def _add_upkeep(add: _Add) -> None:
    check = add("check", _check, "recompute the stored tables of results/reference and compare them cell by cell")
    check.add_argument("names", nargs="*", metavar="NAME", help="stored tables (default: all)")
    check.add_argument("--jobs", type=int, default=2, metavar="N", help="number of worker processes (default: 2)")
    check.add_argument("--update", action="store_true", help="rewrite the stored tables instead; needs --reason")
    check.add_argument("--reason", default="", metavar="TEXT", help="why the numbers change; stored beside them")
    check.add_argument("--spread", action="store_true", help="has moved: python tools/spread.py, in a checkout")
    status = add("status", _status, "show how far experiments are, and the commands that resume them")
    status.add_argument(
        "words", nargs="*", metavar="NAME|KEY=VALUE", help=f"names of experiments (default: all); {_STORED}"
    )
    status.add_argument("--json", action="store_true", help="print JSON instead of a table")
    compare = add("compare", _compare, "compare two stores, or the stored tables of two commits, cell by cell")
    for side in ("first", "second"):
        compare.add_argument(
            side, help="a store of results or its folder, STORE@COMMIT for the rows of one commit, or a commit"
        )
    bench = add(
        "bench", _bench, "measure the speed of our methods and of the installed peers (OpenCV, scikit-image)"
    )
    bench.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="e.g. sequence=venus (default: all)")
    bench.add_argument(
        "--repeats", type=int, default=5, metavar="N", help="timed rounds; the median counts (default: 5)"
    )
    bench.add_argument(
        "--threads", type=int, default=1, metavar="N", help="threads of the solver and of OpenCV (default: 1)"
    )
    bench.add_argument(
        "--only", default="", metavar="NAME,...", help="only contenders whose names begin with one of these"
    )
    moved = "has moved: python benchmarks/STUDY.py, in a checkout"
    bench.add_argument("--study", choices=["size", "jobs", "roofline"], help=moved)
    data = add("data", _data, "list the datasets, show where their files are, and check those of Middlebury")
    data.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="dataset=NAME and paths.data=FOLDER")
    data.add_argument("--download", action="store_true", help="download Middlebury's missing files first")
    warmup = add("warmup", _warmup, "compile the solver now, e.g. while an image of a container is built")
    warmup.add_argument("methods", nargs="*", metavar="METHOD", help="default: all of our own")
    add("methods", _methods, "list the methods and the parameters that each depends on")


def _sweep(arguments: argparse.Namespace) -> int:
    from fracbench.harness.config.experiment import MAIN, Experiment

    tokens = tuple(arguments.overrides)
    if not tokens:
        raise InputError("sweep: what is to be swept? e.g. fracbench sweep alpha=0:2:0.1 region=grove2_A")
    return _run_experiment(Experiment(_slug(tokens), " ".join(tokens), "sweep", {MAIN: tokens}), (), arguments)


def _slug(tokens: Sequence[str]) -> str:
    """Return a file name for a sweep, distinct for distinct overrides."""
    tokens = [token for token in tokens if not token.startswith("parallel")]  # where it runs changes no result
    text = "__".join(re.sub(r"[^\w.=,+-]+", "_", token) for token in tokens if not token.startswith("paths."))
    # Characters are folded and names cut: a digest keeps apart what would fall together.
    digest = hashlib.sha256("\0".join(tokens).encode()).hexdigest()[:8]
    return f"{text[:80]}__{digest}"


def _numbered(kind: str, arguments: argparse.Namespace) -> int:
    from fracbench.harness.config.experiment import list_experiments

    known = [name.removeprefix(kind) for name in list_experiments() if name.removeprefix(kind).isdigit()]
    if arguments.number not in known:
        word = "table" if kind == "table" else "figure"
        raise InputError(f"there is no {word} {arguments.number!r} (allowed: {', '.join(known)})")
    arguments.name = f"{kind}{arguments.number}"
    return _experiment(arguments)


def _experiment(arguments: argparse.Namespace) -> int:
    from fracbench.harness.config.experiment import load_experiment

    experiment = load_experiment(arguments.name)
    return _run_experiment(experiment, _settings(arguments.name, arguments.overrides), arguments)


def _settings(name: str, overrides: Sequence[str]) -> Sequence[str]:
    """Return the overrides; refuse those that would change an experiment's grid."""
    if not all(token.startswith(("dataset=", "paths.", "parallel")) for token in overrides):
        raise InputError(
            f"{name}: an experiment fixes its own grid; only dataset=, paths. and parallel can be set "
            "(for anything else: fracbench sweep)"
        )
    return overrides


def _run_experiment(experiment: Experiment, settings: Sequence[str], arguments: argparse.Namespace) -> int:
    from fracbench.commands import run

    failed = run.run_experiment(
        experiment,
        [*settings, *_limit(arguments)],
        jobs=arguments.jobs,
        dry_run=arguments.dry_run,
        rerun_failed=arguments.rerun == "failed",
        small=arguments.small,
    )
    return EXIT_FAILED if failed else EXIT_DONE


def _limit(arguments: argparse.Namespace) -> list[str]:
    return [] if arguments.timeout is None else [f"parallel.timeout={arguments.timeout}"]


def _report(arguments: argparse.Namespace) -> int:
    from fracbench.commands import paper

    failed = paper.report(
        [*_settings("report", arguments.overrides), *_limit(arguments)],
        jobs=arguments.jobs,
        small=arguments.small,
        dry_run=arguments.dry_run,
        beyond=arguments.beyond,
        only=[name for name in arguments.only.split(",") if name],
    )
    return EXIT_FAILED if failed else EXIT_DONE


def _claims(arguments: argparse.Namespace) -> None:
    from fracbench.commands import paper

    settings = _settings("claims", arguments.overrides)
    for line in paper.judge(settings, small=arguments.small, readme=arguments.readme):
        console.say(line)


def _run(arguments: argparse.Namespace) -> None:
    from fracbench.commands import run

    run.run_point(arguments.overrides)


def _estimate(arguments: argparse.Namespace) -> None:
    from fracbench.commands.estimate import estimate_pair

    estimate_pair(
        arguments.frame0,
        arguments.frame1,
        arguments.output,
        color=arguments.color,
        truth=arguments.truth,
        mask=arguments.mask,
        initial_flow=arguments.initial_flow,
        confidence=arguments.confidence,
        method=arguments.method,
        threads=arguments.threads,
        overrides=arguments.overrides,
    )


def _estimate_sequence(arguments: argparse.Namespace) -> int:
    from fracbench.commands.estimate_sequence import estimate_sequence

    # argparse gives all words up to the first option to the frames
    settings = [word for word in arguments.frames if "=" in word and not os.path.lexists(word)]
    whole = estimate_sequence(
        [word for word in arguments.frames if word not in settings],
        arguments.output,
        overrides=[*settings, *arguments.overrides],
        method=arguments.method,
        jobs=arguments.jobs,
        max_motion=arguments.max_motion,
    )
    return EXIT_DONE if whole else EXIT_FAILED


def _check(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    if arguments.spread:
        raise InputError("check: --spread has moved: python tools/spread.py [NAME...] [--update], in a checkout")
    if arguments.update:
        maintain.update_references(arguments.names, arguments.reason, jobs=arguments.jobs)
        return EXIT_DONE
    return EXIT_DONE if maintain.check_references(arguments.names, jobs=arguments.jobs) else EXIT_CHECK


def _status(arguments: argparse.Namespace) -> None:
    from fracbench.commands import maintain

    _settings("status", [word for word in arguments.words if "=" in word])
    maintain.show_status(arguments.words, as_json=arguments.json)


def _compare(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    return EXIT_DONE if maintain.compare_runs(arguments.first, arguments.second) else EXIT_CHECK


def _bench(arguments: argparse.Namespace) -> int:
    from fracbench.commands.bench import bench

    only = [name for name in arguments.only.split(",") if name]
    whole = bench(
        arguments.study, arguments.overrides, repeats=arguments.repeats, threads=arguments.threads, only=only
    )
    return EXIT_DONE if whole else EXIT_FAILED


def _data(arguments: argparse.Namespace) -> int:
    from fracbench.commands import data

    whole = data.show(arguments.overrides, download=arguments.download)
    return EXIT_DONE if whole else EXIT_CHECK


def _warmup(arguments: argparse.Namespace) -> None:
    from fracbench.commands.warmup import warmup

    warmup(arguments.methods)


def _methods(_: argparse.Namespace) -> None:
    from fracbench.methods.registry import all_methods

    methods, unusable = all_methods()
    for method in methods:
        console.say(f"{method.name}: {method.label}, {method.summary}")
        if method.package:
            console.say(f"    from {method.package} {method.release}, version {method.version or 'not given'}")
        console.say(f"    depends on {', '.join(sorted(method.uses)) or 'no parameters'}")
    for line in unusable:
        console.say(f"cannot be used: {line}")


if __name__ == "__main__":
    console_entry()
