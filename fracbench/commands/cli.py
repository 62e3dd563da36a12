"""The command line: one thin function for each subcommand."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
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
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; ``sys.argv`` by default.

    Returns
    -------
    int
        Exit code: 0 done, 1 a check did not hold, 2 bad input, 3 finished but some points failed.
    """
    console.show_log()
    try:
        return _dispatch(list(sys.argv[1:] if argv is None else argv))
    except FracbenchError as exc:
        console.complain(" ".join(str(exc).splitlines()))  # a file's name may hold a line break
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
        command: Callable[[argparse.Namespace], int] = arguments.command
        return command(arguments)
    finally:
        sys.stdout.flush()  # later, nobody could catch the error of a reader that has gone


def console_entry() -> NoReturn:
    """Run the command line and leave with its exit code: the console script."""
    sys.exit(main())


def _build_parser() -> Parser:
    parser = Parser(
        prog="fracbench",
        description="Reproduce, check and extend 'Optical flow with fractional order regularization'.",
        epilog=_EXITS,
    )
    parser.add_argument("--version", action="version", version=f"fracbench {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(
        name: str, command: Callable[[argparse.Namespace], int], text: str, **more: Any
    ) -> argparse.ArgumentParser:
        sub: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text, **more)
        sub.set_defaults(command=command, parser=sub)
        return sub

    # The order is that of `fracbench --help`.
    _add_grids(add)
    _add_paper(add)
    _add_flows(add)
    _add_upkeep(add)
    return parser


_Add = Callable[..., argparse.ArgumentParser]


def _add_grids(add: _Add) -> None:
    _add_overrides(
        add("sweep", _sweep, "run a grid of parameters; write a tidy CSV and a plot", epilog=_GRID_HELP)
    )
    table = add("table", _table, "run what is missing for a table of the paper and write it")
    table.add_argument("number", help="e.g. 2")
    _add_overrides(table)
    figure = add("figure", _figure, "run what is missing for a figure of the paper and draw it")
    figure.add_argument("number", help="e.g. 6")
    _add_overrides(figure)
    experiment = add("experiment", _experiment, "run an experiment of experiments/ and write its artefact")
    experiment.add_argument("name", help="name of the file, without .yaml")
    _add_overrides(experiment)


def _add_paper(add: _Add) -> None:
    report = add("report", _report, "run what is missing of the whole paper; write everything on one HTML page")
    report.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="dataset=, paths. and parallel only")
    report.add_argument("--jobs", type=int, help="worker processes (default: 2)")
    report.add_argument("--dry-run", action="store_true", help="count points and minutes, compute nothing")
    report.add_argument("--timeout", metavar="SECONDS", help=_TIMEOUT)
    report.add_argument("--small", action="store_true", help=_SMALL)
    report.add_argument("--beyond", action="store_true", help="run the experiments beyond the paper instead")
    claims = add("claims", _claims, "judge the paper's claims by what is stored; compute nothing")
    claims.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="dataset= and paths. only")
    claims.add_argument("--small", action="store_true", help="judge the thinned grids")
    claims.add_argument("--readme", type=Path, metavar="FILE", help="renew the answer between the markers in FILE")


def _add_flows(add: _Add) -> None:
    run = add("run", _run, "compute one configured flow; write it as .flo and as a picture")
    _add_overrides(run, grid=False)
    estimate = add("estimate", _estimate, "compute the flow between two images of your own")
    estimate.add_argument("frame0", type=Path)
    estimate.add_argument("frame1", type=Path)
    estimate.add_argument(
        "-o", "--output", type=Path, required=True, help="the flow: .flo, or .png in KITTI's format"
    )
    estimate.add_argument("--color", type=Path, help="colour picture (default: beside the flow, .color.png)")
    estimate.add_argument("--truth", type=Path, help="true flow, .flo or KITTI .png: print the errors")
    estimate.add_argument("--threads", type=int, default=1, help="threads (default: 1)")
    estimate.add_argument("--method", default=None, help="see `fracbench methods`")
    estimate.add_argument(
        "overrides", nargs="*", metavar="KEY=VALUE", help="parameters, e.g. alpha=1.2, or protocol=accurate"
    )


