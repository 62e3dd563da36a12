"""CIE Lab, and colours as the guide of the weighted median."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench import estimate_flow
from fracbench.errors import InputError
from fracbench.model.color import cie_lab, color_guides
from fracbench.model.params import FlowParams

GUIDED = {
    "method": "tvl1_sb_alpha_ic", "weighted_radius": 2, "n_scales": 2, "n_warps": 2, "max_iter": 3,
    "gradient_scale": 0.1,
}  # fmt: skip


@pytest.fixture
def frames():
    return np.random.default_rng(3).integers(0, 256, (2, 24, 30, 3)).astype(np.uint8)


def test_lab_of_known_colours():
    """The values of sRGB's white, black, red and blue in every table of CIE Lab, white D65."""
    known = {(1, 1, 1): (100, 0, 0), (0, 0, 0): (0, 0, 0), (1, 0, 0): (53.24, 80.09, 67.20),
             (0, 0, 1): (32.30, 79.19, -107.86)}  # fmt: skip
    for rgb, lab in known.items():
        np.testing.assert_allclose(cie_lab(np.array(rgb)), lab, atol=0.03)


def test_lab_is_that_of_another_program():
    color = pytest.importorskip("skimage.color")
    rgb = np.random.default_rng(0).uniform(0.0, 1.0, (20, 20, 3)) ** 3
    np.testing.assert_allclose(np.moveaxis(cie_lab(rgb), 0, -1), color.rgb2lab(rgb), atol=0.02)


def test_guides_do_not_depend_on_the_scale_of_the_colours(frames):
    params = FlowParams(n_scales=2)
    whole = color_guides(frames[0], (24, 30), params)
    assert list(whole) == [(24, 30), (12, 15)] and whole[12, 15].shape == (3, 12, 15)
    for scaled in (frames[0].astype(np.uint16) * 257, frames[0] / 255.0):
        for size, guide in color_guides(scaled, (24, 30), params).items():
            np.testing.assert_allclose(guide, whole[size], atol=1e-3)


def test_masked_colours_do_not_count(frames):
    mask = np.zeros((24, 30), bool)
    mask[5:9, 7:12] = True
    other = frames[0].astype(float)
    other[mask] = np.nan
    params = FlowParams(n_scales=1)
    guides = [color_guides(color, (24, 30), params, mask)[24, 30] for color in (frames[0].astype(float), other)]
    np.testing.assert_array_equal(*guides)


def test_colours_count_only_where_they_are_asked_for(frames):
    same = [np.repeat(frame[..., :1], 3, axis=2) for frame in frames]
    gray, color = (estimate_flow(*frames, weighted_guide=guide, **GUIDED).flow for guide in ("gray", "color"))
    assert np.isfinite(color).all() and (gray != color).any()
    plain = estimate_flow(*(f[..., 0] for f in same), **GUIDED).flow
    np.testing.assert_array_equal(estimate_flow(*same, **GUIDED).flow, plain)


def test_the_flow_back_follows_the_colours_of_frame_1(frames):
    both = estimate_flow(*frames, weighted_guide="color", confidence=True, **GUIDED)
    back = estimate_flow(*frames[::-1], weighted_guide="color", **GUIDED).flow
    again = estimate_flow(*frames[::-1], weighted_guide="color", confidence=True, **GUIDED)
    np.testing.assert_array_equal(again.flow, back)
    assert both.confidence is not None and both.confidence.distance.shape == back.shape[1:]


def test_gray_frames_have_no_colour(frames):
    with pytest.raises(InputError, match="weighted_guide=color needs frames in colour"):
        estimate_flow(frames[0, ..., 0], frames[1, ..., 0], weighted_guide="color", **GUIDED)


def test_transposing_the_frames_transposes_the_flow(frames):
    here, there = (
        estimate_flow(*pair, weighted_guide="color", **GUIDED).flow
        for pair in (frames, [frame.transpose(1, 0, 2) for frame in frames])
    )
    # In single precision; with numba 0.60 they differ by up to 1.1e-4.
    np.testing.assert_allclose(there, here[::-1].transpose(0, 2, 1), atol=3e-4)


def test_an_unknown_guide_is_refused(frames):
    with pytest.raises(InputError, match="unknown value of `weighted_guide` 'colour': did you mean 'color'"):
        estimate_flow(*frames, weighted_guide="colour", **GUIDED)
