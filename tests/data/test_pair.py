from __future__ import annotations

import numpy as np
import pytest

from fracbench.data.datasets.registry import list_sequences, load_sequence
from fracbench.data.pair import FramePair
from fracbench.errors import InputError


def make(**changes) -> FramePair:
    fields = {
        "name": "a",
        "dataset": "synthetic",
        "frame0": np.arange(12).reshape(3, 4),
        "frame1": np.ones((3, 4)),
        "truth": np.zeros((2, 3, 4)),
        "digest": "0" * 64,
    }
    return FramePair(**{**fields, **changes})


def test_arrays_are_frozen_copies_of_the_right_dtype():
    given = np.ones((3, 4))
    sequence = make(frame1=given, frame0_color=np.zeros((3, 4, 3), dtype=np.uint8))
    assert sequence.shape == (3, 4)
    dtypes = {"frame0": np.float64, "frame1": np.float64, "truth": np.float32, "frame0_color": np.uint8}
    for field, dtype in dtypes.items():
        array = getattr(sequence, field)
        assert array.dtype == dtype and array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    given[0, 0] = 5.0
    assert sequence.frame1[0, 0] == 1.0


def test_truth_and_colour_may_be_absent():
    sequence = make(truth=None)
    assert sequence.truth is None and sequence.frame0_color is None


@pytest.mark.parametrize(
    ("field", "shape"), [("frame0", (3, 4, 3)), ("frame1", (4, 3)), ("truth", (3, 4, 2)), ("frame0_color", (3, 4))]
)
def test_shapes_must_belong_together(field, shape):
    with pytest.raises(InputError, match=f"sequence 'a': {field} has the shape"):
        make(**{field: np.zeros(shape)})


def test_unknown_names_get_the_nearest():
    with pytest.raises(InputError, match="unknown dataset 'midlebury': did you mean 'middlebury'"):
        list_sequences("midlebury")
    with pytest.raises(InputError, match="unknown dataset 'auto'"):
        load_sequence("edge", "auto")
    with pytest.raises(InputError, match="unknown synthetic sequence 'coner': did you mean 'corner'"):
        load_sequence("coner", "synthetic")
    with pytest.raises(InputError, match="unknown middlebury sequence 'RubberWale': did you mean 'RubberWhale'"):
        load_sequence("RubberWale", "middlebury")
