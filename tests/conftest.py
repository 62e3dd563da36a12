from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import spread

from fracbench.commands import console
from fracbench.commands.cli import EXIT_INPUT, main
from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.data.datasets.synthetic.scenes import scene
from fracbench.data.files import write_flo, write_image
from fracbench.errors import DataError
from fracbench.figures import cache, style
from fracbench.harness.check import regression, tolerances
from fracbench.harness.run.store import Row
from fracbench.model import SOLVER_VERSION


@pytest.fixture(scope="session")
def middlebury() -> Path:
    """The folder with the Middlebury sequences, by the ordinary look-up and without a download."""
    try:
        found = middlebury_data.find()
    except DataError as exc:
        pytest.skip(str(exc))
    if found.n_files < len(middlebury_data.REGISTRY):
        pytest.skip(f"{found.folder} holds {found.n_files} of {len(middlebury_data.REGISTRY)} Middlebury files")
    return found.folder


@pytest.fixture
def work(tmp_path, monkeypatch) -> Path:
    """An empty working folder; no environment variable says where data are."""
    for name in ("FRACBENCH_DATA", "FRACBENCH_PIV"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def reference(work, monkeypatch) -> Path:
    """The empty folder for the stored tables of a new project, which is the working folder."""
    folder = work / "results" / "reference"
    folder.mkdir(parents=True)
    for module in (regression, spread, tolerances):
        monkeypatch.setattr(module, "asset", lambda relative: work / relative)
    monkeypatch.setattr(regression, "checkout", lambda: work)
    return folder


@pytest.fixture
def tiny() -> list[str]:
    """Overrides for a point that takes a moment, on a rendered scene."""
    return ["sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=2"]


@pytest.fixture
def cli(capsys):
    """The command line, called in this process: ``cli("sweep", ...)`` gives `code`, `out` and `err`."""

    def run(*argv):
        capsys.readouterr()
        try:
            code = main([str(word) for word in argv])
        except SystemExit as exc:
            code = exc.code
        out, err = _said(capsys)
        return SimpleNamespace(code=code, out=out, err=err)

    return run


def _said(capsys) -> tuple[str, str]:
    """Both outputs, but for the line of the first test that needs a loop which is not in numba's cache."""
    out, err = capsys.readouterr()
    return out, err.replace(f"{console.COMPILING}\n", "")


def _contents(folder: Path) -> dict[str, str | None]:
    """Every file below a folder with its SHA-256, every folder with None; without SQLite's temporary files."""
    return {
        str(path.relative_to(folder)): sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        for path in folder.rglob("*")
        if not path.name.endswith((".sqlite-shm", ".sqlite-wal"))
    }


@pytest.fixture
def contents():
    """The tree that `refused` compares before and after."""
    return _contents


@pytest.fixture
def refused(capsys):
    """A function that runs a command and checks that one line refuses it and holds all of `named`.

    No file below the folder may be changed or made.
    """

    def check(folder: Path, argv, *named: str) -> str:
        before = _contents(folder)
        capsys.readouterr()
        code = main([str(word) for word in argv])
        out, err = _said(capsys)
        assert code == EXIT_INPUT, out
        assert err.startswith("fracbench: ") and err.endswith("\n") and err.count("\n") == 1
        assert "Traceback" not in err + out
        for word in named:
            assert word in err, f"{word!r} is not in {err!r}"
        assert _contents(folder) == before
        return err

    return check


@pytest.fixture
def images(work) -> Path:
    """The working folder with two small frames, ``a.png`` and ``b.png``, and the true flow ``t.flo``."""
    small = scene("rotation", shape=(24, 32))
    for name, frame in (("a", small.frame0), ("b", small.frame1)):
        write_image(work / f"{name}.png", np.rint(frame).astype(np.uint8))
    write_flo(work / "t.flo", small.truth)
    return work


@pytest.fixture
def no_middlebury(monkeypatch) -> None:
    """A machine without the Middlebury data and without a network."""

    def unreachable(*_, **__):
        raise DataError("the server cannot be reached")

    monkeypatch.setattr(middlebury_data, "_look_up", lambda explicit: None)
    monkeypatch.setattr(middlebury_data, "download", unreachable)


@pytest.fixture
def unwritten(monkeypatch) -> None:
    """Figures are made and listed but not written, because writing takes seconds."""

    def draw(stem, make, *shown, **looks):
        make(*shown, **looks)
        return style.figure_files(stem)

    monkeypatch.setattr(cache, "draw", draw)


@pytest.fixture
def fake_rows():
    """A function that makes up the rows of a plan: ``errors(labels, params)`` gives AAE, AEPE and SDAE."""

    def make(plan, errors=lambda labels, params: (0.1, 0.2, 0.3), status="done", **changes):
        rows = {}
        for planned in plan.points:
            aae, aepe, sdae = errors(planned.labels, planned.point.canonical)
            result = {
                "aae": aae,
                "aepe": aepe,
                "sdae": sdae,
                "n_pixels": 100,
                "n_unknown": 3,
                "n_nonfinite": 0,
                "iterations": [[10, 3], [4]],
                "inner_iterations": [[20, 6], [8]],
                "stop": "converged",
            }
            given = {
                "key": planned.point.key,
                "identity": planned.point.identity,
                "spec": planned.point.spec,
                "solver_version": SOLVER_VERSION,
                "status": status,
                "result": result if status == "done" else {},
                "error": None if status == "done" else "made up",
                "seconds": 1.5,
                "provenance": {"python": "3.11.0", "versions": {"numpy": "2.0"}, "commit": "0" * 40},
            }
            rows[planned.point.key] = Row(**given | changes)
        return rows

    return make
