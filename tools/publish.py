"""Renew the committed tables and figures, and the answer in README.md, from the results of the working folder.

Run as ``make publish``, after ``make paper``, ``make beyond`` and ``make fluids``, from a clean commit and on
Middlebury.
``make publish ONLY="accurate fluids"`` renews the tables and figures of these experiments alone.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from fracbench.commands.paper import PAPER
from fracbench.data.files import atomic_path
from fracbench.errors import InputError
from fracbench.harness.config.paths import checkout
from fracbench.report.claims import answer
from fracbench.report.page.beyond import EXPERIMENTS
from fracbench.report.sources import COMMITTED, SUFFIXES, Sources

FOLDERS = ("tables", "figures")
PUBLISHED = (*PAPER, *EXPERIMENTS, "fluids")
#: Experiments that take long: they are published where they were computed, else their copies stay.
LONG = ("protocol_search", "explained")
#: The README's pictures that belong to no experiment, and the commands that write them.
PICTURES = {
    "readme_alpha.png": ("sweep", "alpha=0:2:0.1", "region=grove2_A"),
    "readme_flow.png": ("run", "sequence=rubberwhale", "protocol=recommended"),
}


def computed(results: Path, only: Sequence[str] = ()) -> list[Path]:
    """Return the files to publish, relative to the results folder: all, or those of some experiments."""
    names = "|".join(only or (*PUBLISHED, *LONG, "answer", "claims"))
    wanted = re.compile(rf"(?!\.)({names})(_\w+)?\.\w+(\.gz)?")
    endings = tuple(suffix for suffix in SUFFIXES if suffix)
    return [
        path.relative_to(results)
        for folder in FOLDERS
        for path in sorted((results / folder).glob("*"))
        if wanted.fullmatch(path.name) and not path.name.partition(".")[0].endswith(endings)
        if "__" not in path.stem
    ]


def problems(results: Path, committed: Path, sources: Sources, only: Sequence[str] = ()) -> list[str]:
    """Return the reasons why the files cannot be published, a line each; none if they can.

    Reasons are synthetic data, points that are missing or come from a commit with local changes, and files that
    are missing or name such a commit. `results` holds the computed files, `committed` the copies.
    """
    if sources.stand_in:
        return ["the Middlebury sequences are not at hand: the tables would be of synthetic scenes"]
    found = []
    for name in only or PUBLISHED:
        source = sources.get(name)
        if source.n_missing:
            found.append(f"{name}: {source.n_missing} of {source.n_points} points are missing: {source.command}")
        n_dirty = sum(bool(row.provenance.get("dirty")) for row in source.rows.values())
        if n_dirty:
            found.append(f"{name}: {n_dirty} points were computed from a commit with local changes")
    files = computed(results, only)
    absent = sorted({*computed(committed, only or (*PUBLISHED, "answer", "claims"))} - {*files})
    if absent:
        lacking = ", ".join(map(str, absent))
        found.append(f"{results}: lacks {lacking}; run make paper, make beyond and make fluids")
    for path in files:
        if path.suffix == ".md" and " with local changes" in (results / path).read_text(encoding="utf-8"):
            found.append(f"{results / path}: was computed from a commit with local changes")
    return found


def copy(source: Path, target: Path) -> None:
    """Copy a file; it takes the place of the target whole or not at all."""
    with atomic_path(target) as temporary:
        shutil.copyfile(source, temporary)


def publish(results: Path, committed: Path, only: Sequence[str] = ()) -> int:
    """Copy the computed tables and figures over the committed ones; return how many files differ now."""
    changed = 0
    for path in computed(results, only):
        source, target = results / path, committed / path
        if not target.is_file() or source.read_bytes() != target.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            copy(source, target)
            changed += 1
    return changed


def draw(picture: str) -> Path:
    """Run the command of one of the README's pictures and return the file that it wrote."""
    command = [sys.executable, "-m", "fracbench", *PICTURES[picture]]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return Path(re.findall(r"(\S+\.png)\b", said)[-1])


def main(only: Sequence[str]) -> int:
    """Check and copy, and renew the README unless some experiments are named; return the exit code."""
    allowed = (*PUBLISHED, *LONG)
    unknown = [name for name in only if name not in allowed]
    if unknown:
        raise InputError(f"publish: {unknown[0]} is not published (allowed: {', '.join(allowed)})")
    root = checkout()
    if root is None or root != Path.cwd():
        raise InputError(f"publish: run it at the top of the checkout, {root}")
    results, committed = root / "results", root / COMMITTED
    sources = Sources(results)
    found = problems(results, committed, sources, only)
    if found:
        print("\n".join(["nothing is published:", *found]), file=sys.stderr)
        return 2
    if only:
        print(f"renewed {publish(results, committed, only)} files of {', '.join(only)} in {COMMITTED}")
        return 0
    drawn = {picture: draw(picture) for picture in PICTURES}  # first: a command that fails leaves the copies alone
    changed = publish(results, committed)
    for picture, path in drawn.items():
        copy(path, committed / "figures" / picture)
    answer.renew(root / "README.md", sources)
    print(f"renewed {changed} files and {len(PICTURES)} pictures in {COMMITTED}, and the answer in README.md")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except InputError as exc:
        print(f"error: {exc}", file=sys.stderr)
        sys.exit(2)
