"""The switches of docs/switches.md: each against a closed form, another library or a literal twin."""

import numpy as np
import pytest
import scipy.ndimage
from PIL import Image

from fracbench.errors import InputError
from fracbench.methods.registry import get_method
from fracbench.model import pyramid
from fracbench.model.data_terms.brightness import Brightness
from fracbench.model.data_terms.switched import (
    SwitchedBrightness,
    image_gradient,
    sample_planes,
    switched_residual,
)
from fracbench.model.kernels.pointwise import shrink_each, threshold, update_each
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.params import SWITCHES, FlowParams
from fracbench.model.regularizers import SplitBregman, TVDual, squared_change
from fracbench.model.resampling import resample
from fracbench.model.sweeps import FivePoint, five_point_switches, gauss_seidel_natural, jacobi_sweep
from fracbench.model.v_steps import v_step_of_penalty
from fracbench.model.warping import Linearization, around

SHAPE = (23, 30)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def frames(rng):
    image = scipy.ndimage.gaussian_filter(rng.uniform(0.0, 255.0, (48, 52)), 1.5)
    image = (image - image.min()) / np.ptp(image) * 255.0
    moved = scipy.ndimage.shift(image, (0.4, 0.8), order=3, mode="nearest")
    return image.astype(np.float32), np.clip(moved, 0.0, 255.0).astype(np.float32)


def flow(frames, method="tvl1", **values):
    chosen = get_method(method)
    base = {"lambda": 0.1, "n_scales": 2, "n_warps": 2, "max_iter": 3, "epsilon": 0.0, "dtype": "float64"}
    return chosen.compute(*frames, chosen.replace(chosen.start(), {**base, **values})).flow


def test_all_switches_are_off_by_default_and_say_so():
    usual = FlowParams().as_dict()
    assert len(SWITCHES) == 21
    assert {name: usual[name] for name in SWITCHES} == SWITCHES


# -- weights -----------------------------------------------------------------------------------------------------


def test_lambda_and_theta_take_their_factors_after_they_are_exchanged(frames):
    given = {"lambda": 0.1, "theta": 0.5}
    np.testing.assert_array_equal(
        flow(frames, **given, swap_weights=True, lambda_factor=2.0, theta_factor=0.5),
        flow(frames, **{"lambda": 1.0, "theta": 0.05}),
    )
    result = get_method("tvl1").compute(*frames, FlowParams(lambda_factor=2.0, max_iter=1, n_warps=1))
    assert result.params.lambda_factor == 2.0  # a result tells what it was asked for


def test_intensities_of_0_to_1_are_a_lambda_255_times_smaller(frames):
    unit = flow(frames, intensity="unit", **{"lambda": 40.0})
    np.testing.assert_allclose(unit, flow(frames, **{"lambda": 40.0 / 255.0}), atol=1e-6)
    assert np.abs(unit).max() > 0.1


def test_frames_are_stretched_each_by_itself_or_not_at_all(frames):
    dim = frames[1] * np.float32(0.5) + np.float32(10.0)
    alone = [(frame - frame.min()) * (255.0 / np.ptp(frame)) for frame in (frames[0], dim)]
    for mine, twin in zip(pyramid.stretch(frames[0], dim, np.dtype("f8"), "each"), alone, strict=True):
        np.testing.assert_allclose(mine, twin, atol=1e-4)
    for mine, twin in zip(pyramid.stretch(frames[0], dim, np.dtype("f8"), "given"), (frames[0], dim), strict=True):
        np.testing.assert_array_equal(mine, twin.astype(np.float64))


@pytest.mark.parametrize("kind", ["full", "no_theta", "no_square"])
def test_the_threshold_has_theta_and_the_square_or_not(rng, kind):
    u, gradient = rng.normal(0.0, 1.0, (2, 2, *SHAPE))
    rho_c = rng.normal(0.0, 1.0, SHAPE)
    params = FlowParams(lambda_=0.5, theta=0.3, threshold=kind, coupling="penalty")
    v = v_step_of_penalty(u, params).target(u, Linearization(rho_c, gradient))
    length = 0.5 if kind == "no_theta" else 0.15
    g2 = (gradient**2).sum(axis=0)
    rho = rho_c + (gradient * u).sum(axis=0)
    bound = length * (np.sqrt(g2) if kind == "no_square" else g2)
    step = np.where(rho < -bound, length, np.where(rho > bound, -length, -rho / g2))
    np.testing.assert_allclose(v, u + step * gradient, atol=1e-12)


