"""Points that are made when they are asked for are those that one would list, and so are their keys."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import pytest

from fracbench.errors import InputError
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.run import sweep
from fracbench.harness.run.grid_points import PlannedPoints, UniquePoints
from fracbench.harness.run.plan import make_plan, plan_experiment
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Store
from fracbench.methods.registry import METHODS, get_method

GRIDS = {
    "free axes last": ["sequence=synthetic_flat,synthetic_edge", "alpha=0:1:0.5", "lambda=0.1,0.3"],
    "free axes first": ["lambda=0.1,0.3", "alpha=1,0.5", "sequence=synthetic_flat,synthetic_edge"],
    "bound between free": ["theta=0.2,0.3", "sequence=synthetic_flat,synthetic_edge", "alpha=0,1"],
    "zipped": ["sequence=synthetic_flat", "zip(theta,alpha)=(0.3,1),(0.2,0.5)", "eta=0.5,0.7"],
    "zipped with a bound key": ["zip(sequence,alpha)=(synthetic_flat,1),(synthetic_edge,2)", "theta=0.2,0.3"],
    "by its long name": ["sequence=synthetic_flat", "params.alpha=0,1", "params.lambda=0.1,0.3"],
    "left out of the key where it is off": ["sequence=synthetic_flat", "finest_scale=0,1", "normalisation=0,2"],
    "methods that do not know all": [
        "sequence=synthetic_flat",
        "method=tvl1,tvl1_sb_alpha",
        "alpha=0,1",
        "tau=0.1,0.2",
    ],
    "words": ["sequence=synthetic_flat", "boundary=zero,reflect", "n_scales=2,auto"],
    "settings": ["dataset=particles", "sequence=shear", "seed=0,1", "alpha=1,1.5", "noise=0,2"],
    "nothing free": ["sequence=synthetic_flat,synthetic_edge"],
    "regions": ["dataset=synthetic", "region=grove2_A,grove2_B", "alpha=0,1"],
    "a method with parameters of its own": ["sequence=synthetic_flat", "method=opencv_dis,tvl1", "theta=0.2,0.3"],
}


def plan(*tokens):
    return make_plan(tokens, allow_download=False)


def one_by_one(tokens):
    """Plan each point of a grid alone."""
    for values in parse_overrides(tokens).points():
        (planned,) = plan(*(f"{key}={value}" for key, value in values.items())).points
        yield planned


@pytest.fixture(params=GRIDS)
def tokens(request):
    if "own" in request.param:
        pytest.importorskip("cv2", reason="needs the extra `peers`")
    return GRIDS[request.param]


def test_points_and_keys_are_those_of_points_planned_alone(tokens):
    made, alone = plan(*tokens), list(one_by_one(tokens))
    assert len(made.points) == len(alone)
    assert list(made.points) == alone
    assert [planned.point.params for planned in made.points] == [planned.point.params for planned in alone]
    assert list(made.points.keys()) == [planned.point.key for planned in alone]
    for i, planned in enumerate(alone):
        assert made.points[i].point.key == planned.point.key  # hashed from the point itself
        assert made.points[i].point.spec == planned.point.spec
        assert made.points.identity(i) == planned.point.identity


def test_distinct_points_are_counted_without_their_keys(tokens):
    made = plan(*tokens)
    keys = dict.fromkeys(planned.point.key for planned in one_by_one(tokens))
    groups = [(point, count, [*found]) for point, count, found in made.points.groups()]
    assert sum(count for _, count, _ in groups) == len(keys)
    assert {key for *_, found in groups for key in found} == keys.keys()
    unique = made.unique()
    assert isinstance(unique, UniquePoints)
    assert list(unique) == list(keys)
    for key, point in unique.items():
        assert vars(point).pop("key") == key
        assert point.key == key
        assert unique.identity(key) == point.identity


def test_the_values_of_a_parameter(tokens):
    made = plan(*tokens)
    points = [planned.point for planned in made.points]
    for name in ("boundary", "alpha", "tau"):
        assert made.values(name) == {point.canonical[name] for point in points if name in point.canonical}
    assert made.labels("protocol") == {planned.labels["protocol"] for planned in made.points}


def test_the_identity_is_that_of_all_versions(monkeypatch):
    monkeypatch.setitem(METHODS, "versioned", replace(get_method("tvl1"), name="versioned", version="7"))
    made = plan("sequence=synthetic_flat", "method=versioned", "theta=0.2,0.3")
    for i, planned in enumerate(made.points):
        assert "version" in planned.point.spec
        assert made.points.identity(i) == planned.point.identity


def test_a_value_out_of_range_is_refused_before_a_point_is_made(monkeypatch):
    with pytest.raises(InputError, match=r"`alpha` must be in \[0, 2\], got 2.5"):
        plan("sequence=synthetic_flat", "theta=0.1:1:0.1", "alpha=0:2.5:0.5")


def test_grids_one_after_another():
    """Grids that share points and frames, a grid without a free axis, and listed points."""
    parts = {
        "one": ("sequence=synthetic_flat,synthetic_edge", "alpha=0.5,1"),
        "two": ("sequence=synthetic_flat", "alpha=1,1.25,1.5"),
        "three": ("sequence=synthetic_edge",),
    }
    made = plan_experiment(parts, allow_download=False)
    alone = [each for tokens in parts.values() for each in one_by_one(tokens)]
    labels = [part for part, count in zip(parts, (4, 3, 1), strict=True) for _ in range(count)]
    assert [planned.labels["part"] for planned in made.points] == labels
    more = replace(made, points=PlannedPoints(made.points, alone[2:4], []))
    alone += alone[2:4]
    assert [planned.point for planned in more.points] == [planned.point for planned in alone]
    keys = [planned.point.key for planned in alone]
    assert list(more.points.keys()) == keys == [planned.point.key for planned in more.points]
    assert list(more.unique()) == list(dict.fromkeys(keys)) and len(keys) - len(more.unique()) == 3
    for i, planned in enumerate(alone):
        assert more.points[i].point == planned.point
        assert more.points.identity(i) == planned.point.identity
        frame = more.points.frames[more.points.frame_of(i)]
        assert frame.point.data_digest == planned.point.data_digest
    groups = [(count, list(found)) for _, count, found in more.points.groups()]
    assert sorted(key for _, found in groups for key in found) == sorted(more.unique())
    assert all(count == len(found) > 0 for count, found in groups)
    assert list(PlannedPoints().groups()) == list(PlannedPoints([]).keys()) == []
    assert more.values("alpha") == {planned.point.canonical["alpha"] for planned in alone}


def test_slices_and_the_end(tokens):
    points = plan(*tokens).points
    assert points[1:3] == tuple(islice(points, 1, 3))
    assert points[-1] == list(points)[-1]
    with pytest.raises(IndexError):
        points[len(points)]


def test_a_million_points_are_counted_without_being_made(tmp_path, monkeypatch):
    def refuse(*_):
        raise AssertionError("a point was made")

    made = plan("sequence=synthetic_flat", "alpha=0:0.999:0.001", "lambda=0.001:1:0.001")
    monkeypatch.setattr("fracbench.harness.run.grid_points._changed", refuse)
    monkeypatch.setattr(Point, "key", property(refuse))
    with Store(tmp_path / "store.sqlite") as store:
        total, ((_, count),) = sweep.count_missing(made, store)
    assert total == count == 1_000_000


@pytest.mark.parametrize("rerun_failed", [False, True])
def test_counts_are_those_of_the_comparison(tmp_path, fake_rows, tokens, rerun_failed):
    made = plan(*tokens)
    rows = list(fake_rows(made).values())
    with Store(tmp_path / "store.sqlite") as store:
        other = plan("sequence=synthetic_corner", "alpha=0.1:1:0.1")
        for more in ((), fake_rows(other).values()):  # fewer rows than points, then more
            for row in (*rows[:1], *more):
                store.put(row)
            for row in fake_rows(make_plan(tokens), status="failed").values():
                if row.key == rows[-1].key and len(rows) > 1:
                    store.put(row)
            report, todo = sweep.missing(made, store, rerun_failed=rerun_failed)
            total, counted = sweep.count_missing(made, store, rerun_failed=rerun_failed)
            assert (total, sum(count for _, count in counted)) == (len(made.unique()), len(todo))
            assert report.reused == total - len(todo) > 0
