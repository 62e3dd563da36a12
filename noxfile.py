"""All tests on each supported Python that is installed, and with the lowest versions of the dependencies."""

from __future__ import annotations

import sys
from pathlib import Path

import nox

PYTHONS = ("3.11", "3.12", "3.13")
EXTRAS = ("dev", "peers", "piv")  # all packages that tests ask for
nox.options.default_venv_backend = "venv"
nox.options.error_on_missing_interpreters = False


def test(session: nox.Session, *more: str) -> None:
    """Install the project without its dependencies and run the tests; words after ``--`` are pytest's."""
    session.install("--no-deps", "--no-build-isolation", "--editable", ".")
    words = session.posargs or ("--numprocesses", "2", "--dist", "loadfile")
    session.run("python", "-m", "pytest", "-q", *more, *words)


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Test with the versions of locks/dev.txt."""
    session.install("--require-hashes", "--requirement", "locks/dev.txt")
    test(session)


@nox.session(python=PYTHONS[0])
def extras(session: nox.Session) -> None:
    """Test with the optional packages too, in the versions of constraints.txt."""
    session.install("--constraint", "constraints.txt", f".[{','.join(EXTRAS)}]")
    test(session)


@nox.session(python=PYTHONS[0])
def lowest(session: nox.Session) -> None:
    """Test with the lowest version of each direct dependency, the optional packages among them."""
    chosen = str(Path(session.create_tmp(), "lowest.txt").resolve())
    uv = (sys.executable, "-m", "uv", "pip", "compile")
    words = ("--resolution", "lowest-direct", "--python-version", PYTHONS[0], "--quiet")
    words += tuple(f"--extra={extra}" for extra in EXTRAS)
    session.run(*uv, *words, "--output-file", chosen, "pyproject.toml", external=True)
    session.install("--requirement", chosen)
    # Old versions warn of what their newer dependencies have deprecated.
    test(session, "-W", "ignore")