def test_the_threshold_belongs_to_the_penalty_coupling(frames):
    settings = {"coupling": "multiplier", "method": "tvl1_sb", "u_solver": "exact", "inner": "warm"}
    with pytest.raises(InputError, match="`threshold` needs coupling=penalty"):
        flow(frames, threshold="no_theta", **settings)


# -- pyramid -----------------------------------------------------------------------------------------------------


def test_imresize_by_one_half_has_the_known_weights():
    line = np.zeros((1, 16))
    line[0, 8] = 1.0
    half = resample(line, (1, 8), "imresize")[0]
    np.testing.assert_allclose(half[2:6], [-0.01171875, 0.11328125, 0.43359375, -0.03515625], atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "peer", "shape"),
    [
        *(("imresize", Image.Resampling.BICUBIC, shape) for shape in [(12, 15), (11, 16), (46, 60), (50, 70)]),
        *(("bilinear", Image.Resampling.BILINEAR, shape) for shape in [(46, 60), (50, 70)]),
        *(("nearest", Image.Resampling.NEAREST, shape) for shape in [(12, 15), (46, 60), (50, 70)]),
    ],
)
def test_images_are_resampled_as_by_pillow(rng, kind, peer, shape):
    image = rng.uniform(0.0, 255.0, SHAPE).astype(np.float32)
    mine = resample(image, shape, kind)
    twin = np.asarray(Image.fromarray(image).resize(shape[::-1], peer))
    edge = 4 if kind == "imresize" else 0  # Pillow leaves out samples beyond the border, Matlab mirrors them
    inside = tuple(slice(edge, n - edge) for n in shape)
    assert mine.dtype == np.float32 and mine.shape == shape
    np.testing.assert_allclose(mine[inside], twin[inside], atol=2e-3)
    np.testing.assert_allclose(resample(np.ones_like(image), shape, kind), 1.0, atol=1e-5)


@pytest.mark.parametrize("m", [12, 15, 29])
def test_areas_are_means_of_the_integral(rng, m):
    image = rng.uniform(0.0, 255.0, (1, 30))
    integral = np.interp(np.arange(m + 1) * 30 / m, np.arange(31), [0.0, *np.cumsum(image)])
    np.testing.assert_allclose(resample(image, (1, m), "area")[0], np.diff(integral) * m / 30, atol=1e-10)


def test_the_printed_upsampling_reads_the_coarse_flow_at_twice_the_place(rng):
    coarse = rng.normal(0.0, 1.0, (2, 12, 15))
    fine = pyramid.upsample_flow(coarse, (24, 30), 2.0, "printed")
    np.testing.assert_allclose(fine[:, :6, :8], 2.0 * coarse[:, ::2, ::2], atol=1e-12)
    assert not fine[:, 6:].any() and not fine[:, :, 8:].any()


def test_scales_are_smoothed_sampled_or_both(rng):
    image = rng.uniform(0.0, 255.0, (24, 32))
    shapes = pyramid.scale_shapes(image.shape, 0.5, 2)
    plain = pyramid.scales(image, shapes, FlowParams(downsampling="plain", presmoothing=0.0))
    np.testing.assert_allclose(plain[1], image[::2, ::2], atol=1e-10)
    area = pyramid.scales(image, shapes, FlowParams(downsampling="area", presmoothing=0.0))
    np.testing.assert_allclose(area[1], image.reshape(12, 2, 16, 2).mean(axis=(1, 3)), atol=1e-10)
    both = pyramid.scales(image, shapes, FlowParams(downsampling="gaussian_imresize", presmoothing=0.0))
    blurred = pyramid.smooth(image, 0.6 * np.sqrt(3.0))
    np.testing.assert_allclose(both[1], resample(blurred, (12, 16), "imresize"), atol=1e-10)


