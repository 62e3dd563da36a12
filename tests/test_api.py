from __future__ import annotations

import base64
import inspect
import io
import re

import numpy as np
import pytest
import reference_impl as ref
import yaml
from PIL import Image

import fracbench
from fracbench import FlowParams, api, estimate_flow
from fracbench.errors import InputError
from fracbench.harness.config.paths import asset
from fracbench.methods.registry import get_method

QUICK = {"n_warps": 2, "max_iter": 5}


@pytest.fixture
def gray():
    """Two frames of whole gray levels in 0..255."""
    frames = np.stack(ref.translated_pair((20, 26), (0.7, -0.3)))
    return np.round(255 * (frames - frames.min()) / np.ptp(frames))


def estimate(frames, **values):
    return estimate_flow(*frames, **{**QUICK, **values})


def refused(message, frame0, frame1, **values):
    with pytest.raises(InputError, match=message) as caught:
        estimate_flow(frame0, frame1, **values)
    assert "\n" not in str(caught.value)


# -- what is accepted ----------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "int64", "float32", "float64", "float16"])
def test_every_real_type_gives_the_same_flow(gray, dtype):
    expected = estimate(gray).flow
    np.testing.assert_array_equal(estimate(gray.astype(dtype)).flow, expected)


def test_sixteen_bit_and_unit_range_agree_with_eight_bit(gray):
    expected = estimate(gray).flow
    np.testing.assert_allclose(estimate((gray * 257).astype(np.uint16)).flow, expected, atol=1e-4)
    np.testing.assert_allclose(estimate(gray / 255.0).flow, expected, atol=1e-4)


def test_colour_is_made_gray(gray):
    expected = estimate(gray).flow
    repeated = np.repeat(gray[..., None], 3, axis=-1)
    np.testing.assert_array_equal(estimate(gray[..., None]).flow, expected)
    np.testing.assert_array_equal(estimate(repeated.astype(np.uint8)).flow, expected)
    np.testing.assert_allclose(estimate(repeated).flow, expected, atol=1e-4)


def test_colours_have_their_weights(gray):
    green = np.zeros((2, 20, 26, 3))
    green[..., 1] = gray
    brighter = green.copy()
    brighter[0, ..., 0] = 500.0 * np.random.default_rng(0).uniform(size=(20, 26))
    np.testing.assert_allclose(estimate(green).flow, estimate(gray).flow, atol=1e-4)
    assert np.abs(estimate(brighter).flow - estimate(gray).flow).max() > 0.05


def test_the_alpha_channel_is_ignored(gray):
    rgb = np.repeat(gray[..., None], 3, axis=-1).astype(np.uint8)
    noise = np.random.default_rng(0).integers(0, 256, (2, 20, 26, 1), dtype=np.uint8)
    rgba = np.concatenate([rgb, noise], axis=-1)
    np.testing.assert_array_equal(estimate(rgba).flow, estimate(rgb).flow)


def test_lists_are_accepted(gray):
    np.testing.assert_array_equal(estimate(gray.astype(int).tolist()).flow, estimate(gray).flow)


def test_one_gray_and_one_colour_frame(gray):
    colour = np.repeat(gray[1][..., None], 3, axis=-1).astype(np.uint8)
    np.testing.assert_array_equal(estimate((gray[0], colour)).flow, estimate(gray).flow)


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha"])
def test_inputs_are_never_changed(gray, method):
    copy = gray.copy()
    gray.flags.writeable = False
    estimate(gray, method=method, presmoothing=0)
    np.testing.assert_array_equal(gray, copy)


def test_parameters_reach_the_method(gray):
    result = estimate(gray, alpha="0.4", lambda_=0.5, n_scales=1, boundary="zero")
    assert (result.params.alpha, result.params.lambda_, result.params.boundary) == (0.4, 0.5, "zero")
    assert len(result.levels) == 1
    same = estimate(gray, **{"alpha": 0.4, "lambda": 0.5, "n_scales": 1, "boundary": "zero"})
    np.testing.assert_array_equal(result.flow, same.flow)
    assert np.abs(result.flow - estimate(gray, n_scales=1).flow).max() > 1e-3


def test_the_defaults_are_the_recommended_preset(gray):
    result = estimate_flow(*gray)
    assert result.method == "tvl1_sb_alpha"
    assert result.params == FlowParams()
    assert (result.params.boundary, result.params.alpha) == ("reflect", 1.1)


def test_a_method_brings_its_own_defaults(gray):
    result = estimate(gray, method="tvl1_sb")
    assert (result.params.inner, result.params.u_solver) == ("cold", "gauss_seidel")
    assert estimate(gray, method="tvl1_sb", inner="warm").params.inner == "warm"


def test_a_protocol_gives_its_method_and_parameters_and_own_ones_win(gray):
    preset = yaml.safe_load(asset("conf/protocol/accurate.yaml").read_text(encoding="utf-8"))
    result = estimate_flow(*gray, protocol="accurate", n_warps=2)
    assert result.method == preset["method"]
    expected = {**preset["params"], "n_warps": 2}
    assert result.params == FlowParams().replace(get_method(preset["method"]).defaults).replace(expected)
    same = estimate_flow(*gray, method=preset["method"], **{**preset["params"], "n_warps": 2})
    np.testing.assert_array_equal(result.flow, same.flow)
    assert (
        estimate_flow(*gray, protocol="accurate", method="tvl1", max_iter=2).params.eta == preset["params"]["eta"]
    )


def test_the_default_protocol_is_the_file_of_that_name(gray, monkeypatch):
    quick = estimate(gray)
    monkeypatch.setattr(api, "DEFAULT_PROTOCOL", "none")  # so that the file is read
    read = estimate(gray, protocol="recommended")
    assert (read.method, read.params) == (quick.method, quick.params)


