"""YAML is data: malformed files are refused in one line, run no code and lead to no place outside the results."""

from __future__ import annotations

import ast
import os
import shutil
import sys
from pathlib import Path

import pytest

import fracbench
from fracbench.harness.config import compose as config
from fracbench.harness.config.experiment import list_experiments, load_experiment
from fracbench.harness.config.paths import asset
from fracbench.harness.config.records import refuse_code, require_name
from fracbench.harness.run import plan
from fracbench.studies.options import require_options

SCENE = ["alpha=1", "dataset=synthetic", "--dry-run"]
REGION = "defaults: [{override /sequence: grove2}]\nregion: "
OWN = REGION + "{name: own, sequence: "
BOX = "sequence: grove2, rows: [0, 90], cols: [0, 90]"

#: A file of conf, the text replaced (empty: the file is new), the text in its place, and a part of the message.
CONFIGS = [
    ("config.yaml", "dataset: auto", "dataset: [1]", "`dataset` must be a name"),
    ("config.yaml", "dataset: auto", "dataset: moon", "unknown dataset 'moon'"),
    ("config.yaml", "dataset: auto", "dataste: auto", "unknown key 'dataste': did you mean 'dataset'?"),
    ("config.yaml", "dataset: auto", "", "`dataset` is missing"),
    ("config.yaml", "context: 0", "context: [1]", "`context` must be a whole number, got [1]"),
    ("config.yaml", "context: 0", "context: 1.5", "`context` must be a whole number, got 1.5"),
    ("config.yaml", "shift: null", "shift: some", "`shift` must be a whole number, got 'some'"),
    ("config.yaml", "results: results", "results: 7", "paths: `results` must be a text, got 7"),
    ("config.yaml", "results: results", "results: null", "paths: `results` must be a text, got None"),
    ("config.yaml", "results: results", "results: ''", "paths.results must name a folder"),
    ("config.yaml", "results: results", 'results: "a\\0b"', "paths.results must name a folder, got 'a\\x00b'"),
    ("config.yaml", "data: null", 'data: "a\\nb"', "paths.data must name a folder"),
    ("config.yaml", "results: results", "reslts: results", "paths: unknown key 'reslts': did you mean 'results'?"),
    ("config.yaml", "data: null", "data: {a: 1}", "paths: `data` must be a text or null, got {'a': 1}"),
    ("config.yaml", "params: {}", "params: 3", "params: must be a mapping, got 3"),
    ("config.yaml", "params: {}", "params: {alpha: [1]}", "`alpha` must be a number, got [1]"),
    ("config.yaml", "params: {}", "params: {alhpa: 1}", "unknown parameter 'alhpa': did you mean 'alpha'?"),
    ("config.yaml", "params: {}", "params: {1: 2}", "params: the key 1 is no text"),
    ("config.yaml", "params: {}", "params: {alpha: '${nothing}'}", "Interpolation key 'nothing' not found"),
    ("config.yaml", "defaults:", "defaults: 3\nx:", "defaults must be a list"),
    ("config.yaml", "defaults:", "- 1\n", "config.yaml: cannot be read as YAML"),
    ("config.yaml", "defaults:", "\tdefaults:", "config.yaml: cannot be read as YAML"),
    ("config.yaml", "defaults:", "caf\xe9:", "config.yaml: cannot be read as YAML: 'utf-8'"),
    ("region/own.yaml", "", REGION + "[1]", "region: must be a mapping with the keys cols, name, rows, sequence"),
    ("region/own.yaml", "", OWN + "grove2}", "region: "),
    ("region/own.yaml", "", OWN + "grove2, rows: 3, cols: [0, 9]}", "`rows` must be a list"),
    ("region/own.yaml", "", OWN + "grove2, rows: [0, 9], cols: [a, b]}", "two integers"),
    (
        "region/own.yaml",
        "",
        OWN + "grove2, rows: [0, 481], cols: [0, 9]}",
        "region 'own': rows 0:481, columns 0:9 leave the picture of 480 x 640 (rows x columns)",
    ),
    ("region/own.yaml", "", OWN + "moon, rows: [0, 9], cols: [0, 9]}", "unknown sequence"),
    (
        "region/own.yaml",
        "",
        OWN + "urban2, rows: [0, 9], cols: [0, 9]}",
        "the region is of 'urban2', but its defaults choose 'Grove2'",
    ),
    ("sequence/own.yaml", "", "sequence: 5", "sequence: must be a mapping, got 5"),
    ("sequence/own.yaml", "", "sequence: {name: [1], dataset: synthetic}", "`name` must be a text, got [1]"),
    ("sequence/own.yaml", "", "sequence: {name: Moon, dataset: middlebury}", "unknown middlebury sequence"),
    ("sequence/own.yaml", "", "sequence: {name: flat, dataset: disk}", "unknown dataset 'disk'"),
    ("sequence/own.yaml", "", "sequence: {name: Venus, dataset: middlebury, stand_in: egde}", "mean 'edge'?"),
    ("protocol/own.yaml", "", "protocol: own\nmethod: [tvl1]", "`method` must be a name"),
    ("protocol/own.yaml", "", "protocol: own\nmethod: null", "`method` must be a name"),
    ("protocol/own.yaml", "", "protocol: [1]", "`protocol` must be a name"),
    ("protocol/own.yaml", "", "protocol: own\nparams: {n_warps: .inf}", "`n_warps` must be a whole number"),
    ("protocol/own.yaml", "", "protocol: own\nparams: {alpha: !!binary aGVs}", "could not determine a"),
    ("protocol/own.yaml", "", f"params: {{alpha: 0x{5000 * 'f'}}}", "whole numbers have at most 80 characters"),
    ("protocol/own.yaml", "", "protocol: own\nparams: {null: 1}", "conf: ConfigCompositionException"),
    ("parallel/own.yaml", "", "parallel: {jobs: two}", "parallel: `jobs` must be a whole number, got 'two'"),
    ("parallel/own.yaml", "", "parallel: {jobs: 1.5}", "parallel: `jobs` must be a whole number, got 1.5"),
    ("parallel/own.yaml", "", "parallel: {backend: [1]}", "parallel: `backend` must be a text, got [1]"),
    ("parallel/own.yaml", "", "parallel: 2", "parallel: must be a mapping"),
    ("parallel/own.yaml", "", "shift: 1", "`parallel` is missing"),
]  # fmt: skip

