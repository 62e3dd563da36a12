"""Maps of orders chosen by the truth, against brute force, against single flows, and their files."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fracbench.errors import FracbenchError
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import make_plan
from fracbench.methods.registry import get_method
from fracbench.model.structure import CLASSES, structure_classes
from fracbench.studies.alpha_map import oracle
from fracbench.studies.alpha_map.oracle import SCOPES, best_orders, bounds, composed, pack, unpack

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


def test_a_packed_map_is_the_map(errors):
    orders = errors.argmin(axis=0).astype(np.uint8)
    assert (unpack(pack(orders), orders.shape) == orders).all()


@pytest.fixture
def point():
    """The bounds of a scene with two orders."""
    singles = make_plan(["sequence=synthetic_edge", *CHEAP, "alpha=0.8,1.2"]).points
    alphas = tuple(planned.point.params.alpha for planned in singles)
    return replace(singles[0].point, score="oracle", options=(("alphas", alphas), ("window", 16)))


def test_a_whole_oracle_on_a_scene(point):
    found = bounds(point, None)
    frame0, frame1, truth, _ = point_arrays(point, None)
    classes = structure_classes(frame0)
    maps = {scope: unpack(text, classes.shape) for scope, text in found["maps"].items()}
    assert found["alphas"] == (0.8, 1.2)
    estimate = get_method(point.method).estimate
    flows = [estimate(frame0, frame1, point.params.replace({"alpha": alpha})).flow for alpha in (0.8, 1.2)]
    errors = np.stack([endpoint_error(flow, truth) for flow in flows])
    assert found["scopes"]["pixel"]["least"]["aepe"] == pytest.approx(np.nanmean(errors.min(axis=0)), rel=1e-6)
    for name in CLASSES:
        own = found["classes"][name]
        mask = classes == CLASSES.index(name)
        assert own["pixels"] == mask.sum() == sum(own["window"]) == sum(own["pixel"])
        assert own["sums"] == pytest.approx(errors[:, mask].sum(axis=1))
        for scope, orders in maps.items():
            assert own[scope] == np.bincount(orders[mask], minlength=2).tolist()
    singles = [flow_errors(flow, truth).aepe for flow in flows]
    runs = [found["scopes"][scope]["run"]["aepe"] for scope in SCOPES]
    assert all(0.0 < error < 1.5 * max(singles) for error in runs)


def test_other_orders_or_another_window_are_another_point(point):
    changes = ({}, {"window": 32}, {"alphas": (0.8,)})
    others = [replace(point, options=tuple({**dict(point.options), **change}.items())) for change in changes]
    assert len({each.key for each in others}) == 3 and others[0].key == point.key


def test_a_flow_that_is_not_finite_has_no_bounds(point, monkeypatch):
    broken = SimpleNamespace(flow=np.full((2, *point_arrays(point, None)[0].shape), np.nan, np.float32))
    monkeypatch.setattr(oracle, "get_method", lambda name: SimpleNamespace(estimate=lambda *_: broken))
    with pytest.raises(FracbenchError, match="a flow of a single order is not finite"):
        bounds(point, None)
