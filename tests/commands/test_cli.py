"""The command line as a user sees it: output, messages, files and exit codes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from numba import config
from PIL import Image

import fracbench
from fracbench import api, estimate_flow
from fracbench.commands.cli import EXIT_CHECK, EXIT_DONE, EXIT_FAILED, EXIT_INPUT
from fracbench.commands.console import COMPILING
from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.data.files import read_flow, read_image, write_image
from fracbench.errors import RESUME
from fracbench.evaluation.derivatives import derivatives
from fracbench.evaluation.metrics import flow_errors
from fracbench.harness.check.tolerances import MEASURED
from fracbench.harness.config.paths import asset
from fracbench.harness.run import sweep
from fracbench.harness.run.pool import LocalPool
from fracbench.harness.run.store import STORE, Store, decode, encode
from fracbench.methods.registry import METHODS

COMMANDS = ("sweep", "table", "figure", "experiment", "run", "estimate", "check", "data", "warmup", "methods")
NAMES_ONLY = "boundary=zero,reflect"  # no figures


def tree(folder: Path) -> list[str]:
    """Every file and folder below a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def python(*arguments, cwd, **environment):
    """Run Python in another process, which finds the package that is tested here."""
    given = {**os.environ, "PYTHONPATH": str(Path(fracbench.__file__).parents[1]), **environment}
    given.pop("PYTHONUNBUFFERED", None)
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=cwd, env=given, capture_output=True, text=True
    )


# -- help and start-up ---------------------------------------------------------------------------


def test_help_lists_all_commands_and_exit_codes(work):
    done = python("-m", "fracbench", "--help", cwd=work)
    assert (done.returncode, done.stderr) == (0, "")
    for command in COMMANDS:
        assert re.search(rf"^    {command}\b", done.stdout, re.MULTILINE)
    assert "exit codes: 0 done, 1 a check did not hold, 2 bad input, 3" in " ".join(done.stdout.split())
    assert tree(work) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_of_its_own(cli, command):
    done = cli(command, "--help")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(f"usage: fracbench {command}")


def test_the_grammar_of_grids_is_in_the_help(cli):
    said = " ".join(cli("sweep", "--help").out.split())
    for form in ("a:b:step", "log(1e-3:1:7)", "zip(lambda,theta)=(0.3,0.3),(0.4,0.4)", "region=all"):
        assert form in said


def test_the_version_is_told(cli):
    assert cli("--version").out == f"fracbench {fracbench.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (["--help"], ("numba", "scipy", "pandas", "matplotlib", "joblib", "hydra", "PIL", "pooch")),
        (
            ["sweep", "alpha=0:2:0.1", "sequence=synthetic_flat", "--dry-run"],
            ("numba", "scipy", "pandas", "matplotlib", "joblib", "PIL", "pooch"),
        ),
    ],
)
def test_quick_commands_import_nothing_heavy(work, arguments, heavy):
    code = (
        "import sys\nfrom fracbench.commands.cli import main\n"
        f"try:\n    code = main({arguments!r})\nexcept SystemExit as exc:\n    code = exc.code\n"
        f"print('loaded', [name for name in {heavy!r} if name in sys.modules], code, file=sys.stderr)"
    )
    assert python("-c", code, cwd=work).stderr == "loaded [] 0\n"


