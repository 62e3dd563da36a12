"""Plans: which points a line of overrides stands for, and what a point's key depends on."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fracbench
from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.data.datasets.middlebury import SEQUENCES, Resolved
from fracbench.data.datasets.synthetic import scenes as synthetic
from fracbench.data.files import write_image
from fracbench.errors import InputError
from fracbench.harness.config.compose import group_options, load_config
from fracbench.harness.run import point as point_module
from fracbench.harness.run.plan import Plan, make_plan, plan_experiment
from fracbench.harness.run.point import canonical_value
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams

FLAT = "sequence=synthetic_flat"


def box(point):
    return None if point.region is None else (*point.region.rows, *point.region.cols)


def plan(*tokens: str) -> Plan:
    return make_plan(tokens, allow_download=False)


def keys(*tokens: str) -> list[str]:
    return [planned.point.key for planned in plan(*tokens).points]


def key(*tokens: str) -> str:
    (only,) = keys(*tokens)
    return only


def params(made: Plan, name: str) -> list[str]:
    return [planned.point.canonical[name] for planned in made.points]


def labels(made: Plan, name: str) -> list[str]:
    return [planned.labels[name] for planned in made.points]


def refusal(*tokens: str) -> str:
    with pytest.raises(InputError) as caught:
        plan(*tokens)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


@pytest.fixture
def middlebury_found(monkeypatch):
    """Middlebury data that are there, with a digest each, and need not be read."""
    monkeypatch.setattr(
        middlebury_data, "_look_up", lambda explicit: middlebury_data.Location(Path("m"), "test", 24)
    )
    monkeypatch.setattr(middlebury_data, "digest", lambda sequence, folder: f"{folder}/{sequence}")
    yield


# -- which points --------------------------------------------------------------------------------


def test_a_range_has_both_ends_and_its_values_are_decimals():
    made = plan("alpha=0:2:0.1", FLAT)
    assert params(made, "alpha") == [
        *["0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7", "0.8", "0.9", "1"],
        *["1.1", "1.2", "1.3", "1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "2"],
    ]
    assert made.varying == ("alpha",)
    assert len(made.unique()) == 21


def test_several_keys_make_a_product_whose_last_key_changes_fastest():
    made = plan("lambda=0.1,0.2", "protocol=reference,recommended", "alpha=1:2:1", FLAT)
    points = [*zip(params(made, "lambda"), labels(made, "protocol"), params(made, "alpha"), strict=True)]
    assert points == [
        ("0.1", "reference", "1"),
        ("0.1", "reference", "2"),
        ("0.1", "recommended", "1"),
        ("0.1", "recommended", "2"),
        ("0.2", "reference", "1"),
        ("0.2", "reference", "2"),
        ("0.2", "recommended", "1"),
        ("0.2", "recommended", "2"),
    ]
    assert made.varying == ("lambda", "protocol", "alpha")


def test_zipped_keys_change_together():
    made = plan("zip(lambda,theta)=(0.3,0.4),(0.5,0.6)", FLAT)
    assert [*zip(params(made, "lambda"), params(made, "theta"), strict=True)] == [("0.3", "0.4"), ("0.5", "0.6")]


def test_all_regions_and_globs(middlebury_found):
    assert labels(plan("region=all"), "region") == group_options("region")
    assert labels(plan("region=grove2_*"), "region") == ["grove2_A", "grove2_B"]
    assert labels(plan("region=urban3_A,*_B"), "region") == ["urban3_A", "grove2_B", "hydrangea_B"]
    boxes = [box(planned.point) for planned in plan("region=grove2_*").points]
    assert boxes == [(90, 250, 190, 390), (360, 460, 60, 220)]


def test_all_sequences_are_those_of_the_paper(middlebury_found):
    assert labels(plan("sequence=all"), "sequence") == [name.lower() for name in SEQUENCES]
    assert labels(plan("sequence=grove*"), "sequence") == ["grove2", "grove3"]
    scenes = labels(plan("sequence=synthetic_[ce]*"), "sequence")
    assert scenes == ["synthetic_corner", "synthetic_edge"]


def test_without_overrides_there_is_one_point(middlebury_found):
    (planned,) = plan().points
    assert (planned.point.sequence, planned.point.method, box(planned.point)) == (
        "RubberWhale",
        "tvl1_sb_alpha",
        None,
    )


def test_every_parameter_of_the_region_reaches_the_point(middlebury_found):
    (planned,) = plan("region=grove2_B", "alpha=0.6").points
    wanted = {
        "lambda": "0.3",
        "theta": "0.3",
        "lambda_sb": "7",
        "n_scales": "5",
        "alpha": "0.6",
        "boundary": "zero",
    }
    assert {name: planned.point.canonical[name] for name in wanted} == wanted
    assert list(planned.point.canonical) == sorted(get_method("tvl1_sb_alpha").uses)
    assert planned.labels == {
        "dataset": "middlebury",
        "sequence": "grove2",
        "region": "grove2_B",
        "method": "tvl1_sb_alpha",
        "protocol": "reference",
        "context": "0",
    }


def test_a_shifted_region_is_another_box_of_the_same_size(middlebury_found):
    made = plan("region=grove2_A", "shift=0,12,24")
    assert [box(planned.point) for planned in made.points] == [
        (74, 234, 174, 374),
        (90, 250, 190, 390),
        (106, 266, 206, 406),
    ]
    assert labels(made, "shift") == ["0", "12", "24"]


def test_a_grid_too_large_is_counted_not_made():
    message = refusal("alpha=0:2:1e-9", FLAT)
    assert "2000000001 points" in message
    assert "1000000" in refusal("alpha=0:2:0.001", "region=all", "lambda=0.01:1:0.01")


def test_a_grid_may_be_thinned_to_try_it_out(middlebury_found):
    made = make_plan(["alpha=0:2:0.1", "region=all", "boundary=zero,reflect"], small=True)
    assert made.small
    assert params(made, "alpha")[::4] == ["0", "1", "2"]
    assert len(made.points) == 3 * 2 * 2
    assert not plan("alpha=0,1", FLAT).small


# -- keys ----------------------------------------------------------------------------------------

#: Another value for each parameter, other than the one it has in `BASE`.
OTHER = {
    "lambda": "0.31", "theta": "0.31", "lambda_sb": "11", "alpha": "1.3", "epsilon": "0.02", "eta": "0.6",
    "n_scales": "3", "n_warps": "6", "max_iter": "301", "presmoothing": "0.7", "boundary": "reflect", "pad": "4",
    "u_solver": "gauss_seidel", "inner": "cold", "tol": "0.02", "max_inner": "31", "tau": "0.2",
    "upsample_gain": "0.5", "relinearise": "false", "dual_restart": "true", "gradient_scale": "2",
    "epsilon_squared": "false", "dtype": "float64", "coupling": "penalty", "coupling_step": "2",
    "relaxation": "1.1", "alpha_flat": "0.9", "alpha_edge": "0.9", "alpha_corner": "0.9", "alpha_texture": "0.9",
    "lambda_gradient": "1", "derivatives": "both", "edge_decay": "0.1", "edge_power": "1", "median_radius": "1",
    "weighted_radius": "2", "finest_scale": "1", "texture": "0.95", "occlusion": "none", "alpha_smooth": "1.6",
    "smooth_weight": "3", "smooth_penalty": "10", "normalisation": "8", "lambda_growth": "1",
    "weighted_guide": "color",
    "intensity": "unit", "lambda_factor": "2", "theta_factor": "2", "swap_weights": "true",
    "smoothing_at": "scales", "downsampling": "area", "upsampling": "nearest", "gradient_of": "mean",
    "stencil": "forward", "warp": "bilinear", "outside": "repeat", "threshold": "no_theta",
    "u0_per_scale": "true", "residual_u0": "false", "unknown": "increment", "shrinkage": "anisotropic",
    "lambda_l": "3", "sweeps": "2", "sweep_order": "backward", "stencil_border": "four_zero", "tol_norm": "max",
}  # fmt: skip


def test_every_parameter_is_varied_here():
    assert set(OTHER) == set(FlowParams.names())


@pytest.mark.parametrize("method", ["tvl1", "tvl1_sb", "tvl1_sb_alpha", "tvl1_sb_alpha_map", "tvl1_sb_alpha_ic"])
@pytest.mark.parametrize("name", sorted(OTHER))
def test_a_key_changes_with_a_parameter_exactly_if_the_method_uses_it(method, name):
    base = [FLAT, f"method={method}"]
    assert (key(*base) != key(*base, f"{name}={OTHER[name]}")) == (name in get_method(method).uses)


def test_what_came_later_is_in_no_key_where_it_is_off():
    """Keys of results that were stored before there was such a parameter stay as they were."""
    usual = FlowParams().as_dict()
    (planned,) = plan(FLAT, "method=tvl1_sb_alpha_map").points
    younger = get_method("tvl1_sb_alpha_map").younger
    for name, value in younger.items():
        assert usual[name] == value and planned.point.canonical[name] == canonical_value(value)
    older = get_method("tvl1_sb_alpha_map").uses - younger.keys()
    assert set(planned.point.spec["params"]) == older
    (both,) = plan(FLAT, "method=tvl1_sb_alpha_map", "texture=0.95", "finest_scale=1").points
    assert set(both.point.spec["params"]) == older | {"texture", "finest_scale"}


def test_a_key_changes_with_whatever_else_matters(middlebury_found):
    base = key("region=grove2_A")
    others = [
        key("region=grove2_B", "lambda_sb=5"),
        key("region=grove2_A", "context=8"),
        key("region=grove2_A", "shift=3"),
        key("sequence=grove2", "n_scales=5", "lambda_sb=5"),
        key("sequence=grove3", "lambda=0.3", "theta=0.3", "n_scales=5", "lambda_sb=5"),
        key("region=grove2_A", "dataset=synthetic"),
        key("region=grove2_A", "method=tvl1"),
    ]
    assert len({base, *others}) == 1 + len(others)


def test_a_key_changes_with_the_content_of_the_data(middlebury_found, monkeypatch):
    base = key("sequence=grove2")
    assert key("sequence=grove2") == base
    monkeypatch.setattr(middlebury_data, "digest", lambda sequence, folder: "another")
    changed = plan("sequence=grove2").points[0].point
    assert changed.key != base
    assert changed.identity == dataclasses.replace(changed, data_digest="x").identity


def test_a_key_changes_with_the_solvers_version_but_an_identity_does_not(monkeypatch):
    (before,) = plan(FLAT).points
    key_before = before.point.key
    monkeypatch.setattr(point_module, "SOLVER_VERSION", point_module.SOLVER_VERSION + 1)
    (after,) = plan(FLAT).points
    assert after.point.key != key_before
    assert after.point.identity == before.point.identity


def test_a_key_does_not_depend_on_labels():
    """The protocol is a name for parameters: the same ones are the same point."""
    reference, own = (
        load_config({"sequence": "synthetic_flat", "protocol": name}).params.as_dict()
        for name in ("reference", "recommended")
    )
    tokens = [f"{name}={value}" for name, value in reference.items() if value != own[name]]
    assert key(FLAT, "protocol=recommended", *tokens) == key(FLAT, "protocol=reference")
    assert key(FLAT, "protocol=recommended") != key(FLAT, "protocol=reference")


def test_a_key_does_not_depend_on_where_things_are_or_how_many_work(middlebury_found):
    assert key(FLAT) == key(FLAT, "paths.results=elsewhere", "parallel.jobs=1", "dataset=synthetic")
    assert key("region=grove2_A") == key("region=grove2_A", "sequence=grove2", "shift=null")


def test_context_is_no_part_of_a_key_where_the_whole_frame_is_used(no_middlebury):
    made = plan("region=grove2_A", "context=0,8")
    assert len(made.unique()) == 1
    assert labels(made, "context") == ["0", "8"]


@pytest.mark.parametrize(
    ("one", "same"),
    [
        ("alpha=1", "alpha=1.0"),
        ("alpha=1", "alpha=+1e0"),
        ("alpha=0.30", "alpha=.3"),
        ("alpha=1", "params.alpha=1"),
        ("lambda_sb=10", "lambda_sb=1e1"),
        ("n_warps=5", "n_warps=5.0"),
        ("n_scales=auto", "n_scales=none"),
        ("relinearise=true", "relinearise=True"),
    ],
)
def test_one_value_has_one_key_however_it_is_spelt(one, same):
    assert key(FLAT, one) == key(FLAT, same)


def test_sums_of_decimals_are_the_decimals_one_would_type():
    assert keys(FLAT, "alpha=0:2:0.1") == [key(FLAT, f"alpha={k / 10:.1f}") for k in range(21)]


def test_keys_do_not_depend_on_the_process(work):
    tokens = ["alpha=0:1:0.5", "method=tvl1,tvl1_sb_alpha", "theta=log(0.1:1:5)", FLAT]
    code = (
        "from fracbench.harness.run.plan import make_plan\n"
        f"print(*(planned.point.key for planned in make_plan({tokens!r}).points))\n"
    )
    root = str(Path(fracbench.__file__).parents[1])
    environment = {**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": root}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == keys(*tokens)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "none"),
        (True, "true"),
        (False, "false"),
        (0.1, "0.1"),
        (1e-7, "0.0000001"),
        (10.0, "10"),
        (3, "3"),
        ("zero", "zero"),
    ],
)
def test_canonical_values(value, text):
    assert canonical_value(value) == text


# -- data ----------------------------------------------------------------------------------------


def test_scenes_stand_in_for_middlebury_with_a_notice(no_middlebury):
    made = plan("region=grove2_A,urban3_A", "alpha=1,2")
    assert (made.dataset, made.folder, made.stand_in) == ("synthetic", None, True)
    (notice,) = made.notices
    assert "using the synthetic scenes in place of Middlebury" in notice
    assert labels(made, "sequence") == ["synthetic_parallax"] * 2 + ["synthetic_corner"] * 2
    assert labels(made, "region") == ["grove2_A"] * 2 + ["urban3_A"] * 2
    for planned in made.points:
        assert (planned.point.dataset, box(planned.point)) == ("synthetic", None)


def test_every_sequence_of_the_paper_can_be_stood_in_for(no_middlebury):
    made = plan("sequence=all")
    assert len({planned.point.sequence for planned in made.points}) == len(SEQUENCES)


def test_scenes_asked_for_stand_in_for_nobody():
    for tokens in ([FLAT], [FLAT, "dataset=middlebury"], ["sequence=synthetic_*"]):
        made = plan(*tokens)
        assert (made.dataset, made.stand_in, made.notices) == ("synthetic", False, ())


def test_middlebury_asked_for_is_never_replaced(no_middlebury):
    assert "Middlebury data were not found" in refusal("sequence=grove2", "dataset=middlebury")


def test_scenes_beside_middlebury_keep_their_own_data(middlebury_found):
    """Whichever comes first."""
    for tokens in ("synthetic_flat,grove2", "grove2,synthetic_flat"):
        made = plan(f"sequence={tokens}")
        assert sorted(labels(made, "sequence")) == ["grove2", "synthetic_flat"]
        assert {planned.point.dataset for planned in made.points} == {"middlebury", "synthetic"}
        assert not made.stand_in
    asked = plan("sequence=synthetic_flat,grove2", "dataset=synthetic")
    assert asked.stand_in and labels(asked, "sequence") == ["synthetic_flat", "synthetic_parallax"]


def test_where_the_data_are_asked_for_is_passed_on(monkeypatch):
    seen = []

    def resolve(dataset, explicit, allow_download):
        seen.append((dataset, explicit, allow_download))
        return Resolved("synthetic")

    monkeypatch.setattr(middlebury_data, "resolve", resolve)
    plan("sequence=grove2", "paths.data=there")
    make_plan(["sequence=grove2", "dataset=middlebury"])
    assert seen == [("auto", "there", False), ("middlebury", None, True)]


# -- several grids -------------------------------------------------------------------------------


def test_the_grids_of_an_experiment_are_one_plan():
    grids = {"main": ["alpha=0,1", FLAT], "more": ["alpha=1", "theta=0.1,0.2", FLAT, "method=tvl1"]}
    made = plan_experiment(grids, ["paths.results=out"])
    assert labels(made, "part") == ["main", "main", "more", "more"]
    assert [planned.point.key for planned in made.points] == keys(*grids["main"]) + keys(*grids["more"])
    assert made.varying == ("alpha", "theta")
    assert made.config.results == Path("out")
    assert not made.stand_in


def test_grids_may_share_points():
    made = plan_experiment({"a": ["alpha=0,1", FLAT], "b": ["alpha=1,2", FLAT]})
    assert (len(made.points), len(made.unique())) == (4, 3)


def test_a_remark_on_several_grids_is_made_once(no_middlebury):
    made = plan_experiment({"a": ["sequence=grove2"], "b": ["sequence=venus"]}, allow_download=False)
    assert len(made.notices) == 1


def test_without_grids_there_is_a_data_set_and_no_point(middlebury_found):
    made = plan_experiment({})
    assert (len(made.points), made.varying, made.dataset, made.folder) == (0, (), "middlebury", Path("m"))


def test_the_data_of_every_grid_count(middlebury_found):
    grids = {"scenes": [FLAT], "paper": ["sequence=grove2"]}
    made = plan_experiment(grids)
    assert (made.dataset, made.folder, made.stand_in) == ("middlebury", Path("m"), False)
    assert plan_experiment(grids, ["dataset=synthetic"]).stand_in


def test_a_grid_keeps_its_own_dataset():
    grids = {"scenes": [FLAT], "fluids": ["dataset=particles", "sequence=shear"]}
    made = plan_experiment(grids, ["dataset=synthetic"])
    assert labels(made, "dataset") == ["synthetic", "particles"]
    assert not made.foreign


def test_a_part_whose_program_or_data_are_missing_is_left_out_and_named(monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv("FRACBENCH_PIV", str(tmp_path / "nowhere"))
    ours, peer, other = (
        ["dataset=particles", "sequence=shear", *more] for more in ([], ["method=opencv_dis"], [])
    )
    grids = {"ours": ours, "peer": peer, "again": peer, "public": ["dataset=piv"], "other": other}
    made = plan_experiment(grids)
    assert labels(made, "part") == ["ours", "other"]
    program, data = made.notices
    assert program == "method 'opencv_dis' needs cv2: pip install 'fracbench[peers]' (left out: peer, again)"
    assert "nowhere" in data and data.endswith("(left out: public)")
    with pytest.raises(InputError, match=r"^method 'opencv_dis' needs cv2: pip install 'fracbench\[peers\]'$"):
        plan_experiment({"peer": peer})


@pytest.fixture
def a_pair(tmp_path):
    (tmp_path / "a").mkdir()
    for i in (0, 1):
        write_image(tmp_path / "a" / f"frame{i}.png", np.eye(24, dtype=np.uint8))
    return [f"paths.data={tmp_path}"]


def test_the_folder_of_a_plan_is_that_of_the_part_that_has_files(a_pair, tmp_path):
    grids = {"rendered": ["dataset=particles", "sequence=shear"], "files": ["dataset=folder"]}
    made = plan_experiment(grids, a_pair)
    assert made.folder == tmp_path and labels(made, "dataset") == ["particles", "folder"]


def test_other_pairs_do_not_take_the_place_of_a_grids_own_dataset(a_pair):
    with pytest.raises(InputError, match="part 'a' is of dataset=particles, which dataset=folder cannot take"):
        plan_experiment({"a": ["dataset=particles"]}, ["dataset=folder", *a_pair])


# -- notices and refusals ------------------------------------------------------------------------


def test_a_key_that_changes_nothing_is_remarked_upon():
    made = plan("alpha=0,1", "method=tvl1", FLAT)
    assert made.notices == ("`alpha` does not affect the method",)
    assert len(made.points) == 2 and len(made.unique()) == 1
    assert plan("alpha=0,1", "method=tvl1,tvl1_sb_alpha", FLAT).notices == ()
    assert plan("params.tau=0.1,0.2", "method=tvl1_sb", FLAT).notices == ("`tau` does not affect the method",)
    assert plan("texture=0.5", "method=tvl1_sb", FLAT).notices == ("`texture` does not affect the method",)


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (["alhpa=1"], "unknown key 'alhpa': did you mean 'alpha'?"),
        (["params.alhpa=1"], "unknown key 'params.alhpa': did you mean"),
        (["paths.result=x"], "unknown key 'paths.result': did you mean 'paths.results'?"),
        (["region=grove_A"], "unknown region 'grove_A': did you mean 'grove2_A'?"),
        (["region=gorve*"], "no region matches 'gorve*'"),
        (["sequence=grove9"], "unknown sequence 'grove9': did you mean"),
        (["method=tvl1_sb_alfa"], "unknown method 'tvl1_sb_alfa': did you mean 'tvl1_sb_alpha'?"),
        (["zip(region,alpha)=(grove2_A,1),(grove2_C,2)"], "unknown region 'grove2_C'"),
        (["alpha=1", "alpha=2"], "the key 'alpha' is given twice"),
        (["alpha=1", "params.alpha=2"], "'alpha' and 'params.alpha' are the same key, given twice"),
        (["dataset=auto,synthetic"], "'dataset' takes one value"),
        (["paths.results=a,b"], "'paths.results' takes one value"),
        (["parallel.jobs=1,2"], "'parallel.jobs' takes one value"),
        (["alpha=1,3"], "`alpha` must be in [0, 2], got 3"),
        (["sequence=grove2", "region=all"], "belongs to sequence="),
    ],
)
def test_what_cannot_be_planned(tokens, message):
    assert message in refusal(*tokens)


# -- rendered scenes, margins, classes -----------------------------------------------------------


def test_noise_seed_and_score_are_part_of_a_key_only_where_they_are_not_usual():
    plain = plan(FLAT).points[0].point
    assert set(plain.spec) == {"method", "params", "dataset", "sequence", "box", "context"}
    assert key(FLAT, "noise=0", "seed=0", "score=frame", "margin=0") == key(FLAT)
    others = [key(FLAT, token) for token in ("noise=1.5", "seed=1", "score=structure", "margin=3")]
    assert len({key(FLAT), *others}) == 5
    identities = {planned.point.identity for planned in plan(FLAT, "seed=0:3:1", "noise=0,1.50").points}
    assert len(identities) == 8
    assert key(FLAT, "noise=1.50") == key(FLAT, "noise=1.5")


def test_a_rendered_scene_is_named_by_noise_and_seed():
    made = plan(FLAT, "noise=0,1.5", "seed=7")
    assert labels(made, "noise") == ["0", "1.5"]
    assert labels(made, "seed") == ["7", "7"]
    digests = [planned.point.data_digest for planned in made.points]
    assert digests == [synthetic.digest("flat", noise=noise, seed=7) for noise in (0.0, 1.5)]
    assert "noise" not in plan(FLAT).points[0].labels


def test_a_margin_takes_part_and_is_not_scored():
    point = plan(FLAT, "margin=20").points[0].point
    assert (box(point), point.context) == ((20, 108, 20, 140), 20)


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (["sequence=grove2", "noise=1"], "noise=1 needs a rendered scene, sequence=grove2 is none"),
        (["sequence=grove2", "seed=0"], "seed=0 needs a rendered scene"),
        (["region=grove2_A", "margin=4"], "margin=4 is of whole frames; a region takes context"),
        ([FLAT, "margin=64"], "margin=64 leaves nothing of a side of 128 pixels"),
        ([FLAT, "margin=-1"], "margin must be finite and at least 0, got -1"),
        ([FLAT, "noise=-1"], "noise must be finite and at least 0, got -1"),
        ([FLAT, "noise=much"], "`noise` must be a number, got 'much'"),
        ([FLAT, "seed=0.5"], "`seed` must be a whole number, got '0.5'"),
        ([FLAT, "score=structur"], "unknown score 'structur': did you mean 'structure'?"),
    ],
)
def test_what_frames_and_scenes_cannot_have(tokens, message):
    assert message in refusal(*tokens)