def test_presmoothing_may_follow_the_pyramid(rng):
    image = rng.uniform(0.0, 255.0, (24, 32))
    shapes = pyramid.scale_shapes(image.shape, 0.5, 2)
    after = pyramid.scales(image, shapes, FlowParams(smoothing_at="scales"))
    for level, raw in zip(after, pyramid.build(image, shapes, 0.5), strict=True):
        smoothed = scipy.ndimage.gaussian_filter(raw, 0.6, mode="reflect", truncate=5.0)
        np.testing.assert_allclose(level, smoothed, atol=1e-8)


# -- data term ---------------------------------------------------------------------------------------------------


def linearised(rng, **switches):
    frame0, frame1 = rng.uniform(0.0, 255.0, (2, *SHAPE))
    u0 = rng.normal(0.0, 2.0, (2, *SHAPE))
    params = FlowParams(dtype="float64", **switches)
    return frame0, frame1, u0, SwitchedBrightness(frame0, frame1, params).at(u0)


def test_with_all_switches_off_the_data_term_is_the_papers(rng):
    frame0, frame1, u0, mine = linearised(rng)
    usual = Brightness(frame0, frame1, FlowParams()).at(u0)
    np.testing.assert_allclose(mine.rho_c, usual.rho_c, atol=1e-9)
    np.testing.assert_allclose(mine.gradient, usual.gradient, atol=1e-9)
    assert type(switched_residual(frame0, frame1, FlowParams())) is Brightness
    assert type(switched_residual(frame0, frame1, FlowParams(warp="bilinear"))) is SwitchedBrightness


def test_bilinear_samples_with_a_repeated_border_are_scipys(rng):
    frame0, frame1, u0, (rho_c, gradient) = linearised(rng, warp="bilinear", outside="repeat")
    at = np.indices(SHAPE) + u0[::-1]
    planes = [frame1, *image_gradient(frame1, "central")]
    value, gx, gy = (scipy.ndimage.map_coordinates(plane, at, order=1, mode="nearest") for plane in planes)
    np.testing.assert_allclose(gradient, [gx, gy], atol=1e-9)
    np.testing.assert_allclose(rho_c, value - gx * u0[0] - gy * u0[1] - frame0, atol=1e-9)


def test_bicubic_samples_with_a_repeated_border_are_those_of_the_kernel(rng):
    frame0, frame1, u0, (rho_c, gradient) = linearised(rng, gradient_of="still", outside="repeat")

    def keys(x):
        x = abs(x)
        return 1.5 * x**3 - 2.5 * x**2 + 1 if x < 1 else max(-0.5 * x**3 + 2.5 * x**2 - 4 * x + 2, -1) * (x < 2)

    value = rho_c + (gradient * u0).sum(axis=0) + frame0
    for i, j in [(0, 0), (5, 29), (22, 3), (11, 14)]:
        x, y = np.clip(j + u0[0, i, j], 0, 29), np.clip(i + u0[1, i, j], 0, 22)
        near = [(r, c) for r in range(int(y) - 1, int(y) + 3) for c in range(int(x) - 1, int(x) + 3)]
        twin = sum(keys(y - r) * keys(x - c) * frame1[np.clip(r, 0, 22), np.clip(c, 0, 29)] for r, c in near)
        assert value[i, j] == pytest.approx(twin, abs=1e-9)


@pytest.mark.parametrize("cubic", [False, True])
def test_samples_on_the_border_read_nothing_beyond_it(rng, cubic):
    memory = np.full((1, 8, 10), np.nan)
    planes = memory[:, :6, :7]
    planes[...] = rng.normal(size=(1, 6, 7))
    rows, columns = np.mgrid[:6, :7]
    u0 = np.stack([np.where(columns > 3, 6.0 - columns, 0.0), np.where(rows > 3, 5.0 - rows, 0.0)])
    warped, out = np.empty((1, 6, 7)), np.empty((6, 7), bool)
    sample_planes(planes, u0, cubic, True, warped, out, 0, 6)
    expected = planes[0][np.where(rows > 3, 5, rows), np.where(columns > 3, 6, columns)]
    np.testing.assert_allclose(warped[0], expected, atol=1e-14)


