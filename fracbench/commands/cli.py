"""The command line: one thin function for each subcommand."""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NoReturn

from fracbench.commands import console
from fracbench.commands.options import build_parser
from fracbench.commands.parser import complete
from fracbench.errors import RESUME, FracbenchError, InputError

if TYPE_CHECKING:
    from fracbench.harness.config.experiment import Experiment

EXIT_DONE, EXIT_CHECK, EXIT_INPUT, EXIT_FAILED = 0, 1, 2, 3
EXIT_INTERRUPTED = 130  # as a shell reports SIGINT


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
        # The reader of our output has gone, e.g. `| head`: no error, but nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE


def _dispatch(argv: list[str]) -> int:
    try:
        parser = build_parser()
        if "_ARGCOMPLETE" in os.environ:  # a shell asks for the words that may follow
            complete(parser)
        arguments = parser.parse_words(argv)
        return _COMMANDS[arguments.command](arguments) or EXIT_DONE
    finally:
        sys.stdout.flush()  # later, nobody could catch the error of a reader that has gone


def console_entry() -> NoReturn:
    """Run the command line and leave with its exit code: the console script."""
    sys.exit(main())


def _sweep(arguments: argparse.Namespace) -> int:
    from fracbench.harness.config.experiment import MAIN, Experiment

    tokens = tuple(arguments.overrides)
    if not tokens:
        raise InputError("sweep: name the keys to sweep, e.g. fracbench sweep alpha=0:2:0.1 region=grove2_A")
    return _run_experiment(Experiment(_slug(tokens), " ".join(tokens), "sweep", {MAIN: tokens}), (), arguments)


def _slug(tokens: Sequence[str]) -> str:
    """Return a file name for a sweep, distinct for distinct overrides."""
    tokens = [token for token in tokens if not token.startswith("parallel")]  # where it runs changes no result
    text = "__".join(re.sub(r"[^\w.=,+-]+", "_", token) for token in tokens if not token.startswith("paths."))
    # Characters are replaced and names cut: a digest tells sweeps of the same name apart.
    digest = hashlib.sha256(os.fsencode("\0".join(tokens))).hexdigest()[:8]
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

    if arguments.cfg:
        run.show_config(experiment, settings)
        return EXIT_DONE
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


def _config(arguments: argparse.Namespace) -> None:
    from fracbench.commands import run
    from fracbench.harness.config.experiment import MAIN, Experiment, load_experiment

    names = [word for word in arguments.words if "=" not in word]
    if len(names) > 1:
        raise InputError(f"config takes the name of one experiment, got {' and '.join(names)}")
    keys = tuple(word for word in arguments.words if "=" in word)
    if names:
        run.show_config(load_experiment(names[0]), _settings(names[0], keys))
    else:
        run.show_config(Experiment("config", "", "sweep", {MAIN: keys}), ())


def _estimate(arguments: argparse.Namespace) -> None:
    from fracbench.commands.estimate import estimate_pair
    from fracbench.commands.field_output import FieldFiles, Units

    estimate_pair(
        arguments.frame0,
        arguments.frame1,
        arguments.output,
        color=arguments.color,
        truth=arguments.truth,
        mask=arguments.mask,
        initial_flow=arguments.initial_flow,
        confidence=arguments.confidence,
        fields=FieldFiles(arguments.arrows, arguments.vorticity, arguments.csv, arguments.netcdf),
        units=Units(arguments.scale, arguments.dt, arguments.grid),
        method=arguments.method,
        threads=arguments.threads,
        overrides=arguments.overrides,
    )


def _estimate_sequence(arguments: argparse.Namespace) -> int:
    from fracbench.commands.estimate_sequence import estimate_sequence
    from fracbench.commands.field_output import SequenceFields, Units

    units = Units(arguments.scale, arguments.dt, arguments.grid)
    kinds = (arguments.arrows, arguments.vorticity, arguments.csv, arguments.netcdf)
    # argparse gives all words up to the first option to the frames
    settings = [word for word in arguments.frames if "=" in word and not os.path.lexists(word)]
    whole = estimate_sequence(
        [word for word in arguments.frames if word not in settings],
        arguments.output,
        overrides=[*settings, *arguments.overrides],
        method=arguments.method,
        jobs=arguments.jobs,
        max_motion=arguments.max_motion,
        paired=arguments.pairs,
        mask=arguments.mask,
        fields=SequenceFields(*kinds, units),
    )
    return EXIT_DONE if whole else EXIT_FAILED


def _check(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    if arguments.update:
        maintain.update_references(arguments.names, arguments.reason, jobs=arguments.jobs)
        return EXIT_DONE
    return EXIT_DONE if maintain.check_references(arguments.names, jobs=arguments.jobs) else EXIT_CHECK


def _status(arguments: argparse.Namespace) -> None:
    from fracbench.commands import maintain

    settings = _settings("status", [word for word in arguments.words if "=" in word])
    names = [word for word in arguments.words if "=" not in word]
    maintain.show_status(names, settings, as_json=arguments.json)


def _compare(arguments: argparse.Namespace) -> int:
    from fracbench.commands import maintain

    return EXIT_DONE if maintain.compare_runs(arguments.first, arguments.second) else EXIT_CHECK


def _bench(arguments: argparse.Namespace) -> int:
    from fracbench.commands.bench import bench

    only = [name for name in arguments.only.split(",") if name]
    whole = bench(arguments.overrides, repeats=arguments.repeats, threads=arguments.threads, only=only)
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


_COMMANDS: dict[str, Callable[[argparse.Namespace], int | None]] = {
    "sweep": _sweep,
    "table": partial(_numbered, "table"),
    "figure": partial(_numbered, "fig"),
    "experiment": _experiment,
    "report": _report,
    "claims": _claims,
    "run": _run,
    "config": _config,
    "estimate": _estimate,
    "estimate-sequence": _estimate_sequence,
    "check": _check,
    "status": _status,
    "compare": _compare,
    "bench": _bench,
    "data": _data,
    "warmup": _warmup,
    "methods": _methods,
}


if __name__ == "__main__":
    console_entry()
