from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from fracbench.data.gray import to_gray
from fracbench.errors import InputError

LEVELS = [*range(0, 256, 17), 1, 127, 254]
COLOURS = np.array(list(itertools.product(LEVELS, repeat=3)), dtype=np.uint8).reshape(-1, len(LEVELS), 3)
WEIGHTS = (Fraction(299, 1000), Fraction(587, 1000), Fraction(114, 1000))


def exact(rgb: np.ndarray) -> Fraction:
    return sum((w * int(c) for w, c in zip(WEIGHTS, rgb, strict=True)), Fraction(0))


def test_integer_colour_is_the_exact_floor():
    expected = [[math.floor(exact(rgb)) for rgb in row] for row in COLOURS]
    np.testing.assert_array_equal(to_gray(COLOURS), expected)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.int64])
def test_integer_dtypes_agree(dtype):
    np.testing.assert_array_equal(to_gray(COLOURS.astype(dtype)), to_gray(COLOURS))


def test_sixteen_bit_values_do_not_overflow():
    assert to_gray(np.full((2, 2, 3), 65535, dtype=np.uint16)).max() == 65535
    assert to_gray(np.full((2, 2), 2**24 + 1)).max() == 2**24 + 1  # more than float32 holds


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_float_colour_has_the_same_weights_without_the_floor(dtype):
    expected = [[float(exact(rgb)) for rgb in row] for row in COLOURS]
    np.testing.assert_allclose(to_gray(COLOURS.astype(dtype)), expected, rtol=1e-14)


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.uint16, np.int16, np.int32, np.float16, np.float32, float])
def test_gray_passes_as_a_copy(dtype):
    image = np.arange(12).reshape(3, 4).astype(dtype)
    image.setflags(write=False)
    gray = to_gray(image)
    assert gray.dtype == (np.float32 if dtype in (bool, np.uint8, np.uint16, np.int16) else np.float64)
    assert gray.flags.c_contiguous and gray.flags.writeable
    assert not np.shares_memory(gray, image)
    np.testing.assert_array_equal(gray, image)
    np.testing.assert_array_equal(to_gray(image[..., np.newaxis]), image)


def test_float64_gray_is_copied_too():
    image = np.ones((3, 4))
    to_gray(image)[:] = 7.0
    assert (image == 1.0).all()


def test_alpha_is_ignored_even_where_it_is_nan():
    rgb = COLOURS.astype(np.float64)
    alpha = np.full((*rgb.shape[:2], 1), np.nan)
    np.testing.assert_array_equal(to_gray(np.concatenate([rgb, alpha], axis=2)), to_gray(rgb))


def test_nested_lists_will_do():
    np.testing.assert_array_equal(to_gray([[1, 2], [3, 4]]), [[1.0, 2.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros(4), r"shape \(4,\)"),
        (np.zeros((4, 4, 2)), r"shape \(4, 4, 2\)"),
        (np.zeros((3, 4, 4, 3)), r"shape \(3, 4, 4, 3\)"),
        (np.zeros((1, 9)), "1 x 9 pixels"),
        (np.zeros((9, 0)), "9 x 0 pixels"),
        (np.zeros((4, 4), dtype=complex), "complex128"),
        (np.zeros((4, 4), dtype=object), "object"),
        (np.zeros((4, 4), dtype="M8[s]"), "datetime64"),
        ("a.png", "dtype"),
        ([[1, 2], [3]], "not an array"),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(image, message):
    with pytest.raises(InputError, match=message) as caught:
        to_gray(image, name="frame 1")
    assert str(caught.value).startswith("frame 1: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("depth", [None, 3])
def test_pixels_that_are_not_finite_are_counted(depth):
    image = np.zeros((5, 6) if depth is None else (5, 6, depth))
    image[2, 3] = np.nan
    image[4, 1] = -np.inf
    with pytest.raises(InputError, match="2 of 30 pixels are NaN or infinite, the first at row 2, column 3"):
        to_gray(image)
