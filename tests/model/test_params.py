from __future__ import annotations

import dataclasses
import math

import pytest

from fracbench.errors import InputError
from fracbench.model.params import FlowParams, public_name


def refused(message, **values):
    with pytest.raises(InputError, match=message) as caught:
        FlowParams().replace(values)
    assert "\n" not in str(caught.value)


# -- types ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("alpha", "1.2", 1.2),
        ("alpha", 1, 1.0),
        ("theta", "3e-1", 0.3),
        ("n_warps", "7", 7),
        ("n_warps", 7.0, 7),
        ("n_warps", "7.0", 7),
        ("n_scales", "auto", None),
        ("n_scales", "None", None),
        ("n_scales", None, None),
        ("n_scales", "4", 4),
        ("upsample_gain", "null", None),
        ("upsample_gain", "0.5", 0.5),
        ("relinearise", "false", False),
        ("relinearise", "True", True),
        ("dual_restart", True, True),
        ("boundary", "zero", "zero"),
        ("dtype", "float64", "float64"),
    ],
)
def test_values_are_converted_to_their_type(name, value, expected):
    result = getattr(FlowParams().replace({name: value}), name)
    assert result == expected
    assert type(result) is type(expected)


def test_the_constructor_converts_and_checks_too():
    assert FlowParams(alpha="1.5").alpha == 1.5
    with pytest.raises(InputError, match=r"`theta` must be greater than 0, got -1"):
        FlowParams(theta=-1)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("alpha", "abc", r"`alpha` must be a number, got 'abc'"),
        ("alpha", True, r"`alpha` must be a number, got True"),
        ("alpha", None, r"`alpha` must be a number, got None"),
        ("alpha", math.nan, r"`alpha` must be a number, got nan"),
        ("lambda", math.inf, r"`lambda` must be a number, got inf"),
        ("n_warps", 2.5, r"`n_warps` must be a whole number, got 2.5"),
        ("n_warps", "two", r"`n_warps` must be a whole number, got 'two'"),
        ("n_scales", "many", r"`n_scales` must be a whole number, got 'many'"),
        ("max_iter", math.inf, r"`max_iter` must be a whole number, got inf"),
        ("relinearise", "yes", r"`relinearise` must be true or false, got 'yes'"),
        ("relinearise", 1, r"`relinearise` must be true or false, got 1"),
        ("tau", [0.1], r"`tau` must be a number, got \[0.1\]"),
    ],
)
def test_wrong_types_are_refused(name, value, message):
    refused(message, **{name: value})


# -- ranges --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("alpha", 4.5, r"`alpha` must be in \[0, 4\], got 4.5"),
        ("alpha", -0.1, r"`alpha` must be in \[0, 4\], got -0.1"),
        ("lambda", 0, r"`lambda` must be greater than 0, got 0"),
        ("theta", 0.0, r"`theta` must be greater than 0, got 0"),
        ("lambda_sb", -5, r"`lambda_sb` must be greater than 0, got -5"),
        ("epsilon", -1e-3, r"`epsilon` must be at least 0, got -0.001"),
        ("eta", 1.0, r"`eta` must be in \[0.1, 0.95\], got 1"),
        ("eta", 0.05, r"`eta` must be in \[0.1, 0.95\], got 0.05"),
        ("n_scales", 0, r"`n_scales` must be at least 1, got 0"),
        ("n_warps", 0, r"`n_warps` must be at least 1, got 0"),
        ("max_iter", "0", r"`max_iter` must be at least 1, got 0"),
        ("tau", 0.0, r"`tau` must be in \(0, 0.25\], got 0"),
        ("tau", 0.3, r"`tau` must be in \(0, 0.25\], got 0.3"),
        ("coupling_step", 0, r"`coupling_step` must be greater than 0, got 0"),
        ("relaxation", 2, r"`relaxation` must be in \[1, 1.9\], got 2"),
        ("pad", -1, r"`pad` must be in \[0, 1000\], got -1"),
        ("pad", 10**9, r"`pad` must be in \[0, 1000\], got 1e\+09"),
        ("presmoothing", -1, r"`presmoothing` must be in \[0, 100\], got -1"),
        ("presmoothing", 1e9, r"`presmoothing` must be in \[0, 100\], got 1e\+09"),
        ("upsample_gain", 1e300, r"`upsample_gain` must be in \[0, 10\], got 1e\+300"),
    ],
)
def test_values_outside_their_range_are_refused(name, value, message):
    refused(message, **{name: value})


@pytest.mark.parametrize(
    ("name", "values"),
    [("alpha", (0, 4)), ("tau", (1e-9, 0.25)), ("eta", (0.1, 0.95)), ("epsilon", (0,)), ("pad", (0, 99))],
)
def test_bounds_are_allowed_where_the_message_says_so(name, values):
    for value in values:
        assert getattr(FlowParams().replace({name: value}), name) == value


# -- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("lamda", "lambda"),
        ("lambdasb", "lambda_sb"),
        ("Alpha", "alpha"),
        ("nwarps", "n_warps"),
        ("maxiter", "max_iter"),
    ],
)
def test_unknown_names_offer_the_nearest(name, nearest):
    refused(f"unknown parameter '{name}': did you mean '{nearest}'?", **{name: 1})


def test_the_place_is_named():
    with pytest.raises(InputError, match=r"^conf/method/x\.yaml: unknown parameter 'alhpa'"):
        FlowParams().replace({"alhpa": 1}, where="conf/method/x.yaml")


@pytest.mark.parametrize(
    ("name", "value", "nearest"),
    [("boundary", "relfect", "reflect"), ("u_solver", "gauss-seidel", "gauss_seidel"), ("inner", "Warm", "warm")],
)
def test_unknown_words_offer_the_nearest(name, value, nearest):
    refused(f"unknown value of `{name}` '{value}': did you mean '{nearest}'?", **{name: value})


def test_words_without_a_neighbour_list_what_is_allowed():
    refused(r"unknown value of `dtype` '7' \(allowed: float32, float64\)", dtype=7)


def test_lambda_has_two_spellings():
    params = FlowParams().replace({"lambda": 0.7})
    assert params == FlowParams().replace({"lambda_": 0.7}) == FlowParams(lambda_=0.7)
    assert params.as_dict()["lambda"] == 0.7
    assert "lambda_" not in params.as_dict()
    assert public_name("lambda_") == "lambda"
    assert FlowParams.info("lambda") is FlowParams.info("lambda_")


def test_as_dict_and_replace_are_inverse():
    params = FlowParams(alpha=0.3, n_scales=4, boundary="zero", relinearise=False)
    assert FlowParams().replace(params.as_dict()) == params
    assert tuple(params.as_dict()) == FlowParams.names()


# -- the record ----------------------------------------------------------------------------------


def test_parameters_are_frozen_and_hashable():
    params = FlowParams()
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.alpha = 1.0
    assert len({params, FlowParams(), FlowParams(alpha=0.2)}) == 2


def test_replace_leaves_the_original():
    params = FlowParams()
    params.replace({"alpha": 0.5})
    assert params.alpha == FlowParams().alpha != 0.5


@pytest.mark.parametrize("name", FlowParams.names())
def test_every_parameter_is_described_and_its_default_valid(name):
    info = FlowParams.info(name)
    assert info.text and "\n" not in info.text
    default = FlowParams().as_dict()[name]
    assert FlowParams().replace({name: default}) == FlowParams()
    if isinstance(default, float):
        assert info.low <= default <= info.high
