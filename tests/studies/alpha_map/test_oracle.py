"""Maps of orders chosen by the truth, against brute force, against single flows, and their files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fracbench.data.files import write_flow
from fracbench.errors import FracbenchError
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.harness.run import flows
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import make_plan
from fracbench.model.structure import CLASSES, structure_classes
from fracbench.studies.alpha_map import oracle
from fracbench.studies.alpha_map.oracle import (
    SCOPES,
    best_orders,
    composed,
    compute_oracle,
    load_maps,
    load_oracle,
    oracle_file,
)

CHEAP = ["n_scales=1", "n_warps=1", "max_iter=2", "method=tvl1_sb_alpha"]


@pytest.fixture
def errors():
    """End-point errors of three orders on 20 x 24 pixels, of which some are not known."""
    found = np.random.default_rng(2).uniform(0.0, 1.0, (3, 20, 24))
    found[:, :6, :9] = np.nan
    return found


def test_orders_are_those_of_brute_force(errors):
    classes = np.random.default_rng(3).integers(0, 3, (20, 24)).astype(np.uint8)
    maps = best_orders(errors, classes, 3)
    known = ~np.isnan(errors[0])
    usual = int(np.nansum(errors, axis=(1, 2)).argmin())
    for y, x in np.ndindex(20, 24):
        about = errors[:, max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        anything = ~np.isnan(about).all()
        window = int(np.nansum(about, axis=(1, 2)).argmin()) if anything else usual
        assert maps["window"][y, x] == window, (y, x)
        assert maps["pixel"][y, x] == (int(errors[:, y, x].argmin()) if known[y, x] else usual)
    for k in range(3):
        sums = np.nansum(np.where(classes == k, errors, 0.0), axis=(1, 2))
        assert (maps["class"][classes == k] == sums.argmin()).all()


def test_the_finer_the_scope_the_less_the_error(errors):
    maps = best_orders(errors, np.zeros((20, 24), np.uint8), 7)
    least = {
        scope: np.nanmean(np.take_along_axis(errors, maps[scope][None].astype(int), axis=0)) for scope in SCOPES
    }
    assert (
        least["pixel"] < least["window"] < least["class"] == pytest.approx(np.nanmean(errors, axis=(1, 2)).min())
    )


def test_flows_are_put_together_pixel_by_pixel():
    flows = np.arange(3 * 2 * 2 * 2).reshape(3, 2, 2, 2)
    orders = np.array([[0, 1], [2, 0]], np.uint8)
    assert composed(flows, orders).tolist() == [[[0, 9], [18, 3]], [[4, 13], [22, 7]]]


@pytest.fixture
def sequence(work):
    plan = make_plan(["sequence=synthetic_edge", *CHEAP, "alpha=0.8,1.2"])
    for name in ("flows", "oracles"):
        (work / name).mkdir()
    return [planned.point for planned in plan.points], work


def test_a_whole_oracle_on_a_scene(sequence):
    points, work = sequence
    compute_oracle(points, None, work / "flows", 16, work / "oracles")
    found, maps = (load(points, 16, work / "oracles") for load in (load_oracle, load_maps))
    frame0, _, truth, _ = point_arrays(points[0], None)
    assert (maps["classes"] == structure_classes(frame0)).all()
    assert found["alphas"] == [0.8, 1.2]
    flows = np.stack([oracle._kept_flow(point, None, work / "flows") for point in points])
    by_hand = np.minimum(*(endpoint_error(flow, truth) for flow in flows))
    assert found["scopes"]["pixel"]["least"]["aepe"] == pytest.approx(np.nanmean(by_hand), rel=1e-6)
    for name in CLASSES:
        own = found["classes"][name]
        mask = maps["classes"] == CLASSES.index(name)
        assert own["pixels"] == mask.sum() == sum(own["window"]) == sum(own["pixel"])
        expected = [endpoint_error(flow, truth)[mask].sum() for flow in flows]
        assert own["sums"] == pytest.approx(expected)
    singles = [flow_errors(flow, truth).aepe for flow in flows]
    runs = [found["scopes"][scope]["run"]["aepe"] for scope in SCOPES]
    assert all(0.0 < error < 1.5 * max(singles) for error in runs)


def test_what_is_kept_is_not_computed_again(sequence, monkeypatch):
    points, work = sequence
    truth = point_arrays(points[0], None)[2]
    for point in points:  # a stored array is taken for the flow
        write_flow(work / "flows" / f"{point.key}.flo", truth)
    monkeypatch.setattr(flows, "get_method", lambda name: pytest.fail("computed"))
    compute_oracle(points, None, work / "flows", 16, work / "oracles")
    found = load_oracle(points, 16, work / "oracles")
    assert found["scopes"]["pixel"]["least"]["aepe"] == 0.0
    assert set(found["scopes"]) == set(SCOPES)


def test_other_points_or_another_window_are_another_oracle(sequence):
    points, work = sequence
    names = {oracle_file(*given, work) for given in ((points, 16), (points, 32), (points[:1], 16))}
    assert len(names) == 3
    assert load_oracle(points, 16, work / "oracles") is None


@pytest.mark.parametrize(("load", "suffix"), [(load_oracle, ".json"), (load_maps, ".npz")])
def test_a_damaged_file_is_named(sequence, load, suffix):
    points, work = sequence
    path = oracle_file(points, 16, work / "oracles").with_suffix(suffix)
    path.write_text(json.dumps({"alphas": [1]})[:-1])
    with pytest.raises(FracbenchError, match=path.name):
        load(points, 16, work / "oracles")