def test_peers_take_nothing_from_a_protocol(gray):
    pytest.importorskip("cv2", reason="needs the extra `peers`")
    plain = estimate_flow(*gray, method="opencv_dis")
    assert (plain.method, plain.stop_reason, plain.flow.dtype) == ("opencv_dis", "not told", np.float32)
    np.testing.assert_array_equal(estimate_flow(*gray, method="opencv_dis", protocol="accurate").flow, plain.flow)
    refused(
        "method 'opencv_dis': unknown parameter 'reset': did you mean 'preset'",
        *gray,
        method="opencv_dis",
        reset=1,
    )


def test_the_energy_is_traced_on_request(gray):
    assert estimate(gray).levels[0].energy == []
    traced = estimate(gray, trace=True)
    assert [len(trace) for trace in traced.levels[0].energy] == traced.iterations[0]


# -- what is refused -----------------------------------------------------------------------------


def test_frames_of_different_size_are_refused(gray):
    refused(r"frames differ in size: 26 x 20 and 25 x 20 \(width x height\)", gray[0], gray[1][:, :-1])
    refused("frames differ in size: 26 x 20 and 20 x 26", gray[0], gray[1].T)


@pytest.mark.parametrize("bad", [np.inf, -np.inf])
def test_pixels_that_are_infinite_are_refused(gray, bad):
    spoiled = gray[1].copy()
    spoiled[3, 5] = bad
    refused("frame1: 1 of 520 pixels are infinite, the first at row 3, column 5", gray[0], spoiled)
    refused("frame0: 1 of 520 pixels are infinite", spoiled, gray[1])


@pytest.mark.parametrize("shape", [(20, 1), (1, 20), (1, 1), (3, 20), (20, 2), (0, 5)])
def test_frames_that_are_too_small_are_refused(shape):
    refused("pixels are too (few|small)", np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros(9),
        np.zeros((5, 6, 2)),
        np.zeros((2, 5, 6, 3)),
        7.0,
        np.zeros((5, 6), complex),
        [["a"]],
        [[1, 2], [3]],
    ],
)
def test_what_is_no_picture_is_refused(gray, frame):
    refused("^frame0: ", frame, gray[1])
    refused("^frame1: ", gray[0], frame)


def test_unknown_methods_offer_the_nearest(gray):
    refused("unknown method 'tvl1_sb_alfa': did you mean 'tvl1_sb_alpha'?", *gray, method="tvl1_sb_alfa")
    refused(r"unknown method 'zzzz' \(allowed: .*tvl1, tvl1_sb, tvl1_sb_alpha", *gray, method="zzzz")


def test_unknown_protocols_offer_the_nearest(gray):
    refused("unknown protocol 'acurate': did you mean 'accurate'?", *gray, protocol="acurate")


def test_unknown_parameters_offer_the_nearest(gray):
    refused("unknown parameter 'lamda': did you mean 'lambda'?", *gray, lamda=0.3)
    refused("unknown parameter 'nwarps': did you mean 'n_warps'?", *gray, nwarps=3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"alpha": "abc"}, "`alpha` must be a number, got 'abc'"),
        ({"alpha": 2.5}, r"`alpha` must be in \[0, 2\], got 2.5"),
        ({"n_warps": 0}, "`n_warps` must be at least 1, got 0"),
        ({"boundary": "mirror"}, "unknown value of `boundary` 'mirror'"),
        ({"pad": 3}, "`pad` belongs to boundary=zero, got pad=3 with boundary=reflect"),
    ],
)
def test_bad_values_are_refused(gray, values, message):
    refused(message, *gray, **values)


def test_bad_parameters_are_refused_before_the_frames_are_looked_at():
    refused("`alpha` must be", np.zeros((1, 1)), np.zeros((1, 1)), alpha=3)


# -- a result shows itself ------------------------------------------------------------------------


def test_a_result_plots_itself(frames_of_a_shift):
    import matplotlib

    matplotlib.use("Agg")
    result = estimate_flow(*frames_of_a_shift)
    ax = result.plot(max_motion=4)
    assert ax.get_title() == "full colour: 4 px"
    np.testing.assert_array_equal(ax.images[0].get_array(), fracbench.flow_to_color(result.flow, 4))
    assert result.plot(ax) is ax and len(ax.images) == 2


def test_a_result_shows_itself_in_a_notebook(frames_of_a_shift):
    frame0, frame1 = frames_of_a_shift
    frame1 = frame1.copy()
    frame1[0, 0] = np.nan
    html = estimate_flow(frame0, frame1)._repr_html_()
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', html)[1]
    with Image.open(io.BytesIO(base64.b64decode(picture))) as shown:
        assert shown.size == frame0.shape[::-1]
    text = re.search("<figcaption>(.+)</figcaption>", html)[1]
    assert re.match(r"tvl1_sb_alpha: 48 x 40 px, \d+ iterations, \d+\.\d\d s; ", text)
    assert "frame1: 1 of 1920 pixels are NaN" in text
    assert f'alt="{text}"' in html


@pytest.fixture
def frames_of_a_shift():
    frame = np.random.default_rng(4).uniform(0, 255, (40, 48))
    return frame, np.roll(frame, 1, axis=1)


# -- the package ---------------------------------------------------------------------------------


def test_the_default_preset_and_a_misspelt_name():
    assert inspect.signature(estimate_flow).parameters["protocol"].default == api.DEFAULT_PROTOCOL
    with pytest.raises(AttributeError, match="no attribute 'estimate_fow'"):
        _ = fracbench.estimate_fow
