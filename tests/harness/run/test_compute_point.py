"""One point: what it is computed on, what it says of itself, and that nothing it does escapes."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from fracbench import estimate_flow
from fracbench.data.datasets.synthetic import scenes as synthetic
from fracbench.data.pair import FramePair
from fracbench.data.regions import Region
from fracbench.errors import InputError
from fracbench.evaluation.fluid_errors import derivative_errors, errors_by_gradient
from fracbench.evaluation.metrics import flow_errors
from fracbench.harness.run import compute_point
from fracbench.harness.run.compute_point import keep_flow, point_arrays, point_options, run_point
from fracbench.harness.run.point import Point
from fracbench.methods.method import Method
from fracbench.methods.paper import energy_growth
from fracbench.methods.registry import METHODS, get_method
from fracbench.methods.warmup import SIDE
from fracbench.model.coarse_to_fine import FlowResult
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES, structure_classes

QUICK = {"n_scales": 1, "n_warps": 2, "max_iter": 3}


def a_point(method="tvl1", scene="edge", box=None, context=0, digest=None, **values):
    chosen = get_method(method)
    params = FlowParams().replace(chosen.defaults).replace({**QUICK, **values})
    region = None if box is None else Region("box", scene, box[:2], box[2:])
    return Point(method, params, "synthetic", scene, region, context, digest or synthetic.digest(scene))


def use_method(monkeypatch, estimate):
    method = Method("fake", "fake", "fake", estimate, frame_dtype=None)
    monkeypatch.setattr(compute_point, "get_method", lambda name: method)
    monkeypatch.setattr(compute_point, "_warmed", set())


def still(frame0, frame1, params):
    return FlowResult(np.zeros((2, *frame0.shape), np.float32), "still", params)


# -- what is computed ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha"])
def test_the_errors_are_those_of_the_python_interface(method):
    scene = synthetic.scene("edge")
    flow = estimate_flow(scene.frame0, scene.frame1, method=method, **QUICK)
    expected = flow_errors(flow.flow, scene.truth)
    outcome = run_point(a_point(method), None)
    assert (outcome.status, outcome.error) == ("done", None)
    assert outcome.result["aae"] == expected.aae
    assert outcome.result["aepe"] == expected.aepe
    assert outcome.result["sdae"] == expected.sdae
    assert outcome.result["n_pixels"] == scene.frame0.size
    assert (outcome.result["n_unknown"], outcome.result["n_nonfinite"]) == (0, 0)
    assert outcome.result["iterations"] == flow.iterations
    assert outcome.result["stop"] == flow.stop_reason
    assert outcome.seconds > 0
    assert outcome.machine["versions"]["numpy"] == np.__version__


def test_a_box_with_context_is_guided_by_its_own_colours(monkeypatch):
    rng = np.random.default_rng(5)
    colors = rng.integers(0, 256, (2, 40, 50, 3)).astype(np.uint8)
    gray0, gray1 = colors.astype(np.float64).mean(axis=3)
    digest = synthetic.digest("edge")
    truth = np.zeros((2, 40, 50), np.float32)
    pair = FramePair("edge", "synthetic", gray0, gray1, truth, digest, frame0_color=colors[0])
    monkeypatch.setattr(compute_point, "_sequence_of", lambda point, folder: pair)
    point = a_point("tvl1_sb_alpha_ic", box=(8, 32, 6, 42), context=4, weighted_radius=2, weighted_guide="color")
    given = point_options(point, None)
    np.testing.assert_array_equal(given["color"], colors[0][4:36, 2:46])
    assert point_options(dataclasses.replace(point, method="tvl1"), None) == {}
    chosen = get_method(point.method)
    flow = chosen.compute(gray0[4:36, 2:46], gray1[4:36, 2:46], point.params, **given).flow
    assert run_point(point, None).result["aepe"] == pytest.approx(np.hypot(*flow[:, 4:-4, 4:-4]).mean(), rel=1e-5)


def test_a_box_is_computed_alone_and_scored_inside():
    scene = synthetic.scene("edge")
    rows, cols = slice(20, 70), slice(40, 100)
    flow = estimate_flow(scene.frame0[rows, cols], scene.frame1[rows, cols], method="tvl1", **QUICK).flow
    expected = flow_errors(flow, scene.truth[:, rows, cols])
    outcome = run_point(a_point(box=(20, 70, 40, 100)), None)
    assert outcome.result["aepe"] == expected.aepe
    assert outcome.result["n_pixels"] == 50 * 60


def test_context_takes_part_and_is_not_scored():
    scene = synthetic.scene("edge")
    rows, cols = slice(0, 77), slice(33, 107)  # 7 pixels more, but above the box there are 3 only
    flow = estimate_flow(scene.frame0[rows, cols], scene.frame1[rows, cols], method="tvl1", **QUICK).flow
    expected = flow_errors(flow[:, 3:70, 7:67], scene.truth[:, 3:70, 40:100])
    outcome = run_point(a_point(box=(3, 70, 40, 100), context=7), None)
    assert outcome.result["aepe"] == expected.aepe
    assert outcome.result["n_pixels"] == 67 * 60
    assert outcome.result["aepe"] != run_point(a_point(box=(3, 70, 40, 100)), None).result["aepe"]


def test_the_whole_frame_is_scored_without_a_box():
    frame0, _, truth, inner = point_arrays(a_point(), None)
    assert frame0[inner].shape == frame0.shape == truth.shape[1:] == synthetic.scene("edge").shape


def test_unknown_pixels_count_as_zero_where_the_score_says_so(monkeypatch):
    use_method(monkeypatch, still)
    scene = synthetic.scene("edge")
    truth = scene.truth.copy()
    truth[:, :10] = np.nan
    size, unknown = truth[0].size, 10 * truth.shape[2]
    monkeypatch.setattr(compute_point, "_held", {scene.digest: dataclasses.replace(scene, truth=truth)})
    left_out = run_point(a_point(), None).result
    counted = run_point(dataclasses.replace(a_point(), score="unknown_as_zero"), None).result
    assert (left_out["n_pixels"], left_out["n_unknown"]) == (size - unknown, unknown)
    assert (counted["n_pixels"], counted["n_unknown"]) == (size, 0)
    assert counted["aepe"] == pytest.approx(left_out["aepe"] * (size - unknown) / size)


def test_every_box_is_its_own_cut():
    boxes = [((3, 70, 40, 100), 7), ((3, 70, 40, 100), 0), ((4, 71, 40, 100), 0)] * 2
    whole = synthetic.scene("edge").frame0
    for (row0, row1, col0, col1), context in boxes:
        frame0, _, _, inner = point_arrays(a_point(box=(row0, row1, col0, col1), context=context), None)
        np.testing.assert_array_equal(frame0[inner], whole[row0:row1, col0:col1])
        assert frame0.shape[0] == row1 - row0 + min(row0, context) + context


# -- how it is computed --------------------------------------------------------------------------


def test_one_thread_is_at_work(monkeypatch):
    threads = []

    def estimate(frame0, frame1, params):
        threads.extend(pool["num_threads"] for pool in threadpool_info())
        return still(frame0, frame1, params)

    use_method(monkeypatch, estimate)
    assert run_point(a_point(), None).status == "done"
    assert threads and set(threads) == {1}


def test_a_flow_is_kept_as_one_thread_computes_it(monkeypatch, tmp_path):
    threads = []

    def estimate(frame0, frame1, params):
        threads.extend(pool["num_threads"] for pool in threadpool_info())
        return still(frame0, frame1, params)

    monkeypatch.setitem(METHODS, "tvl1", Method("tvl1", "fake", "fake", estimate, frame_dtype=None))
    with threadpool_limits(2):
        keep_flow(a_point(), None, tmp_path / "a.flo")
    assert threads and set(threads) == {1}


def test_the_clock_runs_during_the_estimate_alone(monkeypatch):
    """What a method does for the first time, it does on a small picture, before."""
    clock = [0.0]
    sizes = []

    def estimate(frame0, frame1, params):
        sizes.append(frame0.size)
        clock[0] += 2.0 if frame0.size > SIDE**2 else 100.0
        return still(frame0, frame1, params)

    use_method(monkeypatch, estimate)
    monkeypatch.setattr(compute_point, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    assert [run_point(a_point(**{"lambda": value}), None).seconds for value in (0.1, 0.2)] == [2.0, 2.0]
    assert sizes == [SIDE**2, 128 * 160, 128 * 160]
    run_point(a_point("tvl1_sb", boundary="zero"), None)
    assert sizes[3:] == [SIDE**2, 128 * 160]


# -- what goes wrong -----------------------------------------------------------------------------


def test_what_a_user_can_put_right_is_said_as_it_is(monkeypatch):
    def estimate(frame0, frame1, params):
        raise InputError("lambda is too large")

    use_method(monkeypatch, estimate)
    outcome = run_point(a_point(), None)
    assert (outcome.status, outcome.error, outcome.result) == ("failed", "lambda is too large", {})
    assert outcome.seconds is None
    assert outcome.machine["host"]


def test_any_other_error_is_named_with_its_place(monkeypatch):
    def estimate(frame0, frame1, params):
        raise ZeroDivisionError("a\nb")

    use_method(monkeypatch, estimate)
    outcome = run_point(a_point(), None)
    line = estimate.__code__.co_firstlineno + 1
    assert (outcome.status, outcome.error) == ("failed", f"ZeroDivisionError: a b (test_compute_point.py:{line})")


def test_ctrl_c_is_no_outcome(monkeypatch):
    def estimate(frame0, frame1, params):
        raise KeyboardInterrupt

    use_method(monkeypatch, estimate)
    with pytest.raises(KeyboardInterrupt):
        run_point(a_point(), None)


def test_a_flow_that_is_not_finite_diverged(monkeypatch):
    def estimate(frame0, frame1, params):
        result = still(frame0, frame1, params)
        result.flow[0, 3, 4:6] = np.nan
        return result

    use_method(monkeypatch, estimate)
    outcome = run_point(a_point(), None)
    assert (outcome.status, outcome.error) == ("diverged", "diverged: 2 pixels of the flow are not finite")
    assert outcome.result["stop"] == "diverged"
    assert outcome.result["n_nonfinite"] == 2
    assert np.isnan(outcome.result["aepe"])


@pytest.mark.parametrize(("pixels", "status"), [(0.1, "done"), (1e5, "diverged"), (1e30, "diverged")])
def test_a_flow_whose_energy_has_grown_diverged(monkeypatch, pixels, status):
    """A fixed point that leaves its circle of convergence swings, and may be stopped before it overflows."""

    def estimate(frame0, frame1, params):
        result = still(frame0, frame1, params)
        result.flow[:, ::2, ::2] = pixels
        return result

    use_method(monkeypatch, estimate)
    outcome = run_point(a_point(), None)
    assert outcome.status == status
    assert outcome.result["n_nonfinite"] == 0
    if status == "diverged":
        assert outcome.error.startswith("diverged: the energy of the flow is ")
        assert outcome.error.endswith(" times that of no flow")


def test_the_energy_of_a_flow_is_compared_with_that_of_none():
    """Closed form: a step of 2 pixels between two columns has the total variation 2 H."""
    frame0 = np.tile(np.arange(32.0), (24, 1))
    frame0[0, 0], frame0[0, 1] = 0.0, 255.0  # nothing is stretched
    flow = np.zeros((2, 24, 32))
    flow[0, :, 16:] = 2.0
    params = FlowParams().replace({"dtype": "float64", "lambda": 0.25})
    frame1 = frame0.copy()
    frame1[5:15, 5:15] += 3.0
    growth = energy_growth("tvl1_sb", frame0, frame1, flow, params)
    assert growth == pytest.approx(2.0 * 24 / (0.25 * 300.0), rel=1e-12)
    assert energy_growth("opencv_dis", frame0, frame1, flow, params) is None
    assert energy_growth("tvl1", frame0, frame0, 0.0 * flow, params) == 0.0
    assert energy_growth("tvl1", frame0, frame0, flow, params) == np.inf


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("tvl1_sb", {}),
        ("tvl1_sb_alpha", {"alpha": 0.4}),
        ("tvl1_sb_alpha", {"alpha": 2.0}),
        ("tvl1_sb_alpha", {"alpha": 1.3, "boundary": "zero", "pad": 3}),
    ],
)
def test_where_a_bound_will_do_it_is_one(name, changes):
    rng = np.random.default_rng(8)
    frame0, frame1 = rng.uniform(0.0, 255.0, (2, 12, 15))
    params = FlowParams().replace(changes)
    checkered = np.indices((12, 15)).sum(axis=0) % 2 - 0.5  # next to no flow has larger derivatives for its size
    for flow in (rng.normal(size=(2, 12, 15)), np.stack([checkered, -checkered])):
        exact = energy_growth(name, frame0, frame1, flow, params)
        bound = energy_growth(name, frame0, frame1, flow, params, enough=100.0)
        assert exact < bound < 10.0 * exact
        assert energy_growth(name, frame0, frame1, flow, params, enough=bound) == exact
    assert energy_growth(name, frame0, frame1, np.nan * flow, params, enough=100.0) != 0.0


def test_data_that_changed_since_they_were_planned_are_not_computed_on():
    outcome = run_point(a_point(digest="of something else"), None)
    assert outcome.status == "failed"
    assert "sequence edge: the data changed while the sweep was running" in outcome.error


def test_a_sequence_without_truth_has_a_flow_and_no_errors(monkeypatch):
    frame = np.zeros((9, 9))
    bare = FramePair("edge", "synthetic", frame, frame, None, synthetic.digest("edge"))
    monkeypatch.setattr(compute_point, "_sequence", lambda *_: bare)
    outcome = run_point(a_point(), None)
    assert (outcome.status, outcome.error) == ("done", None)
    assert outcome.result["n_unknown"] == 81 and outcome.result["n_pixels"] == 0
    assert not {"aae", "aepe", "sdae", "fl_all"} & set(outcome.result)


# -- rendered scenes and classes of pixels -------------------------------------------------------


def test_noise_and_seed_are_those_of_the_scene():
    point = dataclasses.replace(
        a_point(digest=synthetic.digest("edge", noise=2.5, seed=3)),
        noise=2.5,
        seed=3,
        region=Region("box", "edge", (9, 60), (9, 60)),
    )
    frame0, frame1, _, _ = point_arrays(point, None)
    scene = synthetic.scene("edge", noise=2.5, seed=3)
    np.testing.assert_array_equal(frame0, scene.frame0[9:60, 9:60])
    np.testing.assert_array_equal(frame1, scene.frame1[9:60, 9:60])


def test_errors_are_counted_within_the_classes_of_the_first_frame():
    box, context = (20, 80, 40, 100), 10
    plain = a_point(box=box, context=context)
    scored = run_point(dataclasses.replace(plain, score="structure"), None).result
    scene = synthetic.scene("edge")
    around = slice(10, 90), slice(30, 110)
    flow = estimate_flow(scene.frame0[around], scene.frame1[around], method="tvl1", **QUICK).flow[:, 10:70, 10:70]
    classes = structure_classes(scene.frame0)[20:80, 40:100]  # of the whole frame, as thresholds are relative
    expected = {
        name: flow_errors(flow, scene.truth[:, 20:80, 40:100], classes == index)
        for index, name in enumerate(CLASSES)
        if (classes == index).any()
    }
    assert len(expected) >= 2
    assert scored["classes"] == {name: vars(errors) for name, errors in expected.items()}
    assert "classes" not in run_point(plain, None).result


def test_errors_of_fluids_are_those_of_derivatives_and_of_the_grid_of_the_frame():
    plain = a_point(box=(20, 80, 40, 100), context=10)
    scored = run_point(dataclasses.replace(plain, score="fluid"), None).result
    scene = synthetic.scene("edge")
    around = slice(10, 90), slice(30, 110)
    flow = estimate_flow(scene.frame0[around], scene.frame1[around], method="tvl1", **QUICK).flow[:, 10:70, 10:70]
    truth = scene.truth[:, 20:80, 40:100]
    # the box begins at pixel 10 of the part that is computed on: its first multiple of 8 is 16
    grid = (slice(None), slice(6, None, 8), slice(6, None, 8))
    on_grid = {"aepe": flow_errors(flow[grid], truth[grid]).aepe} | vars(
        derivative_errors(flow[grid], truth[grid], 8.0)
    )
    expected = vars(derivative_errors(flow, truth)) | {f"{name}_grid": value for name, value in on_grid.items()}
    assert scored["fluid"] == expected
    assert scored["gradients"] == errors_by_gradient(flow, truth)
    assert not {"fluid", "gradients"} & set(run_point(plain, None).result)
