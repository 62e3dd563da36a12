"""Run tests and print the branches and statements that they take, by room: ``python tools/coverage_by_room.py``.

Words are pytest's, e.g. ``tests/data``; without any all tests are run. Compiled loops are not counted: numba runs
them, and `make test-python` runs them as Python.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTS = ("covered_branches", "num_branches", "covered_lines", "num_statements")


def by_room(files: dict[str, dict[str, dict[str, int]]]) -> dict[str, list[int]]:
    """Return the sums of `COUNTS` by room, from the part ``files`` of coverage's JSON report."""
    sums: dict[str, list[int]] = defaultdict(lambda: [0] * len(COUNTS))
    for path, found in files.items():
        room = "/".join(Path(path).parent.parts[1:3]) or "fracbench"
        sums[room] = [total + found["summary"][name] for total, name in zip(sums[room], COUNTS, strict=True)]
    return dict(sorted(sums.items()))


def main(words: Sequence[str]) -> int:
    """Run the tests under coverage and print a Markdown table; return pytest's exit code."""
    with tempfile.TemporaryDirectory() as folder:
        data, report = f"{folder}/coverage", f"{folder}/coverage.json"
        command = [sys.executable, "-m", "coverage"]
        tests = ["-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
        run = ["run", "--branch", "--source=fracbench", f"--data-file={data}", *tests]
        code = subprocess.run([*command, *run], cwd=ROOT, check=False).returncode
        subprocess.run([*command, "json", "-q", f"--data-file={data}", "-o", report], cwd=ROOT, check=True)
        files = json.loads(Path(report).read_text(encoding="utf-8"))["files"]
    print("| room | branches | statements |\n| --- | --- | --- |")
    for room, (branches, n_branches, lines, n_lines) in by_room(files).items():
        print(f"| {room} | {_share(branches, n_branches)} | {_share(lines, n_lines)} |")
    return code


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / whole:.1f} %)" if whole else "none"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
