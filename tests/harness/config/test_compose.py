"""The configuration: every file composes, later groups win, and unknown names are refused."""

from __future__ import annotations

import itertools
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from fracbench.data.datasets.middlebury import SEQUENCES, SIZES
from fracbench.data.datasets.synthetic.scenes import SCENES
from fracbench.errors import InputError
from fracbench.harness.config import compose
from fracbench.harness.config.compose import GROUPS, RunConfig, group_options, known_keys, load_config
from fracbench.harness.config.paths import asset
from fracbench.methods.registry import METHODS
from fracbench.model.params import FlowParams

PAPERS_METHODS = {"tvl1", "tvl1_sb", "tvl1_sb_alpha"}
PROTOCOLS = {"accurate", "as_printed", "explained", "fluid", "published", "recommended", "reference"}

#: Table 2 of the paper, by hand: lambda, theta, number of scales.
TABLE_2 = {
    "grove2": (0.3, 0.3, 6),
    "rubberwhale": (0.4, 0.4, 4),
    "grove3": (0.5, 0.4, 4),
    "hydrangea": (0.1, 0.8, 4),
    "urban2": (0.5, 0.3, 6),
    "dimetrodon": (0.3, 0.3, 5),
    "urban3": (0.9, 0.7, 5),
    "venus": (0.4, 0.6, 4),
}
#: The captions of Figures 6 and 7: lambda_SB of the best curve.
CAPTIONS = {
    "grove2_A": 5.0,
    "grove2_B": 7.0,
    "urban3_A": 1.0,
    "hydrangea_A": 3.0,
    "hydrangea_B": 10.0,
    "rubberwhale_A": 2.0,
}

#: Methods that need no optional package.
METHODS_HERE = [name for name in group_options("method") if all(map(find_spec, METHODS[name].requires))]
_REGION = "defaults: [{override /sequence: grove2}]\n"


@pytest.fixture
def own_conf(tmp_path, monkeypatch) -> Path:
    """A copy of ``conf`` that a test may change."""
    root = tmp_path / "project"
    shutil.copytree(asset("conf"), root / "conf")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compose, "asset", lambda relative: root / relative)
    compose._compose.cache_clear()
    yield root / "conf"
    compose._compose.cache_clear()


def refusal(choices=(), **values) -> str:
    with pytest.raises(InputError) as caught:
        load_config(dict(choices)).override(values)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


# -- every file ----------------------------------------------------------------------------------


def test_the_groups_hold_what_the_project_promises():
    assert set(group_options("method")) >= PAPERS_METHODS
    assert set(group_options("method")) <= set(METHODS)
    assert set(group_options("protocol")) >= PROTOCOLS
    assert set(group_options("region")) >= set(CAPTIONS)
    expected = {name.lower() for name in SEQUENCES} | {f"synthetic_{name}" for name in SCENES}
    assert set(group_options("sequence")) >= expected


@pytest.mark.parametrize(("method", "protocol"), [*itertools.product(METHODS_HERE, group_options("protocol"))])
def test_every_method_composes_with_every_protocol(method, protocol):
    composed = load_config({"method": method, "protocol": protocol})
    assert isinstance(composed, RunConfig)
    assert (composed.method.name, composed.protocol) == (method, protocol)


@pytest.mark.parametrize("sequence", group_options("sequence"))
def test_every_sequence_composes(sequence):
    composed = load_config({"sequence": sequence})
    assert composed.sequence.key == sequence
    assert composed.region is None
    if sequence.startswith("synthetic_"):
        assert composed.sequence.dataset == "synthetic"
        assert composed.sequence.name == sequence.removeprefix("synthetic_")
    else:
        assert composed.sequence.dataset == "middlebury"
        assert composed.sequence.name in SEQUENCES
        assert composed.sequence.name.lower() == sequence


@pytest.mark.parametrize("region", group_options("region"))
def test_every_region_composes_and_lies_inside_its_picture(region):
    composed = load_config({"region": region})
    assert composed.region.name == region
    assert region.startswith(composed.region.sequence)
    assert composed.region.sequence == composed.sequence.key
    height, width = SIZES[composed.sequence.name]
    assert 0 <= composed.region.rows[0] < composed.region.rows[1] <= height
    assert 0 <= composed.region.cols[0] < composed.region.cols[1] <= width


def test_every_parallel_choice_composes():
    for name in group_options("parallel"):
        assert load_config({"parallel": name}).parallel.jobs >= 1


def test_each_sequence_has_a_stand_in_of_its_own():
    stand_ins = [load_config({"sequence": name.lower()}).sequence.stand_in for name in SEQUENCES]
    assert sorted(stand_ins) == sorted(SCENES)


# -- the paper's parameters ----------------------------------------------------------------------


@pytest.mark.parametrize("sequence", TABLE_2)
def test_the_parameters_are_those_of_table_2(sequence):
    params = load_config({"sequence": sequence}).params
    assert (params.lambda_, params.theta, params.n_scales) == TABLE_2[sequence]


