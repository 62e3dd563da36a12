"""`fracbench.sweep` against the command line."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

import fracbench
from fracbench.errors import InputError

GRID = ["alpha=1,1.2", "sequence=synthetic_flat,synthetic_edge", "n_scales=1", "n_warps=1", "max_iter=2"]


def test_the_table_is_that_of_the_command_line(work, cli):
    table = fracbench.sweep(*GRID, jobs=1)
    assert cli("sweep", *GRID).code == 0
    assert "nothing to compute" in cli("sweep", *GRID).err
    (path,) = Path("results/sweeps").glob("*.csv")
    written = pd.read_csv(path)
    assert [*written["key"]] == [*table["key"]] and [*table["status"]] == ["done"] * 4
    assert {*written.columns} - {*table.columns} == {"part"}
    pd.testing.assert_series_equal(written["aepe"], table["aepe"], rtol=1e-9)
    assert table.attrs["notices"] == []


def test_notices_are_those_of_the_plan(work, no_middlebury):
    table = fracbench.sweep("sequence=venus", "method=tvl1", *GRID[2:], jobs=2)
    (notice,) = table.attrs["notices"]
    assert "synthetic scenes in place of Middlebury" in notice and [*table["dataset"]] == ["synthetic"]


@pytest.mark.parametrize(
    ("words", "settings", "message"),
    [
        (["alhpa=1"], {}, "unknown key 'alhpa': did you mean 'alpha'"),
        (["alpha=3", "sequence=synthetic_flat"], {}, "alpha"),
        (["alpha=1", "sequence=synthetic_flat"], {"jobs": 0}, "`jobs` must be at least 1, got 0"),
    ],
)
def test_bad_input_is_refused(work, words, settings, message):
    with pytest.raises(InputError, match=message):
        fracbench.sweep(*words, **settings)
    assert not Path("results").exists()