#: Values that would run code, or read more than the project's own files.
CODE = [
    ("config.yaml", "params: {}", "params: {_target_: os.system}", "'_target_' is not allowed"),
    ("config.yaml", "params: {}", "params: {}\n_target_: os.system", "'_target_' is not allowed"),
    ("config.yaml", "params: {}", "params: {}\nhydra: {searchpath: ['pkg://boom']}", "'hydra' is not allowed"),
    ("config.yaml", "defaults:", "defaults:\n  - override hydra/launcher: boom", "'hydra/launcher' is not"),
    ("config.yaml", "defaults:", "defaults:\n  - hydra: boom", "'hydra' is not allowed"),
    ("config.yaml", "defaults:", "# @package hydra\nsearchpath: ['pkg://boom']\ndefaults:", "must be _global_"),
    ("config.yaml", "params: {}", "params: !!python/object/apply:boom.go []", "could not determine a constructor"),
    ("protocol/own.yaml", "", "protocol: own\nmethod: {_target_: boom.go}", "'_target_' is not allowed"),
    ("protocol/own.yaml", "", "protocol: own\nmethod: boom", "unknown method 'boom'"),
    ("protocol/own.yaml", "", "protocol: own\nmethod: boom:go", "`method` must be a name"),
    ("protocol/own.yaml", "", "hydra: {searchpath: ['pkg://boom']}", "'hydra' is not allowed"),
    ("protocol/own.yaml", "", "params: {alpha: !!python/name:boom.go ''}", "could not determine a constructor"),
    ("sequence/own.yaml", "", "sequence: {name: x, dataset: y, _partial_: true}", "'_partial_' is not allowed"),
]  # fmt: skip

