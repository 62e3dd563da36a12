from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.errors import InputError
from fracbench.evaluation.metrics import (
    CONVENTIONS,
    FlowErrors,
    _checked,
    accuracy,
    angular_error,
    endpoint_error,
    flow_errors,
    outliers,
    robustness,
    with_unknown_as_zero,
)

RNG = np.random.default_rng(3)
NAN, INF = math.nan, math.inf


def flow_of(*vectors) -> np.ndarray:
    """A flow of one row, one (u1, u2) a pixel."""
    return np.array(vectors, dtype=float).T[:, np.newaxis, :]


def by_arccos(u, gt) -> float:
    """The paper's formula as printed, the argument clipped."""
    cosine = (1 + u[0] * gt[0] + u[1] * gt[1]) / (
        math.sqrt(1 + u[0] ** 2 + u[1] ** 2) * math.sqrt(1 + gt[0] ** 2 + gt[1] ** 2)
    )
    return math.acos(min(max(cosine, -1.0), 1.0))


class TestMaps:
    def test_angles_known_by_hand(self):
        u = flow_of((1, 0), (0, 0), (1, 0), (0, -1), (0, 0), (math.sqrt(3), 0))
        gt = flow_of((0, 0), (0, 0), (-1, 0), (0, 1), (0, 1), (0, 0))
        expected = [math.pi / 4, 0, math.pi / 2, math.pi / 2, math.pi / 4, math.pi / 3]
        np.testing.assert_allclose(angular_error(u, gt), [expected], atol=1e-15)

    def test_end_points_known_by_hand(self):
        u, gt = flow_of((3, 4), (0, 0), (1, 1), (-5, 12)), flow_of((0, 0), (0, 0), (1, 2), (0, 0))
        np.testing.assert_array_equal(endpoint_error(u, gt), [[5, 0, 1, 13]])

    @given(arrays(np.float64, (4,), elements=st.floats(-50, 50)))
    def test_the_angle_is_the_papers_arccos(self, v):
        error = angular_error(flow_of(v[:2]), flow_of(v[2:]))[0, 0]
        assert error == pytest.approx(by_arccos(v[:2], v[2:]), abs=5e-8)  # arccos has no more digits near 0

    @given(arrays(np.float64, (2,), elements=st.floats(-1e6, 1e6)))
    def test_equal_flows_have_exactly_no_error(self, v):
        u = flow_of(v)
        assert angular_error(u, u)[0, 0] == 0.0
        assert endpoint_error(u, u)[0, 0] == 0.0

    @pytest.mark.parametrize("size", [1e-3, 1e-8, 1e-12])
    def test_small_angles_keep_their_digits(self, size):
        """Close to a flow (a, 0), moving u2 by s turns the vector by s / sqrt(1 + a^2)."""
        error = angular_error(flow_of((2.0, size)), flow_of((2.0, 0.0)))[0, 0]
        assert error == pytest.approx(size / math.sqrt(5), rel=1e-6)

    def test_a_diverged_flow_has_the_limiting_angle(self):
        gt = flow_of((1.0, 0.0), (0.0, 1.0), (5e8, 0.0))
        error = angular_error(flow_of((1e200, 0.0), (1e300, 0.0), (-1e308, 0.0)), gt)
        np.testing.assert_allclose(error, [[math.pi / 4, math.pi / 2, math.pi]], atol=1e-8)

    def test_float32_flows_are_measured_in_float64(self):
        u = RNG.normal(size=(2, 20, 20)).astype(np.float32)
        gt = (u + np.float32(1e-4)).astype(np.float32)
        for measure in (angular_error, endpoint_error):
            error = measure(u, gt)
            assert error.dtype == np.float64
            np.testing.assert_array_equal(error, measure(u.astype(float), gt.astype(float)))

    @pytest.mark.parametrize("measure", [angular_error, endpoint_error])
    def test_unknown_is_nan_and_a_missing_estimate_infinite(self, measure):
        u = flow_of((0, 0), (0, 0), (NAN, 0), (0, INF), (NAN, NAN), (0, 0))
        gt = flow_of((0, 0), (NAN, 0), (0, 0), (0, 0), (0, 2e9), (1666666752.0, 0))
        np.testing.assert_array_equal(measure(u, gt), [[0, NAN, INF, INF, NAN, NAN]])


