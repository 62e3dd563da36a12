from __future__ import annotations

from dataclasses import replace

import pytest

from fracbench.data.regions import Region
from fracbench.harness.run.cost import ROUGH_SECONDS_PER_PIXEL
from fracbench.harness.run.cost import expected_seconds as expected_of_many
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import Row
from fracbench.model.params import FlowParams

SCENE = 128 * 160


def expected_seconds(points, rows, jobs):
    return expected_of_many([(point, 1) for point in points], rows, jobs)


def a_point(method="tvl1", dataset="synthetic", sequence="edge", box=None, context=0):
    region = None if box is None else Region("box", sequence, box[:2], box[2:])
    return Point(method, FlowParams(), dataset, sequence, region, context, "")


def a_row(seconds, status="done", **of_the_point):
    point = a_point(**of_the_point)
    error = None if status == "done" else "x"
    return Row(
        key=str(seconds),
        identity="",
        spec=point.spec,
        solver_version=1,
        status=status,
        error=error,
        seconds=seconds,
    )


def test_nothing_takes_no_time():
    assert expected_seconds([], [], 2) == (0.0, True)


def test_a_rough_number_stands_in_for_a_method_never_run():
    seconds, measured = expected_seconds([a_point()] * 4, [], 2)
    assert seconds == pytest.approx(4 * SCENE * ROUGH_SECONDS_PER_PIXEL / 2)
    assert not measured
    assert not expected_seconds([a_point()], [a_row(3.0, method="tvl1_sb")], 1)[1]


def test_the_median_of_the_methods_own_points_is_taken():
    rows = [a_row(1.0), a_row(2.0), a_row(9.0), a_row(500.0, method="tvl1_sb")]
    assert expected_seconds([a_point()] * 6, rows, 2) == (pytest.approx(6 * 2.0 / 2), True)


def test_points_that_failed_or_were_not_timed_tell_nothing():
    rows = [a_row(1.0), a_row(100.0, status="failed"), a_row(200.0, status="crashed"), a_row(None)]
    assert expected_seconds([a_point()], rows, 1) == (pytest.approx(1.0), True)


def test_time_goes_with_the_pixels():
    grove = a_point(dataset="middlebury", sequence="Grove2")
    venus = a_point(dataset="middlebury", sequence="Venus")
    region = a_point(dataset="middlebury", sequence="Grove2", box=(90, 250, 190, 390))
    around = a_point(dataset="middlebury", sequence="Grove2", box=(90, 250, 190, 390), context=20)
    rows = [a_row(480 * 640 / 1000, dataset="middlebury", sequence="Grove2")]
    seconds = [expected_seconds([point], rows, 1)[0] for point in (grove, venus, region, around)]
    assert seconds == pytest.approx([307.2, 380 * 420 / 1000, 160 * 200 / 1000, 200 * 240 / 1000])


def test_rows_of_a_dataset_that_is_gone_tell_the_speed():
    row = a_row(2.0)
    gone = replace(row, spec={**row.spec, "dataset": "gone"}, result={"n_pixels": SCENE - 5, "n_unknown": 5})
    assert expected_seconds([a_point()], [gone], 1) == (pytest.approx(2.0), True)


def test_a_point_is_not_shared_between_workers():
    rows = [a_row(10.0)]
    assert expected_seconds([a_point()], rows, 8)[0] == pytest.approx(10.0)
    assert expected_seconds([a_point()] * 16, rows, 8)[0] == pytest.approx(20.0)
