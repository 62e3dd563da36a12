"""The paths of the files beside the code: at the top of a checkout, or inside an installed package."""

from __future__ import annotations

from pathlib import Path

import fracbench
from fracbench.errors import InputError

_PACKAGE = Path(fracbench.__file__).resolve().parent


def asset(relative: str) -> Path:
    """Return the path of a folder or file of the project, e.g. ``conf``.

    It is in the checkout that the package is imported from, else in the installed package.
    """
    for root in (_PACKAGE.parent, _PACKAGE / "_assets"):
        # A folder named conf beside site-packages would be somebody else's.
        if (root / "pyproject.toml").is_file() or root.name == "_assets":
            path = root / relative
            if path.exists():
                return path
    raise InputError(f"{relative}: not found; the installation is incomplete")


def checkout() -> Path | None:
    """Return the top of the checkout the package is imported from, or None if it is installed."""
    root = _PACKAGE.parent
    return root if (root / "pyproject.toml").is_file() and (root / "conf").is_dir() else None
