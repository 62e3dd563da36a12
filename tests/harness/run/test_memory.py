"""The peak of a process's memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fracbench.harness.run.provenance import peak_mib, reset_peak


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak cannot be reset here")
def test_the_peak_is_that_since_the_reset():
    np.ones(2 * 10**7)
    reset_peak()
    before = peak_mib()
    np.ones(10**7)
    assert 70 <= peak_mib() - before <= 90