@pytest.mark.parametrize("outside", ["zero", "frame0", "off"])
def test_samples_outside_are_0_or_frame_0_or_have_no_data_term(rng, outside):
    frame0, _, u0, (rho_c, gradient) = linearised(rng, warp="bilinear", outside=outside, gradient_of="frame0")
    y, x = np.indices(SHAPE) + u0[::-1]
    out = (x < 0) | (x > 29) | (y < 0) | (y > 22)
    assert 20 < out.sum() < 600
    known = image_gradient(frame0, "central")
    np.testing.assert_allclose(gradient, np.where(out, 0.0, known) if outside == "off" else known, atol=1e-12)
    at_u0 = rho_c + (gradient * u0).sum(axis=0)
    np.testing.assert_allclose(at_u0[out], 0.0 if outside == "frame0" else -frame0[out], atol=1e-9)


def test_the_gradient_is_of_the_frame_that_is_asked_for(rng):
    found = {}
    for kind in ("frame1", "warped", "still", "frame0", "mean"):
        frame0, frame1, u0, linear = linearised(
            np.random.default_rng(3), gradient_of=kind, stencil="forward", outside="repeat", gradient_scale=2.0
        )
        found[kind] = linear.gradient
        warped = linear.rho_c + (linear.gradient * u0).sum(axis=0) + frame0
    np.testing.assert_allclose(found["still"], 2.0 * image_gradient(frame1, "forward"))
    np.testing.assert_allclose(found["frame0"], 2.0 * image_gradient(frame0, "forward"))
    np.testing.assert_allclose(found["mean"], (found["frame0"] + found["frame1"]) / 2.0)
    np.testing.assert_allclose(found["warped"], 2.0 * image_gradient(warped, "forward"), atol=1e-9)


@pytest.mark.parametrize(
    ("stencil", "order"), [("forward", 1), ("backward", 1), ("central", 2), ("five_point", 4)]
)
def test_stencils_are_exact_for_polynomials_of_their_order_and_not_beyond(stencil, order):
    x = np.arange(12.0)[None].repeat(7, axis=0)
    for power in range(1, order + 2):
        error = np.abs(image_gradient(x**power, stencil)[0] - power * x ** (power - 1))[:, 2:-2].max()
        assert (error < 1e-8) == (power <= order)
    np.testing.assert_allclose(image_gradient(x.T, stencil)[1][2:-2], 1.0)


def test_differences_look_ahead_or_back():
    line = np.array([[0.0, 1.0, 4.0]])
    np.testing.assert_array_equal(image_gradient(line, "forward", 2.0)[0], [[2.0, 6.0, 0.0]])
    np.testing.assert_array_equal(image_gradient(line, "backward")[0], [[0.0, 1.0, 3.0]])


# -- warps -------------------------------------------------------------------------------------------------------


def test_warps_about_the_flow_of_the_scale_are_more_iterations_of_one(frames):
    np.testing.assert_array_equal(
        flow(frames, u0_per_scale=True, n_warps=2, max_iter=3), flow(frames, n_warps=1, max_iter=6)
    )


def test_the_residual_about_u0_is_that_of_the_whole_flow(rng):
    rho_c, (u0, gradient, w) = rng.normal(0.0, 1.0, SHAPE), rng.normal(0.0, 1.0, (3, 2, *SHAPE))
    moved = around(u0, Linearization(rho_c, gradient))
    np.testing.assert_allclose(
        moved.rho_c + (moved.gradient * w).sum(axis=0), rho_c + (gradient * (u0 + w)).sum(axis=0), atol=1e-12
    )


def twin_of_warps(frames, *, whole, increments):
    """Take two warps of three iterations at one scale, as Algorithms 1 and 2 stand, with plain NumPy."""
    f0, f1 = (pyramid.smooth(frame, 0.6) for frame in pyramid.stretch(*frames, np.dtype("f8")))
    params = FlowParams(lambda_=0.1, dtype="float64")
    u, p = np.zeros((2, *f0.shape)), np.zeros((2, 2, *f0.shape))
    for _ in range(2):
        u0 = u.copy()
        rho_c, g = (a.copy() for a in Brightness(f0, f1, params).at(u0))
        if whole or increments:
            rho_c += (g * u0).sum(axis=0)
        unknown = np.zeros_like(u) if increments else u
        for _ in range(3):
            v = np.empty_like(u)
            threshold(unknown, rho_c, g, 0.03, v)
            for c in range(2):
                div = np.diff(p[c, 0], axis=1, prepend=0.0) + np.diff(p[c, 1], axis=0, prepend=0.0)
                unknown[c] = v[c] + 0.3 * div
                grad = np.zeros_like(p[c])
                grad[0, :, :-1], grad[1, :-1] = np.diff(unknown[c], axis=1), np.diff(unknown[c], axis=0)
                p[c] = (p[c] + 0.25 / 0.3 * grad) / (1.0 + 0.25 / 0.3 * np.hypot(*grad))
        u = u0 + unknown if increments else unknown
    return u


