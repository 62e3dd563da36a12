"""`fracbench config`, `--cfg`, the examples of the help, and completion in a shell."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from fracbench.commands.options import EXAMPLES, build_parser
from fracbench.errors import InputError
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run.plan import make_plan

GRID = ["alpha=1,1.2", "sequence=synthetic_edge", "noise=0,1", "n_warps=3"]


def test_the_configuration_is_that_of_the_points(cli, work):
    text = cli("config", *GRID).out
    assert text.startswith(f"# {' '.join(GRID)}; 4 points\n")
    shown = yaml.safe_load(text)
    assert shown["sequence"] == "synthetic_edge" and shown["noise"] == [0, 1]
    assert shown["parallel"]["jobs"] == 2 and shown["paths"]["results"] == "results"
    for planned in make_plan(GRID).points:
        for key, value in planned.point.canonical.items():
            given = shown["params"][key]
            assert yaml.safe_load(str(value)) in (given if isinstance(given, list) else [given]), key
    assert shown["params"]["alpha"] == [1, 1.2] and shown["params"]["n_warps"] == 3
    assert not Path("results").exists()


@pytest.mark.parametrize(
    "command", [["sweep", *GRID], ["experiment", "order_from_flow", "dataset=synthetic"], ["table", "2"]]
)
def test_cfg_prints_it_and_computes_nothing(cli, work, command):
    done = cli(*command, "--cfg", *(["dataset=synthetic"] if command[0] == "table" else []))
    assert done.code == 0 and "method:" in done.out and "params:" in done.out
    assert not Path("results").exists()


def test_an_experiment_without_a_grid_shows_its_options(cli, work):
    assert "options:\n" in cli("config", "convergence").out


def test_an_experiment_is_shown_grid_by_grid(cli, work):
    Path("experiments").mkdir()
    Path("experiments/mine.yaml").write_text(
        "grids:\n  a: [sequence=synthetic_edge]\n  b: [sequence=synthetic_flat]\n"
    )
    parts = [*yaml.safe_load_all(cli("config", "mine").out.replace("# b:", "---\n# b:"))]
    assert [part["sequence"] for part in parts] == ["synthetic_edge", "synthetic_flat"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["table22"], "unknown experiment 'table22': did you mean 'table2'"),
        (["table1", "table2"], "config takes the name of one experiment, got table1 and table2"),
        (["table2", "alpha=1"], "an experiment fixes its own grid"),
        (["alhpa=1"], "unknown key 'alhpa': did you mean 'alpha'"),
    ],
)
def test_bad_words_are_refused(cli, work, words, message):
    done = cli("config", *words)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1


@pytest.mark.parametrize("command", EXAMPLES)
def test_the_help_of_each_command_has_examples_that_are_understood(cli, command):
    said = cli(command, "--help").out
    for words in dict.fromkeys(EXAMPLES[command]):
        line = f"fracbench {command} {words}".rstrip()
        assert f"\n  {line}\n" in f"{said}\n"
        arguments = build_parser().parse_words(shlex.split(line)[1:])
        assert parse_overrides(getattr(arguments, "overrides", [])).size > 0
    assert max(map(len, said.splitlines())) <= 125


def test_every_command_has_examples():
    with pytest.raises(InputError) as caught:
        build_parser().parse_words(["nothing"])
    assert set(re.search(r"allowed: (.+)\)", str(caught.value))[1].split(", ")) == {*EXAMPLES}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("fracbench sw", {"sweep"}),
        ("fracbench sweep lambda_s", {"lambda_sb="}),
        ("fracbench sweep region=grove2_", {"region=grove2_A", "region=grove2_B"}),
        ("fracbench experiment fig1", {"fig1"}),
        ("fracbench sweep --dr", {"--dry-run"}),
    ],
)
def test_a_shell_completes(tmp_path, line, expected):
    pytest.importorskip("argcomplete", reason="needs the extra `completion`")
    words = tmp_path / "words"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(words),
        "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    code = "import sys; sys.argv[0] = 'fracbench'; from fracbench.commands.cli import main; main()"
    subprocess.run([sys.executable, "-c", code], env=environment, check=False, timeout=120, cwd=Path.cwd())
    assert {word.strip() for word in words.read_text().split("\013")} == expected