@pytest.mark.parametrize("region", CAPTIONS)
def test_a_region_has_its_captions_penalty_and_its_sequences_lambda_and_theta(region):
    params = load_config({"region": region}).params
    lambda_, theta, n_scales = TABLE_2[region.partition("_")[0]]
    assert (params.lambda_, params.theta, params.lambda_sb) == (lambda_, theta, CAPTIONS[region])
    # Section 4.2 gives Grove2's regions another number of scales than Table 2 gives the whole frame.
    assert params.n_scales == (5 if region.startswith("grove2") else n_scales)


def test_the_recommended_protocol_is_the_default_of_the_python_interface():
    composed = load_config({"protocol": "recommended", "sequence": "grove2"}).params
    own = FlowParams().as_dict()
    of_the_sequence = {"lambda", "theta", "n_scales", "lambda_sb"}
    assert {name for name, value in composed.as_dict().items() if value != own[name]} <= of_the_sequence


def test_the_paper_is_run_with_its_own_boundary():
    for protocol in ("reference", "published", "as_printed"):
        assert load_config({"protocol": protocol}).params.boundary == "zero"


# -- who wins ------------------------------------------------------------------------------------


def test_later_groups_win_and_the_command_line_wins_over_all(own_conf):
    choices = {"method": "tvl1_sb", "region": "grove2_A", "protocol": "reference"}
    (own_conf / "sequence/grove2.yaml").write_text(
        "# @package _global_\nsequence: {name: Grove2, dataset: middlebury, stand_in: parallax}\n"
        "params: {tol: 1, max_inner: 1, n_warps: 1, max_iter: 1}\n"
    )
    (own_conf / "region/grove2_A.yaml").write_text(
        "# @package _global_\ndefaults: [{override /sequence: grove2}]\n"
        "region: {name: grove2_A, sequence: grove2, rows: [0, 9], cols: [0, 9]}\n"
        "params: {max_inner: 2, n_warps: 2, max_iter: 2}\n"
    )
    (own_conf / "protocol/reference.yaml").write_text(
        "# @package _global_\nprotocol: reference\nparams: {n_warps: 3, max_iter: 3}\n"
    )
    params = load_config(choices).override({"max_iter": "4"}).params
    assert (params.u_solver, params.inner) == ("gauss_seidel", "cold")  # the method's own
    assert (params.tol, params.max_inner, params.n_warps, params.max_iter) == (1.0, 2, 3, 4)


def test_a_protocol_may_bring_its_method_and_one_asked_for_by_name_wins():
    assert load_config({"protocol": "accurate"}).method.name == "tvl1_sb_alpha_ic"
    asked = load_config({"protocol": "accurate", "method": "tvl1"})
    assert (asked.method.name, asked.params.eta) == ("tvl1", 0.8)


def test_the_accurate_protocol_is_the_same_for_every_sequence():
    sequences = [name for name in group_options("sequence") if not name.startswith("synthetic")]
    params = [load_config({"protocol": "accurate", "sequence": name}).params for name in sequences]
    assert len(params) == 8 and all(one == params[0] for one in params)


def test_a_parameter_that_no_group_sets_keeps_its_default():
    assert load_config({"sequence": "synthetic_flat"}).params.tau == FlowParams().tau


def test_overrides_reach_parameters_and_settings():
    given = load_config({"region": "urban3_A"})
    values = {
        "params.alpha": "0.7",
        "lambda": "0.25",
        "n_scales": "auto",
        "context": "16",
        "shift": "24",
        "dataset": "synthetic",
        "paths.data": "somewhere",
        "paths.results": "out",
        "parallel.jobs": "3",
    }
    changed = given.override(values)
    assert (changed.params.alpha, changed.params.lambda_, changed.params.n_scales) == (0.7, 0.25, None)
    assert (changed.context, changed.shift, changed.dataset) == (16, 24, "synthetic")
    assert (changed.data, changed.results, changed.parallel.jobs) == ("somewhere", Path("out"), 3)
    assert changed.override({"shift": "null"}).shift is None
    assert (given.params.lambda_, given.context, given.shift, given.parallel.jobs) == (0.9, 0, None, 2)


def test_the_defaults_of_the_configuration():
    composed = load_config({})
    assert (composed.method.name, composed.protocol) == ("tvl1_sb_alpha", "reference")
    assert (composed.dataset, composed.context, composed.shift, composed.data) == ("auto", 0, None, None)
    assert composed.results == Path("results")
    assert composed.sequence.key == "rubberwhale"
    assert composed.parallel.jobs == 2


def test_no_region_may_be_said_aloud():
    assert load_config({"region": "none", "sequence": "venus"}).region is None
    assert load_config({"region": "none", "sequence": "venus"}).sequence.key == "venus"


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("group", "name", "meant"),
    [
        ("method", "tvl1_bs", "tvl1_sb"),
        ("sequence", "grve2", "grove2"),
        ("sequence", "Grove2", "grove2"),
        ("region", "grove2_a", "grove2_A"),
        ("protocol", "as_print", "as_printed"),
        ("parallel", "locl", "local"),
    ],
)
def test_an_unknown_name_offers_the_nearest(group, name, meant):
    message = refusal({group: name})
    assert f"unknown {group} {name!r}: did you mean {meant!r}?" in message
    assert ", ".join(sorted(group_options(group))) in message