@pytest.mark.parametrize(("whole", "increments"), [(False, False), (True, False), (False, True)])
def test_warps_solve_for_the_flow_or_for_its_change(frames, whole, increments):
    settings = {"residual_u0": not whole, "unknown": "increment" if increments else "flow", "n_scales": 1}
    twin = twin_of_warps(frames, whole=whole, increments=increments)
    np.testing.assert_allclose(flow(frames, **settings), twin, atol=1e-5)
    assert np.abs(twin).max() > 0.1


# -- u-step ------------------------------------------------------------------------------------------------------


def test_anisotropic_shrinkage_takes_each_derivative_by_itself(rng):
    z, w, du = rng.normal(0.0, 1.0, (3, 1, 2, *SHAPE))
    d = np.sign(z) * np.maximum(np.abs(z) - 0.4, 0.0)
    shrink_each(z, 0.4, w, 0, SHAPE[0])
    np.testing.assert_allclose(w, d - (z - d), atol=1e-12)
    after = z.copy()
    update_each(du, 0.4, 1.7, after, 0, SHAPE[0])
    np.testing.assert_allclose(after, 1.7 * du - 0.7 * d + (z - d), atol=1e-12)


def forward_matrices(height, width):
    along = [np.eye(n, k=1) - np.eye(n) for n in (height, width)]
    for matrix in along:
        matrix[-1] = 0.0
    return np.kron(np.eye(height), along[1]), np.kron(along[0], np.eye(width))


@pytest.mark.parametrize("u_solver", ["exact", "gauss_seidel"])
def test_the_u_step_has_a_penalty_of_its_own(rng, u_solver):
    """Two steps from d = b = 0, with dense matrices: the second sees the shrinkage by 1 / lambda_sb."""
    shape, theta, mu, penalty = (5, 6), 0.3, 2.0, 7.0
    v = rng.normal(0.0, 2.0, shape)
    mine = v.copy()
    bregman = SplitBregman(
        ForwardDifferences(1.0, shape), theta, mu, u_solver=u_solver, inner="cold", penalty=penalty, max_inner=1
    )
    gx, gy = forward_matrices(*shape)
    system = np.eye(v.size) / theta + penalty * (gx.T @ gx + gy.T @ gy)
    u, d, b = v.ravel().copy(), np.zeros((2, v.size)), np.zeros((2, v.size))
    for _ in range(2):
        bregman.bregman_step(0, v, mine)
        rhs = v.ravel() / theta + penalty * (gx.T @ (d[0] - b[0]) + gy.T @ (d[1] - b[1]))
        if u_solver == "exact":
            u = np.linalg.solve(system, rhs)
        else:
            for i in range(v.size):
                u[i] = (rhs[i] - system[i] @ u + system[i, i] * u[i]) / system[i, i]
        z = np.array([gx @ u, gy @ u]) + b
        d = z * np.maximum(1.0 - 1.0 / mu / np.maximum(np.hypot(*z), 1e-30), 0.0)
        b = z - d
    np.testing.assert_allclose(mine.ravel(), u, atol=1e-10)


def test_several_sweeps_of_jacobi_are_no_usual_step():
    jacobi = FlowParams(u_solver="jacobi")
    assert five_point_switches(jacobi) is None
    assert five_point_switches(jacobi.replace({"sweeps": 2})) == FivePoint(2, "at_once", "natural")


def sweep(five_point, u, v, w, theta=0.3, mu=5.0):
    u, w = u.copy(), w.copy()
    five_point.step(u, v, w, theta, mu)
    return u, w