#: Names that would lead out of the results folder.
ESCAPES = [
    ("region/own.yaml", "", REGION + "{name: ../../evil, " + BOX + "}", "`name` must be a name of"),
    ("region/own.yaml", "", REGION + "{name: /elsewhere/evil, " + BOX + "}", "`name` must be a name of"),
    ("region/own.yaml", "", REGION + "{name: .., " + BOX + "}", "`name` must be a name of"),
    ("region/own.yaml", "", REGION + '{name: "a\\\\b", ' + BOX + "}", "`name` must be a name of"),
    (
        "sequence/own.yaml",
        "",
        "sequence: {name: ../Venus, dataset: middlebury}",
        "`name` must be a name of",
    ),
    (
        "sequence/own.yaml",
        "",
        "sequence: {name: Venus, dataset: middlebury, stand_in: ../x}",
        "`stand_in` must",
    ),
    (
        "protocol/own.yaml",
        "",
        f"protocol: {'long' * 50}",
        "`protocol` must be a name of letters, digits, _, -, + and .",
    ),
    ("protocol/own.yaml", "", "protocol: ../../evil", "`protocol` must be a name of letters"),
]

EXPERIMENTS = [
    ("grid: [alhpa=1]", "unknown key 'alhpa': did you mean 'alpha'?"),
    ("grid: [", "mine.yaml: cannot be read as YAML"),
    ("caf\xe9: 1", "mine.yaml: cannot be read as YAML"),
    ("- grid", "mine.yaml: must be a mapping with the keys artefact, grid, grids, options, title"),
    ("", "mine.yaml: must be a mapping"),
    ("grid: alpha=1", "mine.yaml: a grid must be a list"),
    ("grid: [1]", "mine.yaml: a grid must be a list"),
    ("grids: [alpha=1]", "mine.yaml: a grid must be a list"),
    ("grids: {a: [alpha=1], b: alpha}", "mine.yaml: a grid must be a list"),
    ("title: none", "mine.yaml: one of `grid` (overrides) and `grids`"),
    ("gird: [alpha=1]", "mine.yaml: unknown key 'gird': did you mean 'grid'?"),
    ("1: 2", "mine.yaml: the key 1 is no text"),
    ("grid: [alpha=1]\noptions: 5", "`options`: must be a mapping"),
    ("grid: [sequence=synthetic_flat]\nartefact: swep", "unknown artefact 'swep': did you mean 'sweep'?"),
    ("grid: [sequence=synthetic_flat]\noptions: {x: alpha}", "options: unknown key 'x'"),
    ("grids: {}\nartefact: frames\noptions: {sequences: venus}", "options: `sequences` must be a list"),
    ("grids: {}\nartefact: family\noptions: {shade: [1]}", "option 'shade' must be two numbers"),
    ("grids: {}\nartefact: family\noptions: {styles: ['--*', 'r--']}", "styles: unknown marker 'r--' in 'r--'"),
    ("grids: {}\nartefact: family\noptions: {styles: ['-Q']}", "styles: unknown marker 'Q' in '-Q'"),
    ("grids: {}\nartefact: family\noptions: {styles: ['']}", "styles: '' names neither a line nor a marker"),
    ("grids: {}\nartefact: family\noptions: {styles: []}", "option 'styles' must name a line or a marker"),
    ("grids: {}\nartefact: protocol_search\noptions: {stages: 3}", "`stages` must be a list, got 3"),
    ("grids: {}\nartefact: protocol_search\noptions: {space: 3}", "`space` must be a mapping, got 3"),
    ("grid: [dataset=synthetic, dataset=auto]", "the key 'dataset' is given twice"),
    ("grid: [sequence=synthetic_flat, paths.results=/elsewhere]", "is said on the command line"),
    ("grid: [sequence=synthetic_flat, parallel.jobs=99]", "is said on the command line"),
    ("grid: [sequence=synthetic_flat]\ntitle: 2001-99-99", "cannot be read as YAML: month must be in 1..12"),
    ("grid: [sequence=synthetic_flat]\ntitle: !!bool maybe", "cannot be read as YAML"),
    ("grid: [sequence=synthetic_flat]\ntitle: !!timestamp noon", "cannot be read as YAML"),
    ("grid: [sequence=synthetic_flat]\ntitle: !!int ''", "cannot be read as YAML"),
    (f"grid: [sequence=synthetic_flat]\ntitle: 1{400_000 * ':1'}", "whole numbers have at most 80 characters"),
    ("grid: [sequence=synthetic_flat]\ntitle: !!binary aGVs", "could not determine a constructor"),
    ("grid: [sequence=synthetic_flat]\noptions: {<<: {x: 1}}", "merge keys (<<) are not allowed"),
    ("grid: !!python/object/apply:boom.go []", "could not determine a constructor"),
]  # fmt: skip