def test_an_unknown_parameter_offers_the_nearest():
    assert "unknown parameter 'lamda': did you mean 'lambda'?" in refusal(lamda="1")


def test_a_region_of_another_sequence_is_refused():
    message = refusal({"region": "grove2_A", "sequence": "urban3"})
    assert "region=grove2_A belongs to sequence=grove2, not to urban3" in message
    assert load_config({"region": "grove2_A", "sequence": "grove2"}).region.name == "grove2_A"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("parallel.jobs", "0", "parallel.jobs must be at least 1, got 0"),
        ("parallel.jobs", "two", "`parallel.jobs` must be a whole number, got 'two'"),
        ("parallel.timeout", "0", "parallel.timeout must be a number of seconds above 0, got 0"),
        ("parallel.timeout", "nan", "parallel.timeout must be a number of seconds above 0, got nan"),
        ("parallel.timeout", "soon", "`parallel.timeout` must be a number of seconds, got 'soon'"),
        ("parallel.address", "head", "parallel.address must be like tcp://HOST:8786, got 'head'"),
        ("parallel.address", "tcp://head:8786", "parallel.address=tcp://head:8786 needs parallel=dask"),
        ("context", "-1", "context must be at least 0 pixels, got -1"),
        ("context", "1.5", "`context` must be a whole number, got '1.5'"),
        ("context", "null", "`context` must be a whole number, got 'null'"),
        ("shift", "-1", "shift must be in 0..24, got -1"),
        ("shift", "25", "shift must be in 0..24, got 25"),
        ("shift", "x", "`shift` must be a whole number, got 'x'"),
        ("dataset", "middleburry", "unknown dataset 'middleburry': did you mean 'middlebury'?"),
    ],
)
def test_settings_out_of_range_are_refused(key, value, message):
    assert message in refusal({"region": "grove2_A"}, **{key: value})


@pytest.mark.parametrize(("key", "value"), [("context", "8"), ("shift", "0")])
def test_settings_of_a_region_are_refused_without_one(key, value):
    assert f"{key}={value} needs a region" in refusal({}, **{key: value})


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        (
            "protocol/own.yaml",
            "protocol: own\nparams: {n_warp: 3}",
            "params: unknown parameter 'n_warp': did you mean 'n_warps'?",
        ),
        (
            "protocol/own.yaml",
            "protocol: own\nparams: {n_warps: 1.5}",
            "`n_warps` must be a whole number, got 1.5",
        ),
        ("protocol/own.yaml", "protocl: own", "unknown key 'protocl': did you mean 'protocol'?"),
        (
            "protocol/own.yaml",
            "protocol: own\npaths: {reslts: x}",
            "paths: unknown key 'reslts': did you mean 'results'?",
        ),
        ("protocol/own.yaml", "shift: [", "protocol/own.yaml: cannot be read as YAML"),
        (
            "region/own.yaml",
            _REGION + "region: {name: own, sequence: grove2, rows: [0, 9], colls: [0, 9]}",
            "region: unknown key 'colls': did you mean 'cols'?",
        ),
        ("region/own.yaml", _REGION + "region: {name: own, sequence: grove2, rows: [0, 9]}", "region: "),
        (
            "region/own.yaml",
            _REGION + "region: {name: own, sequence: grove2, rows: [0, 9], cols: [9, 9]}",
            "`cols` 9:9 must start at 0",
        ),
        (
            "sequence/own.yaml",
            "sequence: {name: Grove2, dataset: middlebury, standin: edge}",
            "sequence: unknown key 'standin': did you mean 'stand_in'?",
        ),
        ("sequence/own.yaml", "sequence: {name: Grove2}", "sequence: "),
        ("protocol/own.yaml", "protocol: own\nmethod: tvl2", "unknown method 'tvl2': did you mean 'tvl1'?"),
        (
            "parallel/own.yaml",
            "parallel: {jobs: 2, backend: lokey}",
            "unknown parallel backend 'lokey': did you mean 'loky'?",
        ),
        ("parallel/own.yaml", "parallel: {job: 2}", "parallel: unknown key 'job': did you mean 'jobs'?"),
    ],
)
def test_mistakes_in_a_file_are_one_line_that_names_them(own_conf, file, text, message):
    (own_conf / file).write_text(f"# @package _global_\n{text}\n")
    group, _, name = file.removesuffix(".yaml").partition("/")
    assert message in refusal({group: name})


def test_every_key_of_an_override_is_known():
    keys = known_keys()
    assert set(GROUPS) | set(FlowParams.names()) | {"context", "shift", "dataset", "parallel.jobs"} <= set(keys)
    assert len(keys) == len(set(keys))
