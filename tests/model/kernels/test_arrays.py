from __future__ import annotations

import numpy as np
import pytest

from fracbench.model.kernels.arrays import aligned


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1,), (3, 5), (2, 2, 480, 640)])
def test_aligned_arrays_are_zeros_that_begin_with_a_line_of_the_cache(shape, dtype):
    for _ in range(4):  # wherever the allocator puts them
        array = aligned(shape, dtype)
        assert array.shape == shape
        assert array.dtype == dtype
        assert array.flags.c_contiguous
        assert array.flags.writeable
        assert array.ctypes.data % 64 == 0
        assert not array.any()
        array[...] = 1.0  # what the next must not find again
