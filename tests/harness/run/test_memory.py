"""What of a process's memory is told, and given back."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fracbench.harness.run import provenance
from fracbench.harness.run.provenance import peak_mib, reset_peak, return_what_is_freed

PIECES = """
import numpy as np
from fracbench.harness.run.provenance import _LARGE, peak_mib, reset_peak, return_what_is_freed
if {give_back}:
    return_what_is_freed()
np.ones(_LARGE // 2)  # freed at once: by itself, glibc then takes arrays up to that size from its heap
pieces = [(np.ones(_LARGE // 8), np.ones(1000)) for _ in range(16)]
small = [piece for _, piece in pieces]
del pieces
reset_peak()
print(peak_mib())
"""


FAULTS = """
import resource
import numpy as np
from fracbench.harness.run.provenance import return_what_is_freed
return_what_is_freed()
holes = np.ones(2**18)  # what imports have freed, filled
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(100):
    arrays = [np.ones(10**5) for _ in range(3)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak cannot be reset here")
def test_the_peak_is_that_since_the_reset():
    np.ones(2 * 10**7)
    reset_peak()
    before = peak_mib()
    np.ones(10**7)
    assert 70 <= peak_mib() - before <= 90


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak cannot be reset here")
def test_what_is_freed_is_given_back():
    kept, given = (
        float(subprocess.check_output([sys.executable, "-c", PIECES.format(give_back=give)]))
        for give in (False, True)
    )
    assert given < (kept - 30 if platform.libc_ver()[0] == "glibc" else kept + 1)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library, which is left alone")
def test_pages_of_small_arrays_are_not_taken_anew_each_time():
    assert int(subprocess.check_output([sys.executable, "-c", FAULTS])) < 10_000  # three arrays are 600


def test_another_c_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(provenance.ctypes, "CDLL", lambda name: object())
    return_what_is_freed()
