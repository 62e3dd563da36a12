"""The distributed wheel: it works without the checkout, under one version and one command."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

import fracbench
from fracbench.commands import cli
from fracbench.errors import InputError
from fracbench.harness.config import paths as assets
from fracbench.harness.config.paths import asset, checkout

ROOT = Path(fracbench.__file__).parents[1]
DOCUMENTS = ("docs/beyond.md", "docs/errata.md", "docs/protocol.md")
ASSETS = ("conf", *DOCUMENTS, "experiments", "results/published", "results/reference", "results/claims.yaml")


@pytest.fixture(scope="module")
def project() -> dict:
    if checkout() is None:
        pytest.skip("the package is installed: there is no checkout to build from")
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def wheel(project, tmp_path_factory) -> Path:
    """A wheel, built from a copy: a build must not write into the checkout."""
    hatchling = pytest.importorskip("hatchling.builders.wheel", reason="hatchling, the build backend, is missing")
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, source)
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("fracbench", *ASSETS):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=ignored)
        else:
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    target = tmp_path_factory.mktemp("wheel")
    (built,) = hatchling.WheelBuilder(str(source)).build(directory=str(target), versions=["standard"])
    return Path(built)


def metadata(wheel: Path, name: str) -> str:
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(f"fracbench-{fracbench.__version__}.dist-info/{name}").decode()


def test_the_wheel_holds_every_module_and_every_asset(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "fracbench").rglob("*.py")}
    assert modules <= held
    for name in ASSETS:
        paths = [path for path in (ROOT / name, *(ROOT / name).rglob("*")) if path.is_file()]
        files = {f"fracbench/_assets/{path.relative_to(ROOT)}" for path in paths}
        assert files and files <= held
    assert "fracbench/_assets/conf/config.yaml" in held
    assert "fracbench/_assets/results/published/table2.csv" in held
    outside = {name for name in held if not name.startswith(("fracbench/", f"fracbench-{fracbench.__version__}"))}
    assert outside == set()
    assert not any(name.startswith("fracbench/_assets/results/runs") for name in held)


def test_the_wheel_holds_whatever_the_package_asks_for(wheel):
    """Every ``asset("...")`` of the source, and every file beside the modules."""
    asked = set()
    for path in (ROOT / "fracbench").rglob("*.py"):
        asked |= set(re.findall(r"""\basset\(f?"([^"{]+)""", path.read_text(encoding="utf-8")))
    assert {"conf", "experiments", "results/reference"} <= {word.rstrip("/") for word in asked}
    with zipfile.ZipFile(wheel) as archive:
        held = archive.namelist()
    for word in asked:
        assert any(name.startswith(f"fracbench/_assets/{word}") for name in held), word
    beside = [
        path for path in (ROOT / "fracbench").rglob("*") if path.is_file() and "__pycache__" not in path.parts
    ]
    assert {str(path.relative_to(ROOT)) for path in beside} <= {*held}


def test_the_wheel_works_without_the_checkout(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    (tmp_path / "elsewhere").mkdir()
    command = ["-m", "fracbench", "sweep", "alpha=0:2:0.1", "sequence=synthetic_flat", "--dry-run"]
    code = (
        f"import sys\nsys.path.insert(0, {str(tmp_path / 'site')!r})\n"
        "import fracbench\nfrom fracbench.commands.cli import main\n"
        f"code = main({command[2:]!r})\nprint(fracbench.__file__, file=sys.stderr)\nsys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], cwd=tmp_path / "elsewhere", capture_output=True, text=True
    )
    assert done.stderr == f"{tmp_path / 'site' / 'fracbench' / '__init__.py'}\n"
    assert done.returncode == 0
    assert done.stdout.startswith("21 points, 0 stored, 21 to compute")


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """A new environment with the wheel installed by pip; it shares the dependencies of this one."""
    pytest.importorskip("pip")
    folder = tmp_path_factory.mktemp("installed") / "venv"
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", "--no-deps", "--no-index", str(wheel)], check=True, env=bare(folder))
    (site,) = (folder / "lib").glob("python*/site-packages")
    here = dict.fromkeys(sysconfig.get_path(name) for name in ("purelib", "platlib"))
    (site / "dependencies.pth").write_text("\n".join(here) + "\n")
    return folder


def bare(home: Path) -> dict[str, str]:
    """Environment variables that do not mention this checkout."""
    return {"PATH": os.defpath, "HOME": str(home), "MPLCONFIGDIR": str(home), "NUMBA_NUM_THREADS": "1"}


def test_an_installed_package_works_from_another_folder(installed, images):
    """estimate, sweep and table 2, from a working folder that has nothing to do with the checkout."""

    def fracbench_(*words: str) -> str:
        command = [str(installed / "bin" / "fracbench"), *words]
        done = subprocess.run(command, cwd=images, capture_output=True, text=True, env=bare(installed))
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert fracbench_("--version") == f"fracbench {fracbench.__version__}\n"
    quick = ("n_scales=1", "n_warps=1", "max_iter=2")
    said = fracbench_("estimate", "a.png", "b.png", "-o", "out.flo", "--truth", "t.flo", *quick)
    assert "AEPE" in said and (images / "out.flo").is_file() and (images / "out.color.png").is_file()
    said = fracbench_("estimate", "a.png", "b.png", "-o", "out.flo", "protocol=accurate", *quick)
    assert said.startswith("tvl1_sb_alpha_ic (preset accurate with n_scales=1")
    said = fracbench_("sweep", "alpha=0.5,1", "sequence=synthetic_flat", *quick, "--jobs", "1")
    assert "wrote results/sweeps/" in said
    said = fracbench_("table", "2", "dataset=synthetic", "--small", "--jobs", "1")
    assert "wrote results/tables/table2_synthetic_small.csv" in said
    written = {path.relative_to(images).parts[:2] for path in images.rglob("*") if path.is_file()}
    inputs = {("a.png",), ("b.png",), ("t.flo",)}
    assert written - inputs == {
        ("out.flo",), ("out.color.png",), ("results", "runs"), ("results", "sweeps"), ("results", "tables")
    }  # fmt: skip


def test_the_installed_package_is_the_wheels(installed):
    code = (
        "import fracbench, fracbench.harness.config.paths as a; "
        "print(fracbench.__file__, a.asset('conf'), a.checkout())"
    )
    python = str(installed / "bin" / "python")
    said = subprocess.run([python, "-c", code], capture_output=True, text=True, env=bare(installed), cwd=installed)
    file, conf, checkout_ = said.stdout.split()
    assert Path(file).is_relative_to(installed) and Path(conf).is_relative_to(installed)
    assert checkout_ == "None"


def test_the_versions_of_python_are_said_once(project, wheel):
    """The classifiers start at requires-python and name the tested versions, so there may be gaps."""
    said = metadata(wheel, "METADATA")
    least = re.search(r"^Requires-Python: >=3\.(\d+)$", said, re.MULTILINE)
    minors = [
        int(minor)
        for minor in re.findall(r"^Classifier: Programming Language :: Python :: 3\.(\d+)$", said, re.MULTILINE)
    ]
    assert minors[0] == int(least[1]) and minors == sorted(set(minors))


def test_hydra_is_used_without_a_word_of_warning(monkeypatch):
    """Hydra 1.4 may refuse whatever Hydra 1.3 warns of; warnings are errors here, and none is silenced."""
    from fracbench.harness.config import compose

    compose._compose.cache_clear()
    for group in compose.GROUPS:
        compose.load_config({group: compose.group_options(group)[0]})
    source = Path(compose.__file__).read_text(encoding="utf-8")
    assert "simplefilter" not in source and 'version_base="1.3"' in source


def test_there_is_one_version(project, wheel):
    assert re.fullmatch(r"\d+\.\d+\.\d+", fracbench.__version__)
    assert "version" in project["project"]["dynamic"] and "version" not in project["project"]
    assert project["tool"]["hatch"]["version"]["path"] == "fracbench/__init__.py"
    assert wheel.name == f"fracbench-{fracbench.__version__}-py3-none-any.whl"
    assert f"\nVersion: {fracbench.__version__}\n" in metadata(wheel, "METADATA")
    assert (ROOT / "CITATION.cff").read_text().count(f"version: {fracbench.__version__}") == 1


def test_the_console_script_is_the_command_line(project, wheel):
    assert project["project"]["scripts"] == {"fracbench": "fracbench.commands.cli:console_entry"}
    assert "fracbench = fracbench.commands.cli:console_entry" in metadata(wheel, "entry_points.txt")
    assert callable(cli.console_entry)


def test_the_console_script_leaves_with_the_exit_code(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["fracbench", "swep"])
    with pytest.raises(SystemExit) as left:
        cli.console_entry()
    assert left.value.code == 2
    assert "did you mean 'sweep'" in capsys.readouterr().err


def test_every_import_is_declared(project):
    """The package imports the standard library, itself, its dependencies and its extras, and no other package."""
    names = {"hydra": "hydra-core", "omegaconf": "hydra-core", "PIL": "pillow", "png": "pypng", "yaml": "pyyaml"}
    names |= {"cv2": "opencv-contrib-python-headless", "skimage": "scikit-image", "markdown_it": "markdown-it-py"}
    extras = project["project"]["optional-dependencies"]
    wanted = [*project["project"]["dependencies"], *(word for group in extras.values() for word in group)]
    declared = {re.split(r"[<>=!~\[; ]", word)[0].lower() for word in wanted}
    imported = set()
    for path in (ROOT / "fracbench").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.partition(".")[0])
    others = {name for name in imported if name not in sys.stdlib_module_names and name != "fracbench"}
    assert {"numpy", "hydra"} <= others
    assert {names.get(name, name).lower() for name in others} <= declared


# -- assets --------------------------------------------------------------------------------------


def test_assets_of_a_checkout_are_at_its_top(project):
    assert checkout() == ROOT
    assert asset("conf/config.yaml") == ROOT / "conf" / "config.yaml"


def test_assets_of_an_installation_are_inside_the_package(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "fracbench"
    (package / "_assets" / "conf").mkdir(parents=True)
    (package.parent / "conf").mkdir()  # of another project
    monkeypatch.setattr(assets, "_PACKAGE", package)
    assert asset("conf") == package / "_assets" / "conf"
    assert checkout() is None
    with pytest.raises(InputError, match="experiments: not found; the installation is incomplete"):
        asset("experiments")