class TestFlowErrors:
    def test_a_small_flow_by_hand(self):
        errors = flow_errors(flow_of((3, 4), (0, 0), (0, 1)), flow_of((0, 0), (0, 0), (0, 0)))
        angles = [math.atan(5), 0.0, math.pi / 4]
        mean = sum(angles) / 3
        assert errors.aae == pytest.approx(mean, rel=1e-14)
        assert errors.aepe == pytest.approx(2.0, rel=1e-14)
        assert errors.sdae == pytest.approx(math.sqrt(sum((a - mean) ** 2 for a in angles) / 3), rel=1e-14)
        assert (errors.n_pixels, errors.n_unknown, errors.n_nonfinite) == (3, 0, 0)

    def test_a_perfect_flow_scores_zero(self):
        u = RNG.normal(size=(2, 5, 6))
        assert flow_errors(u, u) == FlowErrors(0.0, 0.0, 0.0, 30, 0, 0)

    def test_the_mask_and_the_unknown_pixels_are_left_out(self):
        u, gt = RNG.normal(size=(2, 2, 9, 11))
        gt[0, 2, 3] = NAN
        gt[1, 4, :2] = 1666666752.0
        gt[1, 8, 8] = -2e9
        mask = RNG.random((9, 11)) < 0.6
        mask[4, 0], mask[4, 1], mask[2, 3], mask[8, 8] = True, False, True, True
        pixels = [
            (r, c)
            for r, c in itertools.product(range(9), range(11))
            if mask[r, c] and (r, c) not in {(2, 3), (4, 0), (8, 8)}
        ]
        errors = flow_errors(u, gt, mask)
        angles = [by_arccos(u[:, r, c], gt[:, r, c]) for r, c in pixels]
        distances = [math.dist(u[:, r, c], gt[:, r, c]) for r, c in pixels]
        assert errors.aae == pytest.approx(math.fsum(angles) / len(pixels), rel=1e-12)
        assert errors.aepe == pytest.approx(math.fsum(distances) / len(pixels), rel=1e-12)
        assert (errors.n_pixels, errors.n_unknown, errors.n_nonfinite) == (len(pixels), 3, 0)

    def test_estimates_that_are_not_finite_are_never_dropped(self):
        gt = flow_of((0, 0), (0, 0), (NAN, 0), (0, 0))
        errors = flow_errors(flow_of((0, NAN), (INF, 0), (NAN, 0), (1, 1)), gt)
        assert math.isnan(errors.aae) and math.isnan(errors.aepe) and math.isnan(errors.sdae)
        assert (errors.n_pixels, errors.n_unknown, errors.n_nonfinite) == (3, 1, 2)

    def test_an_estimate_missing_where_nothing_is_scored_is_no_matter(self):
        gt, mask = flow_of((NAN, 0), (0, 0), (0, 0)), np.array([[True, False, True]])
        errors = flow_errors(flow_of((NAN, 0), (INF, 0), (3, 4)), gt, mask)
        assert errors.aepe == 5.0
        assert (errors.n_pixels, errors.n_unknown, errors.n_nonfinite) == (1, 1, 0)

    def test_inputs_are_left_alone_and_may_be_read_only(self):
        u, gt = np.ones((2, 3, 4), dtype=np.float32), np.full((2, 3, 4), 2e9, dtype=np.float32)
        gt[:, 0] = 0
        before = gt.copy()
        for array in (u, gt):
            array.setflags(write=False)
        flow_errors(u, gt)
        np.testing.assert_array_equal(gt, before)

    def test_a_diverged_flow_gives_numbers_and_no_warning(self):
        errors = flow_errors(np.full((2, 4, 4), 1e308), np.zeros((2, 4, 4)))
        assert errors.aepe == INF and errors.aae == pytest.approx(math.pi / 2)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
    def test_the_sums_are_those_of_the_maps(self, dtype, size):
        gt = RNG.normal(size=(2, 37, 41)).astype(np.float32)
        u = (gt + size * RNG.normal(size=gt.shape)).astype(dtype)
        gt[:, 3, 5:9] = NAN
        angles, distances = (error(u, gt)[~np.isnan(gt[0])] for error in (angular_error, endpoint_error))
        errors = flow_errors(u, gt)
        expected = (angles.mean(), distances.mean(), angles.std())
        assert (errors.aae, errors.aepe, errors.sdae) == pytest.approx(expected, rel=1e-12)

    def test_degrees(self):
        assert FlowErrors(math.pi / 2, 1.0, math.pi / 4, 1, 0, 0).degrees == (90.0, 45.0)

    @pytest.mark.parametrize(
        ("flow", "truth", "mask", "message"),
        [
            (np.zeros((2, 3, 4)), np.zeros((2, 4, 3)), None, r"\(2, 3, 4\), the true flow \(2, 4, 3\)"),
            (np.zeros((3, 4, 2)), np.zeros((3, 4, 2)), None, r"\(2, H, W\), not \(3, 4, 2\)"),
            (np.zeros((2, 3, 4)), np.full((2, 3, 4), NAN), None, "no pixel to score: .* 12, 12 of unknown"),
            (np.zeros((2, 3, 4)), np.zeros((2, 3, 4)), np.zeros((3, 4), dtype=bool), "the mask holds 0"),
            (np.zeros((2, 3, 4)), np.zeros((2, 3, 4)), np.ones((3, 5), dtype=bool), "`mask` must be bool"),
            (np.zeros((2, 3, 4)), np.zeros((2, 3, 4)), np.ones((3, 4)), "`mask` must be bool"),
        ],
    )
    def test_misuse(self, flow, truth, mask, message):
        with pytest.raises(InputError, match=message):
            flow_errors(flow, truth, mask)


