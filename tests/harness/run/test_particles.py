"""Particle images on the command line: their settings are keys of a grid, and of a point if unusual."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench.data.datasets.particles.images import SETTINGS, digest, particle_pair
from fracbench.data.datasets.registry import get_dataset
from fracbench.harness.config.compose import SCENE
from fracbench.harness.run.compute_point import run_point
from fracbench.harness.run.plan import make_plan
from fracbench.methods.registry import get_method

TINY = ["dataset=particles", "n_scales=1", "n_warps=1", "max_iter=2"]


def test_the_keys_of_the_command_line_are_the_settings_of_the_dataset():
    assert tuple(SETTINGS) == SCENE
    assert set(get_dataset("particles").settings) == {"noise", "seed", *SCENE}


def test_a_grid_over_settings():
    plan = make_plan([*TINY, "sequence=jet,shear", "density=0.02,0.1", "displacement=0.5:12:5.75", "seed=0:2:1"])
    assert len(plan.unique()) == 36 and plan.varying == ("sequence", "density", "displacement", "seed")
    last = plan.points[-1]
    assert last.point.scene == (("density", 0.1), ("displacement", 12.0)) and last.point.seed == 2
    assert last.point.data_digest == digest("shear", density=0.1, displacement=12, seed=2)
    assert last.point.spec["scene"] == {"density": "0.1", "displacement": "12"}
    assert {key: last.labels[key] for key in ("density", "displacement", "seed")} == {
        "density": "0.1",
        "displacement": "12",
        "seed": "2",
    }


def test_all_flows_are_taken_where_none_is_named():
    assert len(make_plan(TINY).points) == len(make_plan([*TINY, "sequence=all"]).points) == 9


def test_a_usual_value_is_no_part_of_the_key():
    plain, given = (make_plan([*TINY, "sequence=jet", *more]).points[0] for more in ([], ["density=0.05"]))
    assert plain.point.key == given.point.key and "scene" not in plain.point.spec
    assert given.labels["density"] == "0.05" and "density" not in plain.labels
    assert make_plan([*TINY, "sequence=jet", "density=null"]).points[0] == plain


def test_a_point_is_computed_on_the_pair_that_its_settings_give():
    point = make_plan([*TINY, "sequence=stagnation", "displacement=3", "lost=0.1", "margin=8"]).points[0].point
    outcome = run_point(point, None)
    assert outcome.status == "done", outcome.error
    pair = particle_pair("stagnation", displacement=3.0, lost=0.1)
    error = get_method(point.method).compute(pair.frame0, pair.frame1, point.params).flow - pair.truth
    assert outcome.result["aepe"] == pytest.approx(np.hypot(*error)[8:-8, 8:-8].mean(), rel=1e-5)
    assert outcome.result["n_pixels"] == 240**2


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["dataset=particles", "sequence=lamb_osen"], "did you mean 'lamb_oseen'?"),
        (["dataset=particles", "displacement=13"], "`displacement` must be within 0.5..12, got 13"),
        (["dataset=particles", "density=few"], "`density` must be a number, got 'few'"),
        (["dataset=particles", "densty=0.1"], "unknown key 'densty': did you mean 'density'?"),
        (["dataset=particles", "lost=-0.1"], "lost must be finite and at least 0, got -0.1"),
        (["dataset=particles", "slope=2"], "`slope` is of sequence=solenoidal alone"),
        (["dataset=particles", "region=grove2_A"], "regions belong to Middlebury; dataset=particles has none"),
        (["dataset=particles", "region=grove2_A,urban3_A"], "region=grove2_A: regions belong to Middlebury"),
        (["sequence=synthetic_edge", "density=0.1"], "density=0.1 needs dataset=particles"),
        (["sequence=grove2", "displacement=2"], "displacement=2 needs dataset=particles, sequence=grove2 is none"),
    ],
)
def test_bad_settings_are_refused(work, refused, words, named):
    refused(work, ["sweep", "alpha=1", *words], named)
    refused(work, ["sweep", "alpha=1", *words, "--dry-run"], named)