def _add_upkeep(add: _Add) -> None:
    check = add("check", _check, "recompute the stored tables and compare them cell by cell")
    check.add_argument("names", nargs="*", metavar="NAME", help="stored tables (default: all)")
    check.add_argument("--jobs", type=int, default=2, help="worker processes (default: 2)")
    check.add_argument("--update", action="store_true", help="rewrite the stored tables instead")
    check.add_argument("--spread", action="store_true", help="moved to tools/spread.py of a checkout")
    check.add_argument("--reason", default="", help="why they change; recorded beside them")
    status = add("status", _status, "say what is done, failed, stale or missing, and which command goes on")
    status.add_argument("words", nargs="*", metavar="EXPERIMENT|KEY=VALUE", help="default: all; dataset=, paths.")
    status.add_argument("--json", action="store_true", help="print JSON")
    compare = add("compare", _compare, "compare two stores, or the stored tables of two commits, cell by cell")
    for side in ("first", "second"):
        compare.add_argument(side, help="a store or folder of results, STORE@COMMIT, or a commit")
    bench = add("bench", _bench, "time the methods and the peers that are installed, interleaved, warm")
    bench.add_argument("--repeats", type=int, default=5, help="timed rounds; the median counts (default: 5)")
    bench.add_argument("--threads", type=int, default=1, help="of the solver and OpenCV (default: 1)")
    bench.add_argument("--study", choices=["size", "jobs", "roofline"], help="moved to benchmarks/ of a checkout")
    bench.add_argument("--only", default="", metavar="NAME,...", help="contenders, by beginning of name")
    _add_overrides(bench, grid=False)
    data = add("data", _data, "say where the Middlebury data are and whether they are whole; fetch them")
    data.add_argument("--download", action="store_true", help="download what is missing, beside what there is")
    add("methods", _methods, "list the methods and their parameters")


_GRID_HELP = (
    "grid: a:b:step (both ends), 1,2,5, unions 0:1:0.25,1.5, log(1e-3:1:7), range(), choice(), "
    "zip(lambda,theta)=(0.3,0.3),(0.4,0.4); several keys make a product; region=all and "
    "region=grove2_* are globs. " + _EXITS
)


_TIMEOUT = "give a point up whose estimate takes longer (default: no limit)"
_SMALL = "thin every grid, to try it out; the names of files end in _small"


def _add_overrides(parser: argparse.ArgumentParser, *, grid: bool = True) -> None:
    parser.add_argument("overrides", nargs="*", metavar="KEY=GRID" if grid else "KEY=VALUE")
    if grid:
        parser.add_argument("--jobs", type=int, help="worker processes (default: 2)")
        parser.add_argument("--timeout", metavar="SECONDS", help=_TIMEOUT)
        parser.add_argument("--dry-run", action="store_true", help="count points and minutes, compute nothing")
        parser.add_argument("--small", action="store_true", help=_SMALL)
        parser.add_argument("--rerun", choices=["failed"], help="compute points again that failed")


def _sweep(arguments: argparse.Namespace) -> int:
    from fracbench.harness.config.experiment import MAIN, Experiment

    tokens = tuple(arguments.overrides)
    if not tokens:
        raise InputError("sweep: what is to be swept? e.g. fracbench sweep alpha=0:2:0.1 region=grove2_A")
    return _run_experiment(Experiment(_slug(tokens), " ".join(tokens), "sweep", {MAIN: tokens}), (), arguments)


def _slug(tokens: Sequence[str]) -> str:
    """Return a file name for a sweep, distinct for distinct overrides."""
    import hashlib
    import re

    tokens = [token for token in tokens if not token.startswith("parallel")]  # where it runs changes no result
    text = "__".join(re.sub(r"[^\w.=,+-]+", "_", token) for token in tokens if not token.startswith("paths."))
    # Characters are folded and names cut: a digest keeps apart what would fall together.
    digest = hashlib.sha256("\0".join(tokens).encode()).hexdigest()[:8]
    return f"{text[:80]}__{digest}"