class TestSummaries:
    EPE = np.array([[0.0, 1.0, 1.5], [INF, NAN, 0.5]])

    def test_robustness_is_the_share_above(self):
        assert robustness(self.EPE, 1.0) == pytest.approx(40.0)
        assert robustness(self.EPE, 0.0) == pytest.approx(80.0)
        assert robustness(self.EPE, 1e9) == pytest.approx(20.0)  # a missing estimate is never good

    def test_accuracy_is_an_error_that_occurs(self):
        assert [accuracy(self.EPE, p) for p in (0, 20, 20.1, 50, 80, 95, 100)] == [0, 0, 0.5, 1.0, 1.5, INF, INF]

    @given(arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 10)), st.integers(1, 100))
    def test_accuracy_is_the_smallest_that_enough_pixels_keep(self, epe, percentile):
        enough = [e for e in epe if 100 * (epe <= e).sum() >= percentile * len(epe)]
        assert accuracy(epe, percentile) == min(enough)

    def test_misuse(self):
        for act in (robustness, accuracy):
            with pytest.raises(InputError, match="every error is NaN"):
                act([NAN], 1.0)
            with pytest.raises(InputError, match="got nan"):
                act([1.0], NAN)
        with pytest.raises(InputError, match=r"within 0\.\.100, got 101"):
            accuracy([1.0], 101)
        with pytest.raises(InputError, match="at least 0 pixels, got -1"):
            robustness([1.0], -1)


def test_the_conventions_are_one_paragraph():
    assert "\n" not in CONVENTIONS
    for word in ("radians", "pixels", "population", "unknown", "border"):
        assert word in CONVENTIONS