def test_sweeps_of_the_stencil_are_gauss_seidels_and_jacobis(rng):
    operator = ForwardDifferences(1.0, SHAPE)
    u, v, w = *rng.normal(0.0, 1.0, (2, *SHAPE)), operator.apply(rng.normal(0.0, 1.0, SHAPE))
    usual, usual_w = u.copy(), w.copy()
    for _ in range(2):  # the second from the right-hand side of the first
        usual_w[...] = w
        gauss_seidel_natural(usual, v, usual_w, 0.3, 5.0)
    for mine, twin in zip(sweep(FivePoint(2, "raster", "natural"), u, v, w), (usual, usual_w), strict=True):
        np.testing.assert_allclose(mine, twin, atol=1e-12)
    rhs = v / 0.3 + 5.0 * operator.adjoint(w)
    jacobi = jacobi_sweep(u, rhs, *operator.normal_matrices(), 0.3, 5.0)
    np.testing.assert_allclose(sweep(FivePoint(1, "at_once", "natural"), u, v, w)[0], jacobi, atol=1e-12)


@pytest.mark.parametrize("order", ["raster", "backward", "at_once"])
@pytest.mark.parametrize("border", ["natural", "four_zero", "four_repeat"])
def test_a_sweep_of_the_stencil_against_its_literal_twin(rng, order, border):
    operator = ForwardDifferences(1.0, SHAPE)
    u, v, w = *rng.normal(0.0, 1.0, (2, *SHAPE)), operator.apply(rng.normal(0.0, 1.0, SHAPE))
    rhs, twin = v / 0.3 + 5.0 * operator.adjoint(w), u.copy()
    pixels = [(i, j) for i in range(SHAPE[0]) for j in range(SHAPE[1])]
    for i, j in reversed(pixels) if order == "backward" else pixels:
        around_it = [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)]
        here = [(a, b) for a, b in around_it if 0 <= a < SHAPE[0] and 0 <= b < SHAPE[1]]
        total, count = sum((u if order == "at_once" else twin)[place] for place in here), len(here)
        if border != "natural":
            total, count = total + (4 - count) * (u[i, j] if border == "four_repeat" else 0.0), 4
        twin[i, j] = (rhs[i, j] + 5.0 * total) / (1.0 / 0.3 + 5.0 * count)
    mine, derivatives = sweep(FivePoint(1, order, border), u, v, w)
    np.testing.assert_allclose(mine, twin, atol=1e-12)
    np.testing.assert_allclose(derivatives, operator.apply(twin), atol=1e-12)


def test_the_printed_divergence_is_minus_the_adjoint(rng):
    """So it needs no switch: derivatives across the border are 0, and so are d and b there."""
    operator = ForwardDifferences(1.0, SHAPE)
    w = operator.apply(rng.normal(0.0, 1.0, SHAPE))
    (dx, dy), printed = w[0], np.zeros(SHAPE)
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            printed[i, j] = dx[i, j] - (dx[i, j - 1] if j else 0.0) + dy[i, j] - (dy[i - 1, j] if i else 0.0)
    np.testing.assert_allclose(printed, -operator.adjoint(w), atol=1e-12)


def test_dual_steps_of_tv_l1_may_be_several_to_one_v(rng):
    v = rng.normal(0.0, 1.0, (2, *SHAPE))
    once, thrice = (TVDual(SHAPE, 0.3, 0.25, np.float64, sweeps) for sweeps in (1, 3))
    mine, twin = np.empty_like(v), np.empty_like(v)
    for _ in range(3):
        once.step(v, v, twin)
    thrice.step(v, v, mine)
    np.testing.assert_array_equal(mine, twin)


def test_norms_of_the_inner_loops_change(rng):
    a, b = rng.normal(0.0, 1.0, (2, 1, *SHAPE))
    change = (a - b).ravel()
    norms = {
        "rms": np.sqrt(np.mean(change**2)),
        "max": np.abs(change).max(),
        "sum": np.linalg.norm(change),
        "relative": np.linalg.norm(change) / np.linalg.norm(a),
    }
    for name, value in norms.items():
        assert np.sqrt(squared_change(a, b, name)) == pytest.approx(value, rel=1e-10)
    assert squared_change(np.zeros_like(a), np.zeros_like(a), "relative") == 0.0
