from __future__ import annotations

import numba
import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.methods.registry import get_method
from fracbench.model import params as parameters
from fracbench.model.params import FlowParams

OURS = ("tvl1", "tvl1_sb", "tvl1_sb_alpha")
METHODS = pytest.mark.parametrize("method", OURS)
needs_compiler = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="takes minutes without compilation")

SHAPE = (48, 56)
ACCURATE = {"lambda": 1.0, "epsilon": 1e-3, "tol": 3e-4, "max_inner": 200}


def run(method, frame0, frame1, *, trace=False, **values):
    chosen = get_method(method)
    params = FlowParams().replace(chosen.defaults).replace(values)
    return chosen.estimate(frame0, frame1, params, trace=trace)


def end_point_error(flow, motion, margin=8):
    error = np.hypot(flow[0] - motion[0], flow[1] - motion[1])
    return error[margin:-margin, margin:-margin]


# -- flows that are known ------------------------------------------------------------------------


@METHODS
@pytest.mark.parametrize("boundary", ["reflect", "zero"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_zero_motion_gives_exactly_zero_flow(method, boundary, dtype):
    frame = np.random.default_rng(0).uniform(0, 255, (19, 22))
    result = run(method, frame, frame, boundary=boundary, dtype=dtype, n_warps=2)
    np.testing.assert_array_equal(result.flow, 0.0)
    assert result.stop_reason == "converged"


@METHODS
def test_constant_frames_give_zero_flow(method):
    frame = np.full((16, 16), 80.0)
    np.testing.assert_array_equal(run(method, frame, frame, n_warps=1).flow, 0.0)


@needs_compiler
@METHODS
@pytest.mark.parametrize("motion", [(0.6, -0.4), (2.6, -1.7), (-3.0, 0.0)])
def test_a_translated_texture_is_recovered(method, motion):
    frames = ref.translated_pair(SHAPE, motion)
    flow = run(method, *frames, **ACCURATE).flow
    assert end_point_error(flow, motion).max() < 0.02


@needs_compiler
@METHODS
def test_components_and_signs(method):
    """To the right is positive u1, down is positive u2: frame0(x, y) = frame1(x + u1, y + u2)."""
    y, x = np.mgrid[:32, :32].astype(float)

    def blob(cx, cy):
        return np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 40.0)

    flow = run(method, blob(14, 16), blob(15.5, 15.5), **{"lambda": 1.0}).flow
    np.testing.assert_allclose(flow[:, 16, 14], [1.5, -0.5], atol=0.1)


@needs_compiler
@METHODS
def test_relinearisation_is_needed(method):
    motion = (3.0, 0.0)
    frames = ref.translated_pair(SHAPE, motion)
    renewed = run(method, *frames, **ACCURATE)
    fixed = run(method, *frames, relinearise=False, **ACCURATE)
    assert end_point_error(renewed.flow, motion).mean() < 0.02
    assert end_point_error(fixed.flow, motion).mean() > 0.3


# -- symmetry and precision ----------------------------------------------------------------------


@needs_compiler
@METHODS
def test_float32_agrees_with_float64(method):
    frames = ref.translated_pair((32, 40), (1.2, 0.7))
    flows = [run(method, *frames, dtype=dtype).flow for dtype in ("float32", "float64")]
    np.testing.assert_allclose(*flows, atol=1e-3)
    assert np.abs(flows[0] - flows[1]).max() > 0.0  # the setting is not ignored


def flipped(flow, axis):
    """The mirror image of a flow: positions are reversed along the axis, and one component changes its sign."""
    result = np.flip(flow, axis + 1).copy()
    result[1 - axis] *= -1.0
    return result


@needs_compiler
@pytest.mark.parametrize("axis", [0, 1])
def test_flipped_frames_give_the_flipped_flow(axis):
    frames = ref.translated_pair((33, 41), (0.6, -0.4))
    mirrored = [np.flip(frame, axis) for frame in frames]
    difference = {}
    for boundary in ("reflect", "zero"):
        settings = {"boundary": boundary, "lambda": 1.0, "epsilon": 1e-3}
        flow, turned = (run("tvl1_sb_alpha", *pair, **settings).flow for pair in (frames, mirrored))
        difference[boundary] = np.abs(flipped(turned, axis) - flow).max()
    assert difference["reflect"] < 0.01
    assert difference["zero"] > 0.05  # the paper's boundary pulls at the left and top edge only


@needs_compiler
@METHODS
def test_transposed_frames_give_the_transposed_flow(method):
    frames = ref.translated_pair((32, 40), (0.6, -0.4))
    exact = {"u_solver": "exact"} if method != "tvl1" else {}
    flow = run(method, *frames, **exact).flow
    turned = run(method, *(frame.T for frame in frames), **exact).flow
    np.testing.assert_allclose(turned[::-1].transpose(0, 2, 1), flow, atol=1e-3)


@needs_compiler
@METHODS
@pytest.mark.parametrize(("gain", "offset"), [(257.0, 0.0), (1.0 / 255.0, 0.0), (0.25, 40.0)])
def test_the_scale_of_intensities_does_not_matter(method, gain, offset):
    frames = ref.translated_pair((24, 28), (0.6, -0.4))
    flow = run(method, *frames).flow
    np.testing.assert_allclose(run(method, *(gain * f + offset for f in frames)).flow, flow, atol=1e-3)


# -- the loop of Algorithm 2, written out --------------------------------------------------------


def test_two_warps_of_three_iterations_by_the_literal_loops():
    rng = np.random.default_rng(8)
    frame0, frame1 = rng.uniform(0, 255, (2, 10, 12))
    frame0[0, :2] = 0.0, 255.0  # so that stretching changes nothing
    lambda_, theta, tau = 0.2, 0.3, 0.25
    result = run(
        "tvl1", frame0, frame1, dtype="float64", presmoothing=0.0, n_scales=1, n_warps=2, max_iter=3, epsilon=0.0,
        theta=theta, tau=tau, **{"lambda": lambda_},
    )  # fmt: skip
    gradient1 = ref.central_gradient(frame1)
    u, p = np.zeros((2, 10, 12)), np.zeros((2, 2, 10, 12))
    for _ in range(2):
        rho_c, gradient = ref.linearize(frame0, frame1, gradient1, u)
        for _ in range(3):
            v = ref.threshold(u, rho_c, gradient, lambda_, theta)
            for c in range(2):
                u[c], p[c] = ref.dual_step(v[c], p[c], theta, tau)
    np.testing.assert_allclose(result.flow, u, atol=1e-5)
    assert np.abs(u).max() > 1.0
    assert result.iterations == [[3, 3]]
    assert result.stop_reason == "max_iter"


# -- what is reported ----------------------------------------------------------------------------


@METHODS
def test_the_result_describes_itself(method):
    frames = ref.translated_pair((19, 26), (0.3, 0.2))
    result = run(method, *frames, n_warps=3, max_iter=4)
    assert result.flow.shape == (2, 19, 26) and result.flow.dtype == np.float32
    assert result.method == method
    assert result.params.max_iter == 4
    assert [level.shape for level in result.levels] == [(10, 13), (19, 26)]
    assert all(len(scale) == 3 and all(1 <= n <= 4 for n in scale) for scale in result.iterations)
    assert all(len(level.stop) == len(level.inner_iterations) == 3 for level in result.levels)
    assert set(result.seconds) == {"pyramid", "setup", "warping", "solving"}
    assert all(seconds >= 0.0 for seconds in result.seconds.values())
    assert result.notices == []


def test_inner_iterations_count_both_components_when_cold():
    frames = ref.translated_pair((16, 20), (0.3, 0.2))
    warm = run("tvl1_sb_alpha", *frames, n_warps=2, max_iter=3, epsilon=0.0, n_scales=1)
    cold = run(
        "tvl1_sb_alpha",
        *frames,
        n_warps=2,
        max_iter=3,
        epsilon=0.0,
        n_scales=1,
        inner="cold",
        tol=0.0,
        max_inner=5,
    )
    assert warm.levels[0].inner_iterations == [3, 3]
    assert cold.levels[0].inner_iterations == [30, 30]


@METHODS
def test_stop_reasons(method):
    frames = ref.translated_pair((16, 20), (0.8, 0.5))
    limited = run(method, *frames, max_iter=2, epsilon=0.0, n_warps=2, n_scales=1)
    assert limited.stop_reason == "max_iter"
    assert limited.ending.startswith("all 2 warps reached the limit of 2 iterations; the last iteration changed")
    assert limited.iterations == [[2, 2]]
    converged = run(method, *frames, epsilon=10.0, n_warps=2, n_scales=1)
    assert converged.stop_reason == "converged"
    assert converged.iterations == [[1, 1]]
    assert converged.ending.startswith("all 2 warps converged; the last iteration changed the flow by ")


def test_the_last_change_is_told_in_pixels_of_the_frames():
    frames = ref.translated_pair((40, 48), (0.8, 0.5))
    settings = {"epsilon": 0.0, "n_warps": 1, "n_scales": 2, "upsample_gain": None}
    shorter, longer = (run("tvl1", *frames, max_iter=n, finest_scale=1, **settings) for n in (6, 7))
    change = np.sqrt(np.square(longer.flow - shorter.flow).sum(axis=0).mean())
    assert 2 * longer.levels[-1].change[-1] == pytest.approx(change, rel=0.1)
    assert longer.ending.endswith(
        f"the last iteration changed the flow by {2 * longer.levels[0].change[0]:.2g} px"
    )


def test_warps_of_either_end_are_counted():
    frames = ref.translated_pair((16, 20), (0.8, 0.5))
    mixed = run("tvl1_sb_alpha", *frames, epsilon=0.05, n_warps=6, max_iter=6, n_scales=1)
    stops = mixed.levels[0].stop
    assert 0 < stops.count("max_iter") < 6
    assert mixed.ending.startswith(f"{stops.count('max_iter')} of 6 warps reached the limit of 6 iterations; ")


def test_the_stopping_threshold_is_squared_unless_told_otherwise():
    frames = ref.translated_pair((16, 20), (0.8, 0.5))
    settings = {"n_scales": 1, "n_warps": 1, "epsilon": 1e-4, "max_iter": 200}
    squared = run("tvl1_sb_alpha", *frames, **settings)
    plain = run("tvl1_sb_alpha", *frames, **settings, epsilon_squared=False)
    rooted = run("tvl1_sb_alpha", *frames, **{**settings, "epsilon": 1e-2})
    np.testing.assert_array_equal(plain.flow, rooted.flow)
    assert squared.iterations[0][0] > plain.iterations[0][0]


def test_fewer_scales_than_asked_for_are_noticed():
    frames = ref.translated_pair((16, 40), (0.3, 0.2))
    reduced = run("tvl1", *frames, n_scales=9, n_warps=1)
    assert len(reduced.levels) == 2
    assert len(reduced.notices) == 1
    assert reduced.notices[0].startswith("n_scales reduced from 9 to 2")
    assert run("tvl1", *frames, n_scales=2, n_warps=1).notices == []
    assert run("tvl1", *frames, n_warps=1).notices == []


@METHODS
def test_the_flow_of_a_coarser_scale_is_upsampled(method):
    shape, motion = (47, 61), (2.6, -1.7)
    result = run(method, *ref.translated_pair(shape, motion), finest_scale=1, **ACCURATE)
    assert result.flow.shape == (2, *shape)
    assert [level.shape for level in result.levels] == [(12, 16), (24, 31)]
    assert end_point_error(result.flow, motion).max() < 0.1
    assert result.notices == []


def test_the_coarsest_scale_is_computed_in_any_case():
    frames = ref.translated_pair((16, 40), (0.3, 0.2))
    result = run("tvl1", *frames, finest_scale=7, n_warps=1)
    assert [level.shape for level in result.levels] == [(8, 20)]
    assert result.notices == ["finest_scale reduced from 7 to 1, the coarsest scale"]


def test_a_run_that_overflows_is_reported_as_diverged(monkeypatch):
    """The gain is out of its range, because nothing within the ranges overflows."""
    monkeypatch.setattr(parameters, "_check_range", lambda *_: None)
    frames = ref.translated_pair((16, 40), (0.8, 0.5))
    with np.errstate(over="ignore", invalid="ignore"):
        result = run("tvl1_sb_alpha", *frames, upsample_gain=1e38, n_warps=2, max_iter=5, **{"lambda": 100.0})
    assert result.stop_reason == "diverged"
    assert result.levels[0].stop != ["diverged"]


# -- the energy ----------------------------------------------------------------------------------


@METHODS
def test_the_energy_is_traced_on_request_and_falls(method):
    frames = ref.translated_pair((20, 24), (0.8, 0.5))
    settings = {"epsilon": 1e-3, "n_warps": 2, "max_iter": 15, "presmoothing": 0.0}
    traced = run(method, *frames, trace=True, **settings)
    silent = run(method, *frames, **settings)
    np.testing.assert_array_equal(traced.flow, silent.flow)
    assert all(level.energy == [] for level in silent.levels)
    for level in traced.levels:
        assert [len(trace) for trace in level.energy] == level.iterations
    first = traced.levels[0].energy[0]
    assert len(first) > 3
    assert first[-1] < 0.995 * first[0]


@needs_compiler
@pytest.mark.parametrize(
    ("method", "boundary"), [("tvl1_sb", "reflect"), ("tvl1_sb_alpha", "reflect"), ("tvl1_sb_alpha", "zero")]
)
def test_solved_to_the_end_each_iteration_lowers_the_energy(method, boundary):
    frames = ref.translated_pair((12, 14), (0.8, 0.5))
    result = run(
        method, *frames, trace=True, boundary=boundary, dtype="float64", u_solver="exact", inner="cold",
        coupling="penalty", tol=1e-6, max_inner=300, n_warps=2, max_iter=10, n_scales=1, epsilon=0.0,
    )  # fmt: skip
    for trace in result.levels[0].energy:
        assert len(trace) == 10
        assert np.diff(trace).max() <= 1e-6 * trace[0]


# -- inputs --------------------------------------------------------------------------------------


@METHODS
def test_inputs_may_be_read_only_views_and_are_never_changed(method):
    wide = np.random.default_rng(1).uniform(0, 255, (2, 18, 44))
    frames = wide[:, ::-1, ::2]
    copy = frames.copy()
    wide.flags.writeable = False
    for presmoothing in (0.0, 0.6):
        settings = {"presmoothing": presmoothing, "n_warps": 2, "max_iter": 3}
        flow = run(method, *frames, **settings).flow
        np.testing.assert_array_equal(flow, run(method, *copy, **settings).flow)
    np.testing.assert_array_equal(frames, copy)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (((16, 20), (16, 21)), r"frames differ in size: 20 x 16 and 21 x 16 \(width x height\)"),
        (((3, 20), (3, 20)), "frames of 20 x 3 pixels are too small: at least 4 x 4 are needed"),
        (((20, 3), (20, 3)), "frames of 3 x 20 pixels are too small"),
    ],
)
def test_frames_that_cannot_be_used_are_refused(shapes, message):
    with pytest.raises(InputError, match=message):
        run("tvl1", *(np.zeros(shape) for shape in shapes))


@METHODS
@pytest.mark.parametrize("shape", [(4, 4), (4, 40), (40, 5)])
def test_the_smallest_frames_work(method, shape):
    frames = np.random.default_rng(2).uniform(0, 255, (2, *shape))
    flow = run(method, *frames, n_warps=2, max_iter=5).flow
    assert flow.shape == (2, *shape) and np.isfinite(flow).all()