@pytest.fixture
def own_conf(work, monkeypatch) -> Path:
    """A copy of ``conf`` that a test may change, and a module ``boom`` that leaves a trace if imported."""
    shutil.copytree(asset("conf"), work / "conf")
    (work / "boom.py").write_text("import pathlib\ndef go(): pass\npathlib.Path('TRACE').touch()\n")
    monkeypatch.syspath_prepend(str(work))
    monkeypatch.setattr(config, "asset", lambda relative: work / relative)
    for cache in (config._compose, plan._chosen):
        cache.cache_clear()
    yield work / "conf"
    for cache in (config._compose, plan._chosen):
        cache.cache_clear()
    sys.modules.pop("boom", None)


def change(folder: Path, file: str, old: str, new: str) -> list[str]:
    """Change or write a file of the configuration; return the choice that makes Hydra read it."""
    path = folder / file
    if old:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="latin-1")
        return []
    path.write_text(f"# @package _global_\n{new}\n")
    return [file.removesuffix(".yaml").replace("/", "=")]


@pytest.mark.parametrize(("file", "old", "new", "named"), CONFIGS)
def test_configurations_that_cannot_be_used(own_conf, work, refused, file, old, new, named):
    argv = [word for word in SCENE if not ("dataset" in new + old and file == "config.yaml" and "dataset" in word)]
    refused(work, ["sweep", *argv, *change(own_conf, file, old, new)], named)


@pytest.mark.parametrize(("file", "old", "new", "named"), CODE)
def test_nothing_in_a_configuration_runs_code(own_conf, work, refused, file, old, new, named):
    refused(work, ["sweep", *SCENE, *change(own_conf, file, old, new)], named)
    assert "boom" not in sys.modules and not (work / "TRACE").exists()


#: File of conf/ in the working folder, what is in it, what is said.
WORKING_FOLDER = [
    ("protocol/accurate.yaml", "protocol: accurate", "the name is that of one of fracbench's own protocols"),
    ("sequence/grove2.yaml", "sequence: {name: edge, dataset: synthetic}", "one of fracbench's own sequences"),
    ("region/none.yaml", "region: null\n#", "one of fracbench's own regions; choose another"),
    ("parallel/dask.yaml", "parallel: {jobs: 9}", "one of fracbench's own parallels"),
    ("protocol/own.yaml", "protocol: reference", "the file own.yaml must give the same name, not 'reference'"),
    ("region/own.yaml", OWN.replace("own", "grove2_A") + "grove2, rows: [0, 9], cols: [0, 9]}", "not 'grove2_A'"),
    ("protocol/own.yaml", "protocol: own\nparams: {alhpa: 1}", "'alhpa': did you mean 'alpha'?"),
    ("protocol/own.yaml", "protocol: own\nparams: {alpha: '${oc.env:HOME}'}", "'${oc.env:HOME}' is not allowed"),
    ("protocol/own.yaml", "protocol: own\nparams: {alpha: '${${x}:HOME}'}", "'${${x}:HOME}' is not allowed"),
    ("protocol/own.yaml", "protocol: own\nparams: {_target_: boom.go}", "'_target_' is not allowed"),
    ("protocol/own.yaml", "hydra: {searchpath: ['pkg://boom']}", "'hydra' is not allowed"),
    ("protocol/own.yaml", "defaults: [{override hydra/launcher: boom}]", "'hydra/launcher' is not allowed"),
    ("protocol/own.yaml", "defaults: [{/model: net}]", "`defaults` may hold override /sequence"),
    ("protocol/own.yaml", "defaults: [net]", "`defaults` may hold override /sequence"),
    ("protocol/own.yaml", "defaults: [{/sequence: venus, /model: net}]", "`defaults` may hold override /sequence"),
    ("protocol/own.yaml", "defaults: [{override /parallel: dask}]", "override /protocol with a name"),
    (
        "region/own.yaml",
        "defaults: [{override /protocol: fast}]",
        "override /sequence, override /region with a name",
    ),
    ("protocol/own.yaml", "defaults: [{override /sequence: ../../x}]", "must be a name of letters"),
    ("protocol/own.yaml", "defaults: [{override /sequence: grve2}]", "grve2"),
    ("protocol/own.yaml", "defaults: 3", "`defaults` must be a list, got 3"),
    ("protocol/own.yaml", "params: !!python/object/apply:boom.go []", "could not determine a constructor"),
    ("protocol/own.yaml", "x: [", "own.yaml: cannot be read as YAML"),
    ("protocol/own.yaml", "- 1", "own.yaml: must be a mapping"),
    ("protocol/own.yaml", "a: &a [1]\nb: *a", "aliases"),
    ("protocol/own.yaml", "# " + 1_000_001 * "x", "bytes, more than the 1000000 that it may have"),
    ("protocol/deep/own.yaml", "protocol: own", "a configuration has no folders within"),
    ("protocol/.own.yaml", "protocol: own", "its name must be a name of letters"),
    ("protocol/-own.yaml", "protocol: own", "its name must be a name of letters"),
]


