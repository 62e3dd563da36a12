"""The rooms: their allowed imports, their number of modules, and their docstrings."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import fracbench

ROOT = Path(fracbench.__file__).parent
#: The rooms that each room may import from, besides itself.
_SOLVER = ("errors", "entry_points", "data", "methods", "model")
_HARNESS = (*_SOLVER, "evaluation", "harness")
MAY_IMPORT = {
    "errors": (),
    "entry_points": ("errors",),
    "model": ("errors",),
    "model.kernels": ("errors",),
    "model.operators": ("errors", "model.kernels"),
    "data": ("errors", "entry_points"),
    "evaluation": ("errors", "model.structure", "model.kernels.jit"),
    "methods": ("errors", "entry_points", "model"),
    "api": (*_SOLVER, "harness.config", "figures"),
    "clips": ("errors", "api"),
    "sweeps": ("errors", "methods", "harness.config", "harness.run"),
    "harness.config": _SOLVER,
    "harness.run": (*_SOLVER, "evaluation", "harness.config"),
    "harness.check": (*_SOLVER, "evaluation", "harness.config", "harness.run"),
    "harness": (),
    "figures": ("errors", "data.files", "data.field"),
    "studies": (*_HARNESS, "figures"),
    "report": (*_HARNESS, "figures", "studies"),
    "commands": (*_HARNESS, "api", "figures", "studies", "report"),
}
MOST_MODULES = 14


def modules() -> list[Path]:
    return [path for path in sorted(ROOT.rglob("*.py")) if path.parent != ROOT or path.stem in MAY_IMPORT]


def room_of(name: str) -> str:
    """The innermost room that a module is in."""
    return max((room for room in MAY_IMPORT if f"{name}.".startswith(f"{room}.")), key=len)


def imported(path: Path) -> set[str]:
    """The package's modules that a module imports, also within functions, without the package's name."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fracbench"):
            base = (node.module or "").removeprefix("fracbench").removeprefix(".")
            for alias in node.names:
                whole = f"{base}.{alias.name}".removeprefix(".")
                is_module = (ROOT / f"{whole.replace('.', '/')}.py").is_file()
                found.add(whole if is_module or not base else base)
    return found - {"__version__", "SOLVER_VERSION"}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_imports_only_from_those_that_it_may(path):
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    room = room_of(name)
    for other in imported(path):
        allowed = any(f"{other}.".startswith(f"{each}.") for each in (room, *MAY_IMPORT[room]))
        assert allowed, f"{name} imports {other}, but {room} may import only {', '.join(MAY_IMPORT[room])}"


@pytest.mark.parametrize("room", [p for p in ROOT.rglob("*") if p.is_dir() and [*p.glob("*.py")]], ids=str)
def test_a_room_is_small_and_says_what_it_holds(room):
    own = [path for path in room.glob("*.py") if path.stem != "__init__"]
    assert len(own) <= MOST_MODULES
    docstring = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8")))
    assert docstring and ("mport" in docstring or room == ROOT)
