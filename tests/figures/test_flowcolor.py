from __future__ import annotations

import math

import numpy as np
import pytest

from fracbench.errors import InputError
from fracbench.figures.flowcolor import color_wheel, fastest, flow_to_color, wheel_colours

BLACK, WHITE = (0, 0, 0), (255, 255, 255)


def at(u: float, v: float) -> np.ndarray:
    return np.array([u, v], dtype=np.float64).reshape(2, 1, 1)


def colour(u: float, v: float, max_motion: float | None = None) -> tuple[int, ...]:
    return tuple(int(c) for c in flow_to_color(at(u, v), max_motion)[0, 0])


def literal_wheel() -> list[tuple[int, int, int]]:
    """The wheel as Baker et al. define it: six arcs of integer steps."""
    wheel = [(255, 255 * i // 15, 0) for i in range(15)]
    wheel += [(255 - 255 * i // 6, 255, 0) for i in range(6)]
    wheel += [(0, 255, 255 * i // 4) for i in range(4)]
    wheel += [(0, 255 - 255 * i // 11, 255) for i in range(11)]
    wheel += [(255 * i // 13, 0, 255) for i in range(13)]
    return wheel + [(255, 0, 255 - 255 * i // 6) for i in range(6)]


def literal_colour(u: float, v: float, max_motion: float) -> list[float]:
    """One pixel at a time, before truncation to whole numbers."""
    wheel = literal_wheel()
    radius = math.sqrt(u * u + v * v) / max_motion
    position = (math.atan2(-v, -u) / math.pi + 1) / 2 * 54
    first = int(position)
    part = position - first
    result = []
    for a, b in zip(wheel[first], wheel[(first + 1) % 55], strict=True):
        hue = ((1 - part) * a + part * b) / 255
        result.append(255 * (1 - radius * (1 - hue) if radius <= 1 else 0.75 * hue))
    return result


def test_wheel_has_the_55_colours_of_the_definition() -> None:
    np.testing.assert_array_equal(wheel_colours(), np.array(literal_wheel()))


@pytest.mark.parametrize(
    ("direction", "expected"),
    [((1, 0), (255, 0, 0)), ((0, 1), (255, 229, 0)), ((-1, 0), (0, 209, 255)), ((0, -1), (88, 0, 255))],
    ids=["right", "down", "left", "up"],
)
def test_axis_directions(direction: tuple[int, int], expected: tuple[int, ...]) -> None:
    # The circle has 54 steps, so the axes are at 0, 13.5, 27 and 40.5; a half is the mean of two colours.
    assert colour(*direction) == expected


def test_agrees_with_the_literal_code_pixel_by_pixel() -> None:
    flow = np.random.default_rng(3).normal(scale=2.0, size=(2, 23, 31))
    got = flow_to_color(flow, 3.0)
    assert got.dtype == np.uint8 and got.shape == (23, 31, 3)
    want = [[literal_colour(*flow[:, i, j], 3.0) for j in range(31)] for i in range(23)]
    difference = np.array(want) - got
    assert difference.min() > -1e-9 and difference.max() < 1 + 1e-9  # truncated, never rounded up


@pytest.mark.parametrize("max_motion", [None, 1.0, 7.5])
def test_no_motion_is_white(max_motion: float | None) -> None:
    assert (flow_to_color(np.zeros((2, 4, 5)), max_motion) == 255).all()


def test_the_sign_of_a_zero_does_not_matter() -> None:
    assert colour(1.0, -0.0) == colour(1.0, 0.0) == (255, 0, 0)
    assert colour(-0.0, 1.0) == colour(0.0, 1.0)
    assert colour(-0.0, -0.0) == WHITE


def test_opposite_directions_lie_half_the_wheel_apart() -> None:
    for step in range(1, 27):
        angle = 2 * math.pi * step / 54
        there, back = (
            colour(math.cos(angle), math.sin(angle), 1.0),
            colour(-math.cos(angle), -math.sin(angle), 1.0),
        )
        wheel = literal_wheel()
        assert np.abs(np.subtract(there, wheel[step])).max() <= 1
        assert np.abs(np.subtract(back, wheel[step + 27])).max() <= 1


def test_colour_belongs_to_the_pixel_not_to_its_place() -> None:
    flow = np.random.default_rng(5).normal(size=(2, 6, 9))
    np.testing.assert_array_equal(flow_to_color(flow)[::-1, ::-1], flow_to_color(flow[:, ::-1, ::-1]))
    np.testing.assert_array_equal(flow_to_color(flow).transpose(1, 0, 2), flow_to_color(flow.transpose(0, 2, 1)))


@pytest.mark.parametrize("unknown", [np.nan, np.inf, -np.inf, 1.666666752e9, -2e9])
@pytest.mark.parametrize("component", [0, 1])
def test_unknown_is_black_and_does_not_set_the_scale(unknown: float, component: int) -> None:
    flow = np.ones((2, 1, 3))
    flow[component, 0, 1] = unknown
    picture = flow_to_color(flow)
    assert tuple(picture[0, 1]) == BLACK
    np.testing.assert_array_equal(picture[:, ::2], flow_to_color(np.ones((2, 1, 2))))
    assert fastest(flow) == pytest.approx(math.sqrt(2))


def test_all_unknown_is_all_black() -> None:
    flow = np.full((2, 3, 3), np.nan)
    assert (flow_to_color(flow) == 0).all()
    assert fastest(flow) == 0.0


def test_beyond_the_range_is_the_full_colour_dimmed() -> None:
    angle = 2 * math.pi * 20 / 54
    u, v = math.cos(angle), math.sin(angle)
    full, beyond = colour(u, v, 1.0), colour(4 * u, 4 * v, 1.0)
    assert np.abs(np.array(beyond) - 0.75 * np.array(full)).max() <= 1
    assert beyond == colour(9 * u, 9 * v, 1.0)


def test_a_scale_rounded_down_to_float32_does_not_dim_the_fastest_pixel() -> None:
    flow = np.array([[[0.3, 0.1]], [[0.1, 0.2]]])
    scale = float(np.float32(fastest(flow)))
    assert scale < fastest(flow)
    np.testing.assert_array_equal(flow_to_color(flow, scale), flow_to_color(flow))


def test_scaling_flow_and_range_together_changes_nothing() -> None:
    flow = np.random.default_rng(8).normal(size=(2, 7, 8))
    np.testing.assert_array_equal(flow_to_color(4.0 * flow, 8.0), flow_to_color(flow, 2.0))
    np.testing.assert_array_equal(flow_to_color(0.25 * flow), flow_to_color(flow))


def test_slower_is_paler() -> None:
    fast, slow = np.array(colour(-2, 1, 4.0)), np.array(colour(-1, 0.5, 4.0))
    assert (slow >= fast).all() and slow.sum() > fast.sum()


def test_input_is_not_changed() -> None:
    flow = np.random.default_rng(9).normal(size=(2, 3, 4))
    flow[0, 0, 0] = np.nan
    before = flow.copy()
    flow.setflags(write=False)
    flow_to_color(flow)
    np.testing.assert_array_equal(flow, before)


def test_color_wheel_shows_the_motion_from_its_centre() -> None:
    picture = color_wheel(101)
    assert picture.shape == (101, 101, 3) and picture.dtype == np.uint8
    assert tuple(picture[50, 50]) == WHITE
    assert tuple(picture[0, 0]) == tuple(picture[100, 100]) == WHITE
    for (row, column), direction in {(50, 100): (1, 0), (100, 50): (0, 1), (50, 0): (-1, 0)}.items():
        assert tuple(picture[row, column]) == colour(*direction, 1.0)


@pytest.mark.parametrize("shape", [(3, 4), (3, 4, 2), (1, 2, 3, 4), (2,)])
def test_wrong_shape_is_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"\(2, H, W\), got \("):
        flow_to_color(np.zeros(shape))


@pytest.mark.parametrize("max_motion", [0.0, -1.0, np.nan, np.inf])
def test_bad_range_is_named(max_motion: float) -> None:
    with pytest.raises(InputError, match="`max_motion` must be a positive number of pixels, got"):
        flow_to_color(np.zeros((2, 2, 2)), max_motion)


def test_bad_wheel_size_is_named() -> None:
    with pytest.raises(InputError, match="`size` must be at least 2 pixels, got 1"):
        color_wheel(1)