@pytest.mark.parametrize(("file", "text", "named"), WORKING_FOLDER)
def test_files_of_the_working_folder_that_cannot_be_used(work, monkeypatch, refused, file, text, named):
    (work / "boom.py").write_text("import pathlib\ndef go(): pass\npathlib.Path('TRACE').touch()\n")
    monkeypatch.syspath_prepend(str(work))
    path = work / "conf" / file
    path.parent.mkdir(parents=True)
    path.write_text(f"# @package _global_\n{text}\n")
    choice = ["region=own"] if file == "region/own.yaml" else ["protocol=own"]
    refused(work, ["sweep", *SCENE, *(choice if path.stem == "own" and "deep" not in file else [])], named)
    assert "boom" not in sys.modules and not (work / "TRACE").exists()


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (Path.mkdir, "own.yaml: not a regular file"),
        (os.mkfifo, "own.yaml: not a regular file"),
        (lambda path: path.symlink_to("nothing_of_the_kind"), "own.yaml: cannot be read"),
    ],
)
def test_a_file_of_the_working_folder_that_is_none(work, refused, make, named):
    (work / "conf" / "protocol").mkdir(parents=True)
    make(work / "conf" / "protocol" / "own.yaml")
    refused(work, ["sweep", *SCENE], named)


def test_the_trap_of_the_test_before_works(own_conf, work):
    """Hydra itself would import the package."""
    from hydra import compose, initialize_config_dir

    change(own_conf, "config.yaml", "params: {}", "params: {}\nhydra: {searchpath: ['pkg://boom']}")
    with initialize_config_dir(str(own_conf), version_base="1.3"), pytest.warns(UserWarning, match="boom"):
        compose("config")
    assert (work / "TRACE").exists()


@pytest.mark.parametrize(("file", "old", "new", "named"), ESCAPES)
@pytest.mark.parametrize("command", ["sweep", "run"])
def test_no_name_in_a_configuration_leads_out_of_the_results(
    own_conf, work, refused, command, file, old, new, named
):
    words = SCENE if command == "sweep" else SCENE[:2]
    refused(work, [command, *words, *change(own_conf, file, old, new)], named)


@pytest.mark.parametrize(("text", "named"), EXPERIMENTS)
def test_experiments_that_cannot_be_run(work, refused, text, named):
    (work / "experiments").mkdir()
    (work / "experiments" / "mine.yaml").write_text(f"{text}\n", encoding="latin-1")
    refused(work, ["experiment", "mine", "dataset=synthetic"], named)


@pytest.mark.parametrize("name", ["../mine", "..", ".hidden", "a b", "a\\b", "-x", "a\nb", "mine.", "x" + "/y"])
def test_no_name_of_an_experiment_leads_out_of_the_results(work, refused, name):
    (work / "experiments").mkdir()
    if "/" not in name:
        (work / "experiments" / f"{name}.yaml").write_text("grid: [sequence=synthetic_flat]\n")
    refused(work, ["experiment", "--", name])


