from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fracbench.data.pair import FramePair
from fracbench.data.regions import Region, crop, shifted
from fracbench.errors import InputError

H, W = 30, 41
FRAME = np.arange(float(H * W)).reshape(H, W)
SEQUENCE = FramePair("S", "synthetic", FRAME, FRAME + 0.5, np.stack([FRAME, -FRAME]), "0" * 64)


def bounds(size: int) -> st.SearchStrategy[tuple[int, int]]:
    return st.integers(0, size - 2).flatmap(lambda a: st.tuples(st.just(a), st.integers(a + 2, size)))


@given(bounds(H), bounds(W), st.integers(0, 50))
def test_crop_is_the_grown_box_and_inner_the_box_itself(rows, cols, context):
    frame0, frame1, truth, inner = crop(SEQUENCE, Region("r", "S", rows, cols), context)
    kept_rows = [r for r in range(H) if rows[0] - context <= r < rows[1] + context]
    kept_cols = [c for c in range(W) if cols[0] - context <= c < cols[1] + context]
    np.testing.assert_array_equal(frame0, FRAME[np.ix_(kept_rows, kept_cols)])
    np.testing.assert_array_equal(frame1, frame0 + 0.5)
    np.testing.assert_array_equal(truth, [frame0, -frame0])
    np.testing.assert_array_equal(frame0[inner], FRAME[rows[0] : rows[1], cols[0] : cols[1]])
    assert frame0.flags.c_contiguous and frame1.flags.c_contiguous and truth.flags.c_contiguous


def test_crop_without_truth():
    sequence = FramePair("s", "synthetic", FRAME, FRAME, None, "0" * 64)
    assert crop(sequence, Region("r", "S", (0, 5), (0, 5)))[2] is None


@given(bounds(H), bounds(W), st.integers(1, 12), st.sampled_from([1, 3, 5]))
def test_shifted_boxes(rows, cols, step, n):
    region = Region("r", "S", rows, cols)
    boxes = shifted(region, (H, W), step, n)
    assert len(boxes) == n * n and boxes[n * n // 2] == region
    assert len({box.name for box in boxes}) == n * n
    shifts = [step * k for k in range(-(n // 2), n // 2 + 1)]
    for box, (down, right) in zip(boxes, itertools.product(shifts, shifts), strict=True):
        assert box.shape == region.shape and box.sequence == "S"
        for (first, stop), origin, by, size in ((box.rows, rows, down, H), (box.cols, cols, right, W)):
            assert 0 <= first < stop <= size
            free = origin[0] + by >= 0 and origin[1] + by <= size
            assert first == origin[0] + by if free else (first == 0 if by < 0 else stop == size)


def test_twenty_five_by_default():
    boxes = shifted(Region("r", "S", (100, 140), (100, 140)), (300, 300))
    assert len({(box.rows, box.cols) for box in boxes}) == 25
    assert {box.rows[0] for box in boxes} == {84, 92, 100, 108, 116}
    assert boxes[0].name == "r-16-16" and boxes[12].name == "r" and boxes[13].name == "r+0+8"


@pytest.mark.parametrize("field", ["rows", "cols"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        ((5, 5), "5:5 must"),
        ((5, 6), "5:6 must"),
        ((9, 5), "9:5 must"),
        ((-1, 5), "-1:5 must"),
        ((1.0, 5), "must be two integers"),
        ((1, 5, 9), "must be two integers"),
        (None, "must be two integers"),
    ],
)
def test_bounds_are_validated(field, value, message):
    with pytest.raises(InputError, match=f"region 'r': `{field}` {message}"):
        Region(**{"name": "r", "sequence": "S", "rows": (0, 9), "cols": (0, 9), field: value})


def test_bounds_become_plain_integers():
    region = Region("r", "S", [np.int64(2), 9], (0, 4))
    assert region.rows == (2, 9) and type(region.rows[0]) is int
    assert region.shape == (7, 4)
    assert hash(region) == hash(Region("r", "S", (2, 9), (0, 4)))


@pytest.mark.parametrize(("rows", "cols"), [((0, H + 1), (0, 5)), ((0, 5), (20, W + 3))])
def test_a_region_outside_the_picture_names_the_sizes(rows, cols):
    region = Region("r", "S", rows, cols)
    for act in (lambda: crop(SEQUENCE, region, 100), lambda: shifted(region, (H, W))):
        with pytest.raises(InputError, match=f"{rows[1]}, columns {cols[0]}:{cols[1]} leave .* of {H} x {W}"):
            act()


def test_other_misuse():
    region = Region("r", "Grove2", (0, 5), (0, 5))
    with pytest.raises(InputError, match="region 'r' belongs to 'Grove2', not to 'S'"):
        crop(SEQUENCE, region)
    with pytest.raises(InputError, match="`context` must not be negative, got -1"):
        crop(SEQUENCE, Region("r", "S", (0, 5), (0, 5)), -1)
    for step, n in ((0, 5), (8, 4), (8, -1)):
        with pytest.raises(InputError, match=f"got {step} and {n}"):
            shifted(region, (H, W), step, n)