def _table(arguments: argparse.Namespace) -> int:
    return _numbered("table", arguments)


def _figure(arguments: argparse.Namespace) -> int:
    return _numbered("fig", arguments)


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
    """Refuse overrides that would change an experiment's grid."""
    if not all(token.startswith(("dataset=", "paths.", "parallel")) for token in overrides):
        raise InputError(
            f"{name}: an experiment fixes its own grid; only dataset=, paths. and parallel can be set "
            "(for anything else: fracbench sweep)"
        )
    return overrides


def _report(arguments: argparse.Namespace) -> int:
    from fracbench.commands import paper

    settings = [*_settings("report", arguments.overrides), *_limit(arguments)]
    failed = paper.report(
        settings,
        jobs=arguments.jobs,
        small=arguments.small,
        dry_run=arguments.dry_run,
        beyond=arguments.beyond,
    )
    return EXIT_FAILED if failed else EXIT_DONE


def _claims(arguments: argparse.Namespace) -> int:
    from fracbench.commands import paper

    settings = _settings("claims", arguments.overrides)
    for line in paper.judge(settings, small=arguments.small, readme=arguments.readme):
        console.say(line)
    return EXIT_DONE


def _run_experiment(experiment: Experiment, settings: Sequence[str], arguments: argparse.Namespace) -> int:
    """Plan, compute what is missing, store, draw."""
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


def _run(arguments: argparse.Namespace) -> int:
    from fracbench.commands import run

    run.run_point(arguments.overrides)
    return EXIT_DONE


def _estimate(arguments: argparse.Namespace) -> int:
    from fracbench.commands import run

    run.estimate_pair(
        arguments.frame0,
        arguments.frame1,
        arguments.output,
        color=arguments.color,
        truth=arguments.truth,
        method=arguments.method,
        threads=arguments.threads,
        overrides=arguments.overrides,
    )
    return EXIT_DONE


def _check(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    if arguments.spread:
        raise InputError("check: --spread has moved: python tools/spread.py [NAME...] [--update], in a checkout")
    if arguments.update:
        maintain.update_references(arguments.names, arguments.reason, jobs=arguments.jobs)
        return EXIT_DONE
    return EXIT_DONE if maintain.check_references(arguments.names, jobs=arguments.jobs) else EXIT_CHECK


def _status(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    _settings("status", [word for word in arguments.words if "=" in word])
    maintain.show_status(arguments.words, as_json=arguments.json)
    return EXIT_DONE


def _compare(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    return EXIT_DONE if maintain.compare_runs(arguments.first, arguments.second) else EXIT_CHECK


def _bench(arguments: argparse.Namespace) -> int:
    from fracbench.commands import bench as benchmarks

    only = [name for name in arguments.only.split(",") if name]
    benchmarks.bench(
        arguments.study, arguments.overrides, repeats=arguments.repeats, threads=arguments.threads, only=only
    )
    return EXIT_DONE


def _data(arguments: argparse.Namespace) -> int:
    from fracbench.data.datasets import middlebury

    if arguments.download:
        middlebury.download(middlebury.download_folder())
    location = middlebury.find()
    console.say(f"Middlebury: {location.folder} (from {location.source})")
    whole = True
    for name in middlebury.SEQUENCES:
        state = middlebury.state(name, location.folder)
        console.say(f"  {name:12s} {state.state}")
        for file in state.files:
            if file.state != "ok":
                console.say(f"    {file.message}")
        whole = whole and state.state == "ok"
    return EXIT_DONE if whole else EXIT_CHECK


def _methods(arguments: argparse.Namespace) -> int:
    from fracbench.methods.registry import METHODS

    for method in METHODS.values():
        console.say(f"{method.name}: {method.label}, {method.summary}")
        console.say(f"    depends on {', '.join(sorted(method.uses))}")
    return EXIT_DONE


if __name__ == "__main__":
    console_entry()