@pytest.mark.parametrize("name", ["grove2_A", "tvl1", "a.b", "a-b+c", "0", "synthetic_flat"])
def test_ordinary_names_are_allowed(name):
    assert require_name(name, "a name", "here") == name


def test_the_projects_own_files_are_plain_data():
    refuse_code(asset("conf"))
    refuse_code(asset("experiments"))


@pytest.mark.parametrize("name", list_experiments())
def test_the_projects_experiments_have_options_that_are_known(name):
    require_options(load_experiment(name))


def test_nothing_in_the_package_reads_code_out_of_data():
    """No pickle, no unsafe YAML, no eval, no hydra.utils.instantiate; two places import modules by name."""
    root = Path(fracbench.__file__).parent
    imports = []
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            assert not {"instantiate", "read_pickle", "to_pickle"} & {*name.split(".")}, path
            assert name not in ("eval", "exec", "compile", "builtins.eval", "builtins.exec"), path
            assert name not in ("yaml.load", "yaml.full_load", "yaml.unsafe_load"), path
            assert name != "np.load" or "allow_pickle=False" in ast.unparse(node), path
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = {alias.name for alias in node.names} | {getattr(node, "module", None)}
                assert not modules & {"pickle", "cloudpickle", "marshal", "shelve", "dill"}, path
            if name.endswith("import_module"):
                imports.append(path.relative_to(root).as_posix())
    # All take the name of the module from the source: the package's own lazy names, file locks, the registries.
    assert sorted(imports) == [
        "__init__.py", "data/datasets/registry.py", "harness/run/sweep.py", "methods/registry.py"
    ]  # fmt: skip


def test_there_are_many_cases():
    assert len(CONFIGS) + len(CODE) + len(ESCAPES) + len(EXPERIMENTS) >= 60


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)


def test_a_small_file_that_grows_without_end_is_refused(own_conf, work, refused):
    """Lists of lists of lists, each named once: 9^12 texts."""
    (own_conf / "protocol" / "own.yaml").write_text("# @package _global_\n" + BOMB)
    refused(work, ["sweep", *SCENE, "protocol=own"], "own.yaml: aliases (&NAME, *NAME)")
    (own_conf / "protocol" / "own.yaml").unlink()
    (work / "experiments").mkdir()
    for key in ("options", "grids", "title"):
        indented = "".join(f"  {line}\n" for line in BOMB.splitlines())
        grid = "" if key == "grids" else "grid: [sequence=synthetic_flat]\n"
        (work / "experiments" / "mine.yaml").write_text(f"{grid}{key}:\n{indented}")
        said = refused(work, ["experiment", "mine", "dataset=synthetic"])
        assert len(said) < 400


def test_merge_keys_that_grow_without_end_are_refused(own_conf, work, refused):
    """PyYAML copies the keys of what is merged: 9^12 of them."""
    text = "a0: &a0 {x: 1}\n" + "".join(
        f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 13)
    )
    (own_conf / "protocol" / "own.yaml").write_text("# @package _global_\n" + text)
    refused(work, ["sweep", *SCENE, "protocol=own"], "own.yaml: cannot be read as YAML: merge keys (<<)")
    (own_conf / "protocol" / "own.yaml").unlink()
    (work / "experiments").mkdir()
    (work / "experiments" / "mine.yaml").write_text(f"grid: [sequence=synthetic_flat]\n{text}")
    refused(work, ["experiment", "mine"], "mine.yaml: cannot be read as YAML: merge keys (<<)")


def test_an_experiment_larger_than_a_configuration_is_not_parsed(work, refused):
    (work / "experiments").mkdir()
    (work / "experiments" / "mine.yaml").write_text("# " + 1_000_001 * "x")
    refused(work, ["experiment", "mine"], "mine.yaml: 1000003 bytes, more than the 1000000 that it may have")


def test_results_may_be_anywhere_the_user_says(work, cli):
    """The folder itself is the user's choice, on the command line."""
    (work / "experiments").mkdir()
    (work / "experiments" / "mine.yaml").write_text("grid: [sequence=synthetic_flat, max_iter=1]\n")
    assert cli("experiment", "mine", "paths.results=else/where").code == 0
    assert {path.name for path in work.iterdir()} == {"experiments", "else"}