@pytest.mark.parametrize("arguments", [["--help"], ["methods"]])
def test_a_reader_that_has_gone_is_no_error(work, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    environment = {**os.environ, "PYTHONPATH": str(Path(fracbench.__file__).parents[1])}
    environment.pop("PYTHONUNBUFFERED", None)
    command = [sys.executable, "-m", "fracbench", *arguments]
    done = subprocess.run(command, cwd=work, env=environment, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


# -- mistakes in the words themselves ------------------------------------------------------------


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["swep"], "unknown command 'swep': did you mean 'sweep'? (allowed: sweep, table, "),
        (["sweep"], "sweep: name the keys to sweep, e.g. fracbench sweep alpha="),
        (["sweep", "alpha=1", "--jbos", "2"], "unexpected argument '--jbos': did you mean --jobs?"),
        (["sweep", "alpha=1", "--jobs"], "argument --jobs: expected one argument"),
        (["sweep", "alpha=1", "--jobs", "two"], "argument --jobs: invalid int value: 'two'"),
        (["sweep", "alpha=1", "--rerun", "all"], "argument --rerun: invalid choice: 'all'"),
        (["sweep", "alpha=1", "--dry-run", "theta"], "unexpected argument 'theta'"),
        (["methods", "alpha=1"], "unexpected argument 'alpha=1'"),
        (["estimate", "a.png", "b.png"], "the following arguments are required: -o/--output"),
        (["table", "9"], "there is no table '9' (allowed: "),
        (["figure", "x"], "there is no figure 'x'"),
        (["experiment", "tabel2"], "unknown experiment 'tabel2': did you mean 'table2'?"),
        (["table", "2", "alpha=1"], "table2: an experiment fixes its own grid"),
        (["run", "alpha=1,2"], "run takes one point, not a grid (alpha=1,2); use sweep"),
        (["run", "region=grove2_*"], "run takes one point, region=grove2_* stands for 2; use sweep"),
        (["check", "--jobs", "0"], "--jobs must be at least 1, got 0"),
        (["check", "--update", "--jobs", "-1"], "--jobs must be at least 1, got -1"),
        (["check", "tabel"], "unknown stored table 'tabel'"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(cli, work, argv, message):
    done = cli(*argv)
    assert (done.code, done.out) == (EXIT_INPUT, "")
    assert done.err.startswith(f"fracbench: {message}")
    assert done.err.count("\n") == 1
    assert tree(work) == []


def test_a_message_is_one_line_whatever_is_in_it(cli, work):
    done = cli("estimate", "no\nsuch.png", "b.png", "-o", "f.flo")
    assert done.err == "fracbench: no such.png: cannot be read: No such file or directory\n"


# -- sweep ---------------------------------------------------------------------------------------


def test_a_sweep_computes_draws_and_remembers(cli, work, tiny):
    first = cli("sweep", "alpha=0:1:0.5", *tiny)
    assert first.code == EXIT_DONE
    assert "3 points computed (3 new), 0 taken from the store" in first.err
    assert "Best alpha" in first.out
    assert "settings: dataset synthetic; protocol reference; boundary zero" in first.out
    written = re.findall(r"^wrote (.*)$", first.out, re.MULTILINE)
    assert [Path(path).suffix for path in written] == [".csv", ".png", ".pdf"]
    assert all((work / path).stat().st_size > 0 for path in written)
    csv = (work / written[0]).read_bytes()
    assert pd.read_csv(work / written[0])["alpha"].tolist() == [0.0, 0.5, 1.0]
    second = cli("sweep", "alpha=0:1:0.5", *tiny)
    assert second.code == EXIT_DONE
    assert second.err == "nothing to compute: all 3 points are in the store\n"
    assert second.out == first.out
    assert (work / written[0]).read_bytes() == csv
    assert not [name for name in tree(work) if Path(name).name.startswith(".")]


def test_different_sweeps_have_different_files(cli, work, tiny):
    one = cli("sweep", NAMES_ONLY, "lambda=0.5", *tiny).out
    two = cli("sweep", NAMES_ONLY, "lambda=0.25", *tiny).out
    assert re.findall("wrote .*", one) != re.findall("wrote .*", two)
    again = cli("sweep", NAMES_ONLY, "lambda=0.5", "parallel.jobs=1", *tiny).out
    assert re.findall("wrote .*", again) == re.findall("wrote .*", one)
    assert len([name for name in tree(work) if name.endswith(".csv")]) == 2


def test_a_dry_run_counts_and_writes_nothing(cli, work, tiny):
    done = cli("sweep", "alpha=0:2:0.1", *tiny, "--dry-run")
    assert done.code == EXIT_DONE
    assert done.out.startswith("21 points, 0 stored, 21 to compute on 2 processes: about 0.")
    assert "minutes (rough: nothing like it is stored yet)" in done.out
    assert tree(work) == []
    cli("sweep", "alpha=0,0.1", NAMES_ONLY, *tiny)
    before = tree(work)
    done = cli("sweep", "alpha=0:2:0.1", "boundary=zero", *tiny, "--dry-run")
    assert done.out.startswith("21 points, 2 stored, 19 to compute on 2 processes: about 0.")
    assert "minutes (from stored points of the same methods)" in done.out
    assert tree(work) == before


def test_a_grid_may_be_tried_out(cli, work, tiny):
    done = cli("sweep", "alpha=0:2:0.1", *tiny, "--small", "--dry-run")
    assert done.out.startswith("3 points, 0 stored, 3 to compute")
    done = cli("sweep", "lambda=0.1:0.9:0.1", "theta=0.1:0.9:0.1", NAMES_ONLY, *tiny, "--small", "--dry-run")
    assert done.out.startswith("18 points, ")


def test_overrides_may_follow_options_and_jobs_has_two_spellings(cli, work, tiny):
    said = [
        cli("sweep", *tiny, "alpha=0,1", "--jobs", "3", "--dry-run").out,
        cli("sweep", "--jobs", "3", *tiny, "--dry-run", "alpha=0,1").out,
        cli("sweep", "--dry-run", *tiny, "alpha=0,1", "parallel.jobs=3").out,
    ]
    assert len(set(said)) == 1
    assert said[0].startswith("2 points, 0 stored, 2 to compute on 3 processes")


def test_jobs_reach_the_execution(cli, work, tiny, monkeypatch):
    seen = []
    real = sweep._pool

    def pool(plan, jobs, store):
        seen.append(jobs)
        return real(plan, jobs, store)

    monkeypatch.setattr(sweep, "_pool", pool)
    assert cli("sweep", "theta=0.1", *tiny, "--jobs", "1").code == EXIT_DONE
    assert cli("sweep", "theta=0.1", *tiny, "max_inner=3").code == EXIT_DONE
    assert seen == [1, 2]


def test_results_go_where_they_are_asked_to(cli, work, tiny):
    done = cli("sweep", NAMES_ONLY, *tiny, "paths.results=deep/out")
    assert done.code == EXIT_DONE
    assert {name.split("/")[0] for name in tree(work)} == {"deep"}
    assert "wrote deep/out/sweeps/" in done.out


def test_a_point_that_fails_gives_exit_code_3_and_a_hint(cli, work, tiny, monkeypatch):
    class Unlucky(LocalPool):
        def compute(self, jobs):
            for key, row in super().compute(jobs):
                found = decode(row)
                if found.spec["params"]["boundary"] == "reflect":
                    found = replace(found, status="failed", error="made to fail", result={})
                    with self._store._transaction():  # a failed row does not take the place of a finished one
                        self._store._db.execute("DELETE FROM points WHERE key = ?", [key])
                    self._store.put(found)
                yield key, encode(found)

    with monkeypatch.context() as patched:
        patched.setattr(sweep, "_pool", lambda plan, jobs, store: Unlucky(jobs, store))
        done = cli("sweep", NAMES_ONLY, *tiny)
    hint = (
        "1 of 2 points are not done (first: made to fail); the same command with --rerun failed tries them again"
    )
    assert done.code == EXIT_FAILED
    assert done.err.splitlines()[-1] == f"fracbench: {hint}"
    again = cli("sweep", NAMES_ONLY, *tiny)
    assert (again.code, again.err.splitlines()[0]) == (
        EXIT_FAILED,
        "nothing to compute: all 2 points are in the store",
    )
    retried = cli("sweep", NAMES_ONLY, *tiny, "--rerun", "failed")
    assert retried.code == EXIT_DONE
    assert "1 points computed (1 failed before), 1 taken from the store" in retried.err


def test_scenes_that_stand_in_are_remarked_upon(cli, work, no_middlebury):
    done = cli("sweep", "sequence=grove2", "n_scales=1", "n_warps=1", "max_iter=1", NAMES_ONLY)
    assert done.code == EXIT_DONE
    assert "note: using the synthetic scenes in place of Middlebury: the server cannot be reached" in done.err
    assert all("_synthetic" in path for path in re.findall(r"wrote (.*)", done.out))


def test_ctrl_c_is_one_line_and_keeps_what_was_finished(cli, work, tiny, monkeypatch):
    class Interrupted(LocalPool):
        def compute(self, jobs):
            with closing(super().compute(jobs)) as ended:
                yield next(ended)
                raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "_pool", lambda plan, jobs, store: Interrupted(1, store))
    done = cli("sweep", NAMES_ONLY, *tiny)
    assert done.code == 130
    assert done.err.splitlines()[-1] == (f"fracbench: interrupted; {RESUME}")
    assert "Traceback" not in done.err
    with Store(work / "results" / STORE, readonly=True) as store:
        assert len(store.rows("done")) in (1, 2)  # the other may have been finished meanwhile


def test_an_unknown_artefact_is_told_before_anything_is_computed(cli, work, tiny):
    (work / "experiments").mkdir()
    (work / "experiments" / "mine.yaml").write_text(f"artefact: swep\ngrid: [{', '.join(tiny)}]\n")
    before = tree(work)
    done = cli("experiment", "mine")
    assert done.code == EXIT_INPUT
    assert done.err.startswith("fracbench: experiment mine: unknown artefact 'swep': did you mean 'sweep'?")
    assert tree(work) == before


# -- table and experiment ------------------------------------------------------------------------


def test_a_table_on_the_rendered_scenes(cli, work):
    (work / "experiments").mkdir()
    (work / "experiments" / "table2.yaml").write_text(
        "title: Two sequences\nartefact: table2\ngrid: [protocol=reference, 'sequence=grove2,venus', "
        "'method=tvl1,tvl1_sb', n_scales=1, n_warps=1, max_iter=2]\n"
    )
    dry = cli("table", "2", "dataset=synthetic", "--dry-run")
    assert dry.out.startswith("4 points, 0 stored, 4 to compute")
    done = cli("table", "2", "--jobs", "2", "dataset=synthetic", "paths.results=out")
    assert done.code == EXIT_DONE
    written = re.findall(r"^wrote (.*)$", done.out, re.MULTILINE)
    assert written == [f"out/tables/table2_synthetic.{suffix}" for suffix in ("csv", "md", "tex")]
    assert "reference: TV-L1-SB is better than TV-L1 on " in done.out
    assert "synthetic_parallax" in done.out and "synthetic_occlusion" in done.out
    assert cli("experiment", "table2", "dataset=synthetic", "paths.results=out").out == done.out


# -- estimate ------------------------------------------------------------------------------------


def test_two_images_become_a_flow_and_a_picture(cli, images):
    done = cli("estimate", "a.png", "b.png", "-o", "flow.flo", "alpha=0.8", "max_iter=20")
    assert (done.code, done.err) == (EXIT_DONE, "")
    assert done.out.startswith("tvl1_sb_alpha (preset recommended with alpha=0.8 max_iter=20): ")
    assert done.out.endswith("wrote flow.flo\nwrote flow.color.png\n")
    assert tree(images) == ["a.png", "b.png", "flow.color.png", "flow.flo", "t.flo"]
    expected = estimate_flow(read_image("a.png"), read_image("b.png"), alpha=0.8, max_iter=20)
    np.testing.assert_array_equal(read_flow("flow.flo"), expected.flow)
    assert read_image("flow.color.png").shape == (24, 32, 3)


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_compilation_is_told_once_and_not_timed(images):
    """Afterwards `warmup` has nothing to do for this method, and says where the cache is."""
    cache = images / "cache"

    def run(*words):
        done = python("-m", "fracbench", *words, cwd=images, NUMBA_CACHE_DIR=str(cache))
        assert done.returncode == 0
        return done

    words = ("estimate", "a.png", "b.png", "-o", "flow.flo", "--method", "tvl1")
    first, second = run(*words), run(*words)
    assert (first.stderr, second.stderr) == (f"{COMPILING}\n", "")
    assert float(re.search(r"([\d.]+) s;", first.stdout.splitlines()[0])[1]) < 1.0  # 3 s were compilation
    said = run("warmup", "tvl1").stdout
    assert re.fullmatch(rf"\d+ loops compiled in [\d.]+ s; the cache is in {re.escape(str(cache))}\S*\n", said)


def test_the_errors_are_printed_if_the_truth_is_known(cli, images):
    done = cli("estimate", "a.png", "b.png", "-o", "flow.flo", "--truth", "t.flo")
    errors = flow_errors(read_flow("flow.flo"), read_flow("t.flo"))
    assert f"AAE {errors.aae:.4f} rad ({np.degrees(errors.aae):.2f} deg)" in done.out
    assert f"AEPE {errors.aepe:.4f} px" in done.out
    assert "768 pixels scored, 0 of unknown truth, 0 not finite" in done.out
    assert "preset recommended)" in done.out
    assert "AAE" not in cli("estimate", "a.png", "b.png", "-o", "flow.flo").out


def test_the_flow_may_be_kittis_and_the_picture_elsewhere(cli, images):
    (images / "p").mkdir()
    done = cli("estimate", "a.png", "b.png", "-o", "f.png", "--color", "p/c.jpg", "--method", "tvl1", "max_iter=9")
    assert done.code == EXIT_DONE
    assert done.out.startswith("tvl1 (")
    expected = estimate_flow(read_image("a.png"), read_image("b.png"), method="tvl1", max_iter=9)
    np.testing.assert_allclose(read_flow("f.png"), expected.flow, atol=1 / 128)
    assert read_image("p/c.jpg").shape == (24, 32, 3)
    assert not (images / "f.color.png").exists()


def test_a_mask_an_initial_flow_and_the_confidence(cli, images):
    mask = np.zeros((24, 32, 3), np.uint8)
    mask[5:9, 6:11, 1] = 1  # hardly black, but not black
    write_image("mask.png", mask)
    files = ("--mask", "mask.png", "--initial-flow", "t.flo", "--confidence", "conf.png")
    done = cli("estimate", "a.png", "b.png", "-o", "flow.flo", *files, "n_scales=1")
    assert (done.code, done.err) == (EXIT_DONE, "")
    expected = estimate_flow(
        read_image("a.png"), read_image("b.png"), mask=mask.any(axis=2), initial_flow=read_flow("t.flo"),
        confidence=True, n_scales=1,
    )  # fmt: skip
    np.testing.assert_array_equal(read_flow("flow.flo"), expected.flow)
    agrees, distance = expected.confidence.agrees, expected.confidence.distance
    assert 0 < agrees.sum() < agrees.size
    picture = read_image("conf.png")
    np.testing.assert_array_equal(picture > 0, agrees)
    np.testing.assert_allclose(picture[agrees], 255 - 254 * np.minimum(distance[agrees], 1), atol=0.5)
    assert f"the flows forward and back agree at {agrees.mean():.1%} of the pixels\nwrote conf.png\n" in done.out


def test_a_field_is_written_in_physical_axes_and_units(cli, images):
    """The files agree with the flow, whose y points down."""
    xarray = pytest.importorskip("xarray")
    write_image("mask.png", np.pad(np.full((4, 6), 255, np.uint8), ((0, 20), (0, 26))))
    files = ["--arrows", "a.pdf", "--vorticity", "v.png", "--csv", "f.csv", "--netcdf", "f.nc"]
    units = ["--grid", "8", "--scale", "0.5", "--dt", "0.01"]
    words = ["estimate", "a.png", "b.png", "-o", "flow.flo", "--mask", "mask.png", "--confidence", "c.png"]
    done = cli(*words, *files, *units, "max_iter=9")
    assert (done.code, done.err) == (EXIT_DONE, "")
    assert done.out.endswith("wrote a.pdf\nwrote v.png\nwrote f.csv\nwrote f.nc\n")
    u1, u2 = read_flow("flow.flo")
    table = np.loadtxt("f.csv", delimiter=",", skiprows=1)
    assert table.shape == (12, 6)
    row, column = 12, 20
    (line,) = table[(table[:, 0] == 0.5 * (column + 0.5)) & (table[:, 1] == 0.5 * (24 - row - 0.5))]
    np.testing.assert_allclose(line[2:4], [50 * u1[row, column], -50 * u2[row, column]], rtol=1e-6)
    doubtful = read_image("c.png") == 0
    assert 0 < doubtful.sum() < doubtful.size
    with xarray.open_dataset("f.nc") as read:
        assert read.attrs["source"] == "fracbench, tvl1_sb_alpha (preset recommended with max_iter=9)"
        known = np.ones((24, 32), bool)
        known[:4, :6] = False
        np.testing.assert_array_equal(read.mask[::-1] == 1, ~known)
        np.testing.assert_array_equal(read.flags[::-1] == 1, doubtful)
        np.testing.assert_allclose(read.u.values[::-1][known], 50 * u1[known], rtol=1e-6)
        assert np.isnan(read.u.values[::-1][~known]).all()
        slopes = derivatives(np.where(known, [u1, u2], np.nan), dt=0.01)
        np.testing.assert_allclose(read.vorticity[::-1], -slopes.vorticity, rtol=1e-5, atol=1e-4)
    assert Path("a.pdf").read_bytes().startswith(b"%PDF") and read_image("v.png").shape[1] == 1280


def test_the_grid_of_a_field_is_16_pixels_by_default(cli, images):
    assert cli("estimate", "a.png", "b.png", "-o", "flow.flo", "max_iter=2", "--csv", "f.txt").code == EXIT_DONE
    lines = Path("f.txt").read_text().splitlines()
    assert lines[0] == "# x\ty\tu\tv\tflags\tmask"
    assert [line.split("\t")[:2] for line in lines[1:]] == [["8.5", "15.5"], ["24.5", "15.5"]]


def test_frames_that_are_smaller_than_the_grid_need_no_field(cli, work):
    for name in "ab":
        write_image(f"{name}.png", np.full((6, 7), 90, np.uint8))
    assert cli("estimate", "a.png", "b.png", "-o", "flow.flo", "max_iter=2").code == EXIT_DONE
    done = cli("estimate", "a.png", "b.png", "-o", "flow.flo", "max_iter=2", "--csv", "f.csv")
    assert (done.code, done.err) == (
        EXIT_INPUT, "fracbench: --grid 16: no vector of it is within frames of 7 x 6 pixels\n",
    )  # fmt: skip
    small = ("--csv", "f.csv", "--grid", "4")
    assert cli("estimate", "a.png", "b.png", "-o", "flow.flo", "max_iter=2", *small).code == EXIT_DONE


@pytest.mark.parametrize(("suffix", "bits"), [(".tif", 8), (".tif", 16), (".bmp", 8)])
def test_frames_of_piv_cameras_give_the_flow_of_the_same_png(cli, images, suffix, bits):
    for name in "ab":
        frame = read_image(f"{name}.png").astype(np.uint16) * (257 if bits == 16 else 1)
        Image.fromarray(frame if bits == 16 else frame.astype(np.uint8)).save(f"{name}{suffix}")
        assert read_image(f"{name}{suffix}").dtype == f"uint{bits}"
    cli("estimate", "a.png", "b.png", "-o", "one.flo", "max_iter=9")
    assert cli("estimate", f"a{suffix}", f"b{suffix}", "-o", "two.flo", "max_iter=9").code == EXIT_DONE
    np.testing.assert_allclose(read_flow("two.flo"), read_flow("one.flo"), atol=1e-4)


@pytest.mark.parametrize(
    ("settings", "ended"),
    [
        (
            ["n_scales=1", "epsilon=0", "n_warps=3", "max_iter=2"],
            "all 3 warps reached the limit of 2 iterations; the last iteration",
        ),
        (
            ["n_scales=1", "epsilon=9", "n_warps=2"],
            "all 2 warps converged; the last iteration changed the flow by 0.",
        ),
        (["--method", "opencv_dis"], "; the method does not report how it ended\n"),
    ],
)
def test_the_end_is_told_in_words(cli, images, settings, ended):
    if "opencv_dis" in settings:
        pytest.importorskip("cv2")
    out = cli("estimate", "a.png", "b.png", "-o", "flow.flo", *settings).out
    assert ended in out and "max_iter," not in out
    assert ("iterations" in out) != ("opencv_dis" in settings)


def test_a_preset_is_named_only_where_it_sets_parameters(cli, images):
    pytest.importorskip("cv2")
    words = ["estimate", "a.png", "b.png", "-o", "flow.flo", "--method", "opencv_dis"]
    done = cli(*words, "protocol=fast", "preset=fast")
    assert done.out.startswith("opencv_dis (its defaults with preset=fast): ")
    assert done.err == "note: opencv_dis has parameters of its own, and takes none of the preset fast\n"
    assert cli(*words).err == ""


def test_the_default_method_is_that_of_the_python_interface(cli, images):
    assert cli("estimate", "a.png", "b.png", "-o", "f.flo").out.startswith(f"{api.DEFAULT_METHOD} (")


def test_a_protocol_gives_its_method_and_its_own_parameters(cli, images):
    done = cli("estimate", "a.png", "b.png", "-o", "f.flo", "protocol=accurate", "median_radius=1")
    assert done.out.startswith("tvl1_sb_alpha_ic (preset accurate with median_radius=1): ")
    preset = yaml.safe_load(asset("conf/protocol/accurate.yaml").read_text())
    values = {**preset["params"], "median_radius": 1}
    params = {"lambda_" if name == "lambda" else name: value for name, value in values.items()}
    expected = estimate_flow(read_image("a.png"), read_image("b.png"), method=preset["method"], **params)
    np.testing.assert_array_equal(read_flow("f.flo"), expected.flow)
    # the settings of `reference` alone: no sequence's lambda or theta
    done = cli("estimate", "a.png", "b.png", "-o", "f.flo", "protocol=reference")
    own = yaml.safe_load(asset("conf/protocol/reference.yaml").read_text())["params"]
    expected = estimate_flow(read_image("a.png"), read_image("b.png"), **own)
    np.testing.assert_array_equal(read_flow("f.flo"), expected.flow)


def test_what_was_there_is_kept_if_the_command_is_refused(cli, images):
    (images / "f.flo").write_bytes(b"precious")
    before = {path.name: path.read_bytes() for path in images.iterdir()}
    for extra in (
        ["alpha=3"],
        ["--color", "c.xyz"],
        ["--color", "a.png"],
        ["--color", "f.flo"],
        ["--truth", "f.flo"],
    ):
        assert cli("estimate", "a.png", "b.png", "-o", "f.flo", *extra).code == EXIT_INPUT
    assert {path.name: path.read_bytes() for path in images.iterdir()} == before


# -- run -----------------------------------------------------------------------------------------


def test_one_configured_flow(cli, work, tiny):
    done = cli("run", "alpha=1.3", *tiny)
    assert (done.code, done.err) == (EXIT_DONE, "")
    assert "AEPE " in done.out and "20480 pixels scored" in done.out
    flow, picture = (path for path in re.findall(r"^wrote (.*)$", done.out, re.MULTILINE))
    assert re.fullmatch(r"results/runs/flows/synthetic_flat_tvl1_sb_alpha_[0-9a-f]{8}\.flo", flow)
    assert picture == flow.replace(".flo", ".color.png")
    assert read_flow(flow).shape == (2, 128, 160)
    assert np.isfinite(read_flow(flow)).all()


def test_a_flow_on_a_stand_in_says_so_in_its_name(cli, work, no_middlebury):
    done = cli("run", "region=grove2_A", "n_scales=1", "n_warps=1", "max_iter=1")
    assert "in place of Middlebury" in done.err
    assert "wrote results/runs/flows/synthetic_parallax_tvl1_sb_alpha_" in done.out


# -- check ---------------------------------------------------------------------------------------


@pytest.fixture
def project(work, tiny, reference) -> Path:
    (work / "experiments").mkdir()
    grid = ", ".join([*tiny, "'alpha=0.5,1'"])
    (work / "experiments" / "mini.yaml").write_text(f"title: Mini\ngrid: [{grid}]\n")
    tolerance = 'absolute = 1e-6\nrelative = 1e-3\nbasis = "b"\nreason = "r"\n'
    (reference / "tolerances.toml").write_text("".join(f"[{name}]\n{tolerance}" for name in MEASURED))
    return reference


def test_check_says_what_holds_and_which_cell_moved(cli, project):
    assert cli("check").code == EXIT_INPUT
    stored = cli("check", "mini", "--update", "--reason", "first")
    assert stored.code == EXIT_DONE
    assert re.findall("wrote .*/(.*)", stored.out) == ["mini.csv", "mini.json"]
    held = cli("check")
    assert (held.code, held.out) == (EXIT_DONE, "mini: holds (14 cells compared)\n")
    table = pd.read_csv(project / "mini.csv", dtype=str, keep_default_na=False)
    was = table.loc[1, "aepe"]
    table.loc[1, "aepe"] = f"{float(was) * 1.01:.9g}"
    table.to_csv(project / "mini.csv", index=False)
    moved = cli("check", "mini", "--jobs", "1")
    assert moved.code == EXIT_CHECK
    assert moved.out == (
        "mini: 1 DIFFERENCES (14 cells compared)\n"
        f"  main, reference, synthetic_flat, tvl1_sb_alpha, 1.0: aepe: stored {table.loc[1, 'aepe']}, found {was} "
        "(allowed: 1e-06 + 0.001 of the stored)\n"
    )
    updated = cli("check", "--update", "--reason", "again")
    assert updated.code == EXIT_DONE
    assert cli("check").code == EXIT_DONE


def test_an_update_needs_a_reason(cli, project):
    before = tree(project)
    done = cli("check", "mini", "--update")
    assert (done.code, done.err) == (
        EXIT_INPUT,
        'fracbench: check --update needs --reason "why the stored numbers change"\n',
    )
    assert tree(project) == before


def test_a_spread_that_was_not_measured_is_remarked_upon(cli, project):
    cli("check", "mini", "--update", "--reason", "first")
    assert "the spread of mini is not that of this solver: python tools/spread.py --update" in cli("check").err


def test_nothing_compared_is_no_success(cli, project, no_middlebury):
    (project.parents[1] / "experiments" / "mini.yaml").write_text("grid: [sequence=grove2, max_iter=1]\n")
    (project / "mini.csv").write_text("sequence\ngrove2\n")
    done = cli("check")
    assert done.code == EXIT_CHECK
    assert done.out == "mini: SKIPPED: the Middlebury data cannot be had here\n"


# -- data and methods ----------------------------------------------------------------------------


@pytest.fixture
def registered(work, monkeypatch) -> Path:
    """A folder that holds files registered as Middlebury's."""
    import hashlib

    folder = work / "mb"
    registry = {}
    for name in middlebury_data.REGISTRY:
        content = name.encode()
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
        registry[name] = hashlib.sha256(content).hexdigest()
    monkeypatch.setattr(middlebury_data, "REGISTRY", registry)
    monkeypatch.setenv("FRACBENCH_DATA", str(folder))
    return folder


def test_the_state_of_the_data_is_told(cli, registered):
    done = cli("data")
    assert done.code == EXIT_DONE
    assert done.out.startswith(f"Middlebury: {registered} (from FRACBENCH_DATA)\n")
    assert re.findall(r"^  (\w+) +ok$", done.out, re.MULTILINE) == list(middlebury_data.SEQUENCES)
    (registered / "Venus/flow10.flo").write_bytes(b"x")
    (registered / "Urban2/frame10.png").unlink()
    done = cli("data")
    assert done.code == EXIT_CHECK
    assert re.findall(r"^  (\w+) +(\w+)$", done.out, re.MULTILINE)[2] == ("Urban2", "missing")
    assert "Venus        corrupt\n" in done.out
    assert "Venus/flow10.flo is corrupt" in done.out and "Urban2/frame10.png is missing" in done.out


def test_data_can_be_fetched(cli, registered, monkeypatch):
    fetched = []
    monkeypatch.setattr(middlebury_data, "download", fetched.append)
    assert cli("data", "--download").code == EXIT_DONE
    assert fetched == [registered]
    assert cli("data").code == EXIT_DONE
    assert len(fetched) == 1


def test_the_methods_are_listed_with_what_they_depend_on(cli):
    done = cli("methods")
    assert done.code == EXIT_DONE
    for name, method in METHODS.items():
        assert f"{name}: {method.label}, {method.summary}\n" in done.out
        assert f"    depends on {', '.join(sorted(method.uses))}\n" in done.out


# -- in a process of its own ---------------------------------------------------------------------


def test_the_module_runs_and_leaves_with_the_exit_code(work, tiny):
    done = python("-m", "fracbench", "sweep", NAMES_ONLY, *tiny, cwd=work)
    assert done.returncode == EXIT_DONE
    assert "2 points computed (2 new)" in done.stderr
    assert "wrote results/sweeps/" in done.stdout
    done = python("-m", "fracbench", "sweep", "alhpa=1", cwd=work)
    assert (done.returncode, done.stdout) == (EXIT_INPUT, "")
    assert done.stderr.startswith("fracbench: unknown key 'alhpa': did you mean 'alpha'?")


def test_a_sweep_compiles_before_its_workers_start(work, monkeypatch):
    """In this process, for all points that are missing, unless they are computed on other machines."""
    from fracbench.commands import run

    order: list[Any] = []
    monkeypatch.setattr(run, "compile_for", lambda settings: order.append([name for name, _ in settings]))
    monkeypatch.setattr(run.sweep, "run", lambda *_, **__: order.append("workers") or sweep.Report(Path()))
    plan = run.make_plan(["method=tvl1,tvl1_sb", "sequence=synthetic_flat"])
    run.run_plan(plan, "test", 2)
    assert order == [["tvl1", "tvl1_sb"], "workers"]
    there = ["parallel=dask", "parallel.address=tcp://elsewhere:1"]
    run.run_plan(run.make_plan(["method=tvl1", "sequence=synthetic_flat", *there]), "test", 2)
    assert order[2:] == ["workers"]
