"""List the licences of all packages of locks/dev.txt: ``python tools/licenses.py > docs/licenses.md``.

Licences come from the metadata of the packages that are installed, so run it in the environment of `make setup`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)( ;)?", re.MULTILINE)
_HEAD = """# Licences

fracbench itself is under the BSD-3-Clause licence. These are the packages that it needs, and those that only its
developers need, with the licences that their metadata state: `python tools/licenses.py > docs/licenses.md`, in the
environment of `make setup`. Packages of other systems and other Pythons than its own are left out.

The optional extras bring packages with licences of their own. OpenPIV, of the extra `piv`, is under the GPL 3;
fracbench calls it, where it is installed, as a peer to compare with, and holds none of its code.
"""


def pins() -> dict[str, str]:
    """Return the versions of the lock by name, without packages that only some systems or Pythons need."""
    text = (ROOT / "locks" / "dev.txt").read_text(encoding="utf-8")
    return {_key(name): version for name, version, marked in _PIN.findall(text) if not marked}


def licence(name: str) -> str:
    """Return the licence that a package states: an SPDX expression, else its classifiers, else its own words."""
    metadata = distribution(name).metadata
    if "License-Expression" in metadata:
        return metadata["License-Expression"]
    found = [
        each.rpartition(" :: ")[2] for each in metadata.get_all("Classifier", []) if each.startswith("License")
    ]
    words = metadata["License"].strip().splitlines() if "License" in metadata else []
    return ", ".join(name for name in found if name != "OSI Approved") or (words[0] if words else "not stated")


def needed(name: str = "fracbench") -> set[str]:
    """Return all packages that an installation without extras needs."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        for line in _requirements(waiting.pop()):
            if line not in found:
                found.add(line)
                waiting.append(line)
    return found


def _requirements(name: str) -> Iterator[str]:
    try:
        lines = requires(name) or []
    except PackageNotFoundError:  # of another system or Python
        return
    for line in lines:
        if "extra ==" not in line and (match := re.match(r"[A-Za-z0-9._-]+", line)):
            yield _key(match[0])


def _key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> int:
    """Print the document."""
    print(_HEAD)
    users = needed()
    for title, wanted in (("Needed by every user", True), ("Needed by developers only", False)):
        print(f"## {title}\n\n| package | version | licence |\n| --- | --- | --- |")
        for name, version in sorted(pins().items()):
            if (name in users) is wanted:
                print(f"| {name} | {version} | {licence(name)} |")
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
