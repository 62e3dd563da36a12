from __future__ import annotations

from pathlib import Path

import pytest

from fracbench.data import middlebury as middlebury_data
from fracbench.errors import DataError


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
