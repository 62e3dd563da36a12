"""Mutation testing: change the code in one random place, run the tests concerned, and list the changes they miss.

Cosmic Ray finds the places and makes the changes, in clones of the last commit. The tests concerned are those that
name the module, and then all of its room. The differences of mutants that no test kills are printed, and the exit
code is then 1. Equal seeds give equal mutants.

``build/mutants.txt`` lists what was killed. It is not tried again while its module stays the same, so that a run
that was stopped goes on, and survivors meet the tests added since.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import shlex
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from time import monotonic
from typing import Any

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("model", "evaluation", "harness/run", "harness/check")
KILLED = ROOT / "build" / "mutants.txt"
SECONDS = 300.0  # for each step of the tests of a mutant; one that loops for ever ends by the clock
# Without annotations and decorators: under `from __future__ import annotations` and numba they change no result.
_LEFT_OUT = ("RemoveDecorator", "BitOr", "BitAnd", "BitXor", "Shift")


def mutants(number: int, seed: int, rooms: Sequence[str] = ROOMS) -> list[Any]:
    """Return random mutations: first a random place of the code, then one of the changes possible there."""
    modules = [
        path.relative_to(ROOT) for room in rooms for path in sorted((ROOT / "fracbench" / room).rglob("*.py"))
    ]
    with (
        tempfile.TemporaryDirectory() as folder,
        use_db(str(Path(folder) / "session.sqlite"), WorkDB.Mode.create) as db,
    ):
        init(modules, db, {})
        found = [item.mutations[0] for item in db.work_items]
    places = defaultdict(list)
    for mutation in found:
        if not any(word in mutation.operator_name for word in _LEFT_OUT):
            places[str(mutation.module_path), mutation.start_pos].append(mutation)
    draw = random.Random(seed)
    chosen = draw.sample(sorted(places), min(number, len(places)))
    return [draw.choice(sorted(places[place], key=lambda each: each.operator_name)) for place in chosen]


def concerned(module: Path, root: Path) -> list[list[str]]:
    """Return the tests of a module in steps: its own file, the files that name it, the folder of its room."""
    room = next(room for room in ROOMS if module.is_relative_to(Path("fracbench", room)))
    name = re.escape(module.stem)
    parent = re.escape(".".join(module.parent.parts))
    said = re.compile(rf"{parent}\.{name}\b|from {parent} import [^\n]*\b{name}\b")
    near = root / "tests" / module.relative_to("fracbench").parent
    tests = sorted((root / "tests").rglob("test_*.py"), key=lambda test: (test.parent != near, test))
    mirror = [str(test.relative_to(root)) for test in tests if test.stem == f"test_{module.stem}"]
    others = [str(test.relative_to(root)) for test in tests if said.search(test.read_text("utf-8"))]
    return [step for step in (mirror, [name for name in others if name not in mirror], [f"tests/{room}"]) if step]


def outcome(mutation: Any) -> tuple[str, str]:
    """Test a mutant in this process's clone; return the verdict and the failing test or the change."""
    diff = ""
    for tests in concerned(mutation.module_path, Path()):
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        result = mutate_and_test([mutation], shlex.join(command), SECONDS)
        diff = result.diff or result.output or ""
        if result.output == "timeout":
            return "killed" if _ends_soon(command) else "over time", f"by the clock in {' '.join(tests)}"
        if result.test_outcome != TestOutcome.SURVIVED:
            failed = re.search(r"^(?:FAILED|ERROR) (\S+)", result.output or "", re.MULTILINE)
            verdict = result.test_outcome.value if result.test_outcome else "no test"
            return str(verdict), failed[1] if failed else diff
    return "survived", diff


def _ends_soon(command: Sequence[str]) -> bool:
    """Say whether these tests pass in a third of the time as long as nothing is changed."""
    try:
        done = subprocess.run(command, stdout=subprocess.DEVNULL, check=False, timeout=SECONDS / 3)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def name_of(mutation: Any) -> str:
    """Return the name of a mutant, which another text of its module changes."""
    digest = hashlib.sha256((ROOT / mutation.module_path).read_bytes()).hexdigest()[:12]
    return f"{mutation.module_path} {digest} {mutation.operator_name} {mutation.occurrence}"


def own_clone() -> None:
    """Work in a clone of the last commit: a mutant never touches the checkout."""
    folder = Path(tempfile.mkdtemp(prefix="mutants-"))
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder / "project")], check=True)
    if (shared := ROOT.parent / "shared").is_dir():
        (folder / "shared").symlink_to(shared)
    os.chdir(folder / "project")
    os.environ["PYTHONPATH"] = str(folder / "project")
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"  # two mutants of a second may have equal times
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--number", type=int, default=200, help="mutants (default: 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the choice (default: 1)")
    parser.add_argument("--minutes", type=float, default=240.0, help="no mutant is started later (default: 240)")
    parser.add_argument(
        "--rooms", nargs="+", choices=ROOMS, default=ROOMS, help="of the package (default: all four)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    given = parser.parse_args(argv)
    chosen, started = mutants(given.number, given.seed, given.rooms), monotonic()
    known = set(KILLED.read_text("utf-8").splitlines()) if KILLED.exists() else set()
    open_ones = [each for each in chosen if name_of(each) not in known]
    counts, survivors = Counter[str](killed=len(chosen) - len(open_ones)), []
    KILLED.parent.mkdir(exist_ok=True)
    with ProcessPoolExecutor(given.jobs, initializer=own_clone) as pool, KILLED.open("a", encoding="utf-8") as log:
        running = {pool.submit(_within, started + 60 * given.minutes, each): each for each in open_ones}
        for future in as_completed(running):
            mutation, (verdict, diff) = running[future], future.result()
            counts[verdict] += 1
            if verdict != "not run":
                place = f"{mutation.module_path}:{mutation.start_pos[0]}"
                print(f"{verdict:<10} {place} {mutation.operator_name.removeprefix('core/')} {diff}", flush=True)
            if verdict == "killed":
                print(name_of(mutation), file=log, flush=True)
            if verdict == "survived":
                survivors.append(mutation)
    ran = counts.total() - counts["not run"]
    print(f"{ran} mutants, seed {given.seed}: {', '.join(f'{n} {word}' for word, n in counts.most_common())}")
    return int(bool(survivors))


def _within(deadline: float, mutation: Any) -> tuple[str, str]:
    return outcome(mutation) if monotonic() < deadline else ("not run", "")


if __name__ == "__main__":
    sys.exit(main())