# The errors of a flow that is zero everywhere, AAE in radians and AEPE in pixels.
ZERO_FLOW = {
    "Grove2": (1.2517, 3.0900),
    "RubberWhale": (0.8664, 1.2560),
    "Dimetrodon": (1.0833, 2.0580),
    "Venus": (1.2408, 3.8017),
    "Urban2": (1.2130, 8.3934),
}


@pytest.mark.middlebury
@pytest.mark.parametrize("name", ZERO_FLOW)
def test_the_zero_flow_on_middlebury(middlebury, name):
    truth = middlebury_data.load(name, middlebury).truth
    errors = flow_errors(np.zeros_like(truth), truth)
    assert (errors.aae, errors.aepe) == pytest.approx(ZERO_FLOW[name], abs=6e-5)
    assert errors.n_pixels + errors.n_unknown == truth[0].size


class TestOutliers:
    def test_an_outlier_is_above_3_pixels_and_above_5_per_cent_of_the_true_flow(self):
        truth = flow_of((100, 0), (10, 0), (10, 0), (0, 0), (70, 0), (NAN, NAN))
        flow = flow_of((104, 0), (13, 0), (13.5, 0), (0, 3.25), (66.4, 0), (0, 0))
        # 4 % of 100 px; exactly 3 px; 3.5 px of 10; 3.25 px of 0; 3.6 px, above 5 % of 70; unknown
        assert outliers(flow, truth) == pytest.approx(100 * 3 / 5)

    def test_a_missing_estimate_is_an_outlier(self):
        found = outliers(flow_of((NAN, 0), (INF, 0), (1, 0)), flow_of((1, 0), (1, 0), (1, 0)))
        assert found == pytest.approx(200 / 3)

    def test_nothing_known_has_no_share(self):
        with pytest.raises(InputError, match="no pixel to score"):
            outliers(flow_of((1, 0)), flow_of((NAN, 0)))


def test_flows_in_single_precision_are_read_as_they_are():
    flow = RNG.normal(size=(2, 4, 5)).astype(np.float32)
    assert all(np.shares_memory(flow, read) for read in _checked(flow, flow))
    assert [read.dtype for read in _checked(flow, flow.astype(np.float64))] == [np.float64] * 2


def test_unknown_true_flow_counts_as_zero():
    truth = np.float32([[[1.0, NAN, 3.0], [1e10, 5.0, 1e9]], [[-1.0, 2.0, NAN], [4.0, -1e10, 6.0]]])
    before = truth.copy()
    filled = with_unknown_as_zero(truth)
    # both components are 0 where one of them is unknown; 1e9 itself is still known
    assert filled.tolist() == [[[1.0, 0.0, 0.0], [0.0, 0.0, 1e9]], [[-1.0, 0.0, 0.0], [0.0, 0.0, 6.0]]]
    assert filled.dtype == np.float32
    assert np.array_equal(truth, before, equal_nan=True)


def test_errors_with_unknown_as_zero_are_those_of_all_pixels():
    truth = np.array([[[3.0, NAN, NAN, NAN]], [[4.0, NAN, NAN, NAN]]])
    flow = np.array([[[3.0, 0.0, 3.0, 0.0]], [[4.0, 0.0, 4.0, 1.0]]])
    errors = flow_errors(flow, with_unknown_as_zero(truth))
    assert (errors.n_pixels, errors.n_unknown) == (4, 0)
    assert errors.aepe == pytest.approx((0.0 + 0.0 + 5.0 + 1.0) / 4)
    angles = np.array([0.0, 0.0, math.acos(1.0 / math.sqrt(26.0)), math.pi / 4.0])
    assert errors.aae == pytest.approx(angles.mean()) and errors.sdae == pytest.approx(angles.std())
    assert flow_errors(flow, truth).aepe == 0.0  # as the paper's table has it: one known pixel
