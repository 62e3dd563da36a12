"""The override grammar: every form, every refusal, and properties of any grid."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fracbench.errors import InputError
from fracbench.harness.config.grid import Axis, Grid, expand_names, parse_overrides
from fracbench.harness.config.numbers import MAX_POINTS, canonical_number

lawful = settings(deadline=None, derandomize=True)


def values(text: str) -> list[str]:
    """The values that ``key=text`` stands for."""
    (axis,) = parse_overrides([f"key={text}"]).axes
    return [value for (value,) in axis.values]


def refusal(*tokens: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_overrides(tokens)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


# --- one key ------------------------------------------------------------------------------------------


def test_the_documented_example_has_exactly_21_values() -> None:
    tenths = [f"{k // 10}.{k % 10}" if k % 10 else str(k // 10) for k in range(21)]
    assert values("0:2:0.1") == tenths
    assert tenths[:4] == ["0", "0.1", "0.2", "0.3"]
    assert tenths[-1] == "2"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1.20", ["1.2"]),
        ("-0", ["0"]),
        ("zero", ["zero"]),
        ("True", ["True"]),
        ("grove2_*", ["grove2_*"]),
        ("all", ["all"]),
        ("tcp://localhost:8786", ["tcp://localhost:8786"]),
        (r"C:\flow\10", [r"C:\flow\10"]),
        ("a=b", ["a=b"]),
        ("'10:20, (b)'", ["10:20, (b)"]),
        ('"it\'s"', ["it's"]),
        ("'1.0',1", ["1"]),
        ("0:1:0.3", ["0", "0.3", "0.6", "0.9"]),
        ("2:1:-0.5", ["2", "1.5", "1"]),
        ("-1:1:1", ["-1", "0", "1"]),
        ("3:3:1", ["3"]),
        ("0:2e-3:1e-3", ["0", "0.001", "0.002"]),
        (" 0 : 1 : .5 ", ["0", "0.5", "1"]),
        ("1,2,5", ["1", "2", "5"]),
        ("1, 1.0, 01, 2", ["1", "2"]),
        ("0:1:0.25,1.5,2", ["0", "0.25", "0.5", "0.75", "1", "1.5", "2"]),
        ("5,0:1:1", ["5", "0", "1"]),
        ("log(1e-3:1:7)", ["0.001", "0.00316228", "0.01", "0.0316228", "0.1", "0.316228", "1"]),
        ("log(100:1:3)", ["100", "10", "1"]),
        ("log(1.23456789:2:2)", ["1.23456789", "2"]),
        ("choice(a, b,c)", ["a", "b", "c"]),
        ("choice('(a)',2.0)", ["(a)", "2"]),
        ("range(0,2,step=0.5)", ["0", "0.5", "1", "1.5"]),
        ("range(start=0,stop=2,step=.5)", ["0", "0.5", "1", "1.5"]),
        ("range(0.3,0,-0.1)", ["0.3", "0.2", "0.1"]),
        ("range(0,0.3,0.1)", ["0", "0.1", "0.2"]),
        ("range(2),log(1:4:3)", ["0", "1", "2", "4"]),
    ],
)
def test_forms_of_a_value(text: str, expected: list[str]) -> None:
    assert values(text) == expected


@pytest.mark.parametrize("text", ["range(3)", "range(2,5)", "range(2,9,3)", "range(9,2,-3)", "choice(4,1)"])
def test_hydras_own_functions_mean_what_hydra_means(text: str) -> None:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    sweep = OverridesParser.create().parse_override(f"key={text}")
    assert values(text) == list(sweep.sweep_string_iterator())


def test_log_agrees_with_numpy() -> None:
    numpy = pytest.importorskip("numpy")
    expected = [float(f"{x:.5e}") for x in numpy.geomspace(2e-4, 70, 41)]
    assert [float(v) for v in values("log(2e-4:70:41)")] == expected


@pytest.mark.parametrize(
    ("token", "part"),
    [
        ("alpha", "KEY=VALUE"),
        ("alpha=", "nothing follows '='"),
        ("alpha= ", "nothing follows '='"),
        ("=1", "'' is not a key"),
        ("+alpha=1", "'+alpha' is not a key"),
        ("al pha=1", "'al pha' is not a key"),
        ("alpha=''", "a value is empty"),
        ("alpha=1,,2", "a value is empty"),
        ("alpha=1,", "a value is empty"),
        ("alpha=0:2", "a:b:step"),
        ("alpha=0:1:2:3", "a:b:step"),
        ("alpha=0::1", "'' is not a finite number"),
        ("alpha=O:2:0.1", "'O' is not a finite number"),
        ("alpha=2:0:0.1", "counts up but stop is below start; use 2:0:-0.1 or 0:2:0.1"),
        ("alpha=0:2:-.1", "counts down but stop is above start; use 0:2:0.1 or 2:0:-0.1"),
        ("alpha=range(2,0,1)", "use range(2,0,-1) or range(0,2,1)"),
        ("alpha=0:2:0", "the step is 0"),
        ("alpha=1:1:0", "the step is 0"),
        ("alpha=nan", "'nan' is not a finite number"),
        ("alpha=1,-Inf", "'-Inf' is not a finite number"),
        ("alpha='inf'", "'inf' is not a finite number"),
        ("alpha=1e400", "'1e400' is not a finite number"),
        ("alpha=0:nan:1", "'nan' is not a finite number"),
        ("alpha=range(2,2)", "empty"),
        ("alpha=range()", "a value is empty"),
        ("alpha=range(1,2,3,4)", "takes start, stop and step"),
        ("alpha=range(1,2,start=0)", "start twice"),
        ("alpha=range(stop=2)", "no start"),
        ("alpha=range(1,stp=2)", "did you mean 'stop'"),
        ("alpha=range(a,b)", "'a' is not a finite number"),
        ("alpha=rnge(3)", "did you mean 'range'"),
        ("alpha=log(1,10,3)", "log(a:b:n)"),
        ("alpha=log(0:1:3)", "must be positive"),
        ("alpha=log(1:1:3)", "differ"),
        ("alpha=log(1:2:1)", "whole number from 2, not 1"),
        ("alpha=log(1:2:2.5)", "whole number from 2, not 2.5"),
        ("alpha=log(1:1.000001:7)", "too close for 7 values"),
        ("alpha=choice(1,0:1:0.5)", "range '0:1:0.5' cannot stand"),
        ("alpha=choice(choice(1))", "written in quotes"),
        ("alpha=(1,2)", "written in quotes"),
        ("alpha=(1", "parentheses do not match"),
        ("alpha=1)", "parentheses do not match"),
        ("alpha=)1(", "parentheses do not match"),
        ("alpha=log(1:2:3", "parentheses do not match"),
        ("alpha='a", "quote is not closed"),
        ("alpha='a'b", "written in quotes"),
        ("alpha=[1,2]", "without brackets"),
        ("zip(a,b)=(1,2),(3)", "the tuple '(3)' has 1 value(s) for 2 key(s)"),
        ("zip(a)=(1,2)", "the tuple '(1,2)' has 2 value(s) for 1 key(s)"),
        ("zip(a,b)=1,2", "'1' is not a tuple"),
        ("zip(a,b)=(0:1:1,2)", "range '0:1:1' cannot stand"),
        ("zip(a,b)=(1,)", "a value is empty"),
        ("zip(a,)=(1,2)", "'' is not a key"),
        ("zip(a,a)=(1,2)", "'a' is given twice"),
        ("zop(a,b)=(1,2)", "did you mean 'zip'"),
    ],
)
def test_refusals_quote_the_token_and_say_what_is_wrong(token: str, part: str) -> None:
    message = refusal(token)
    assert message.startswith(f"{token!r}: ")
    assert part in message.removeprefix(repr(token))


def test_a_long_or_broken_token_still_makes_one_short_line() -> None:
    assert len(refusal("alpha=" + "(" * 10_000)) < 200
    refusal("al\npha=1")


# --- too many points ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("0:2:1e-9", "2000000001"),
        (f"1:{MAX_POINTS + 1}:1", str(MAX_POINTS + 1)),
        ("range(2000000)", "2000000"),
        ("log(1:2:2000000)", "2000000"),
        ("0:599999:1,0:599999:1", "1200000"),
        ("0:1e308:1e-300", "1.00e+608"),
    ],
)
def test_a_slip_of_the_step_is_refused_with_the_count(text: str, points: str) -> None:
    assert f"asks for {points} points, more than the {MAX_POINTS} allowed" in refusal(f"alpha={text}")


def test_the_limit_holds_for_the_product() -> None:
    assert "asks for 1001000 points" in refusal("alpha=1:1001:1", "theta=1:1000:1")
    assert parse_overrides(["alpha=1:1000:1", "theta=1:1000:1"]).size == MAX_POINTS


# --- several keys -------------------------------------------------------------------------------------


def test_product_with_the_first_key_slowest() -> None:
    grid = parse_overrides(["alpha=1,2", "theta=0.3", "region=a,b"])
    assert list(grid.points()) == [
        {"alpha": "1", "theta": "0.3", "region": "a"},
        {"alpha": "1", "theta": "0.3", "region": "b"},
        {"alpha": "2", "theta": "0.3", "region": "a"},
        {"alpha": "2", "theta": "0.3", "region": "b"},
    ]
    assert grid.fixed == {"theta": "0.3"}
    assert grid.varying == ("alpha", "region")


def test_zip_pairs_and_multiplies_with_the_rest() -> None:
    grid = parse_overrides(["zip(lambda, theta,eta)=(0.30,.3,0.5), (0.4,0.4,0.5),(0.3,0.3,.5)", "alpha=1,2"])
    assert grid.axes[0] == Axis(("lambda", "theta", "eta"), (("0.3", "0.3", "0.5"), ("0.4", "0.4", "0.5")))
    assert [tuple(p.values()) for p in grid.points()] == [
        ("0.3", "0.3", "0.5", "1"),
        ("0.3", "0.3", "0.5", "2"),
        ("0.4", "0.4", "0.5", "1"),
        ("0.4", "0.4", "0.5", "2"),
    ]
    assert grid.fixed == {"eta": "0.5"}
    assert grid.varying == ("lambda", "theta", "alpha")


def test_a_key_given_twice_is_refused() -> None:
    assert refusal("alpha=1", "alpha=2") == "'alpha=2': the key 'alpha' is given twice"
    assert "'theta' is given twice" in refusal("zip(alpha,theta)=(1,2)", "theta=1")


def test_no_overrides_are_one_point_without_keys() -> None:
    grid = parse_overrides([])
    assert grid == Grid()
    assert (grid.size, list(grid.points()), grid.fixed, grid.varying) == (1, [{}], {}, ())


# --- numbers and names --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1E+1", "10"),
        ("1e-3", "0.001"),
        ("-0.0", "0"),
        ("0e99", "0"),
        ("+1", "1"),
        ("1.", "1"),
        (".5", "0.5"),
        ("-.50", "-0.5"),
        ("007", "7"),
        ("100", "100"),
        (" 2.0 ", "2"),
        ("0.1234567890123456789012345678901234567890", "0.123456789012345678901234567890123456789"),
        ("1e308", "1" + "0" * 308),
        ("1e309", None),
        ("9e308", None),
        ("1e-400", None),
        ("1e99999999999999999999", None),
        ("1" * 401, None),
        ("0." + "1" * 401, None),
        ("nan", None),
        ("inf", None),
        ("1_000", None),
        ("٣", None),
        ("0x10", None),
        ("1,5", None),
        ("-", None),
        (".", None),
        ("", None),
    ],
)
def test_canonical_number(text: str, expected: str | None) -> None:
    assert canonical_number(text) == expected


@lawful
@given(st.decimals(allow_nan=False, allow_infinity=False, min_value=-(10**20), max_value=10**20, places=12))
def test_equal_numbers_have_one_spelling(number) -> None:
    spelling = canonical_number(str(number))
    assert spelling is not None
    assert Fraction(spelling) == Fraction(number)
    assert "e" not in spelling.lower()
    assert {canonical_number(f"{number:e}"), canonical_number(f"{number:f}0")} == {spelling}


REGIONS = ["grove2_A", "grove2_B", "urban3_A", "hydrangea_A"]


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (["urban3_A"], ["urban3_A"]),
        (["all"], REGIONS),
        (["grove2_*"], ["grove2_A", "grove2_B"]),
        (["*_A"], ["grove2_A", "urban3_A", "hydrangea_A"]),
        (["grove?_[!A]"], ["grove2_B"]),
        (["urban3_A", "all"], ["urban3_A", "grove2_A", "grove2_B", "hydrangea_A"]),
    ],
)
def test_expand_names(patterns: list[str], expected: list[str]) -> None:
    assert expand_names(patterns, REGIONS, "region") == expected


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("grove2_a", "unknown region 'grove2_a': did you mean 'grove2_A'?"),
        ("venus_*", "no region matches 'venus_*' (allowed: grove2_A, grove2_B, urban3_A, hydrangea_A)"),
        ("GROVE2_*", "no region matches 'GROVE2_*'"),
    ],
)
def test_expand_names_refuses_what_is_not_there(pattern: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        expand_names(["all", pattern], REGIONS, "region")
    assert message in str(caught.value)


# --- laws ---------------------------------------------------------------------------------------------

ends = st.decimals(min_value=-50, max_value=50, places=3)
steps = st.decimals(min_value="0.1", max_value=20, places=2)


@lawful
@given(ends, ends, steps)
def test_a_range_starts_at_start_keeps_its_step_and_ends_within_one_step_of_stop(start, stop, step) -> None:
    signed = step if stop >= start else -step
    got = [Fraction(v) for v in values(f"{start}:{stop}:{signed}")]
    assert got == [Fraction(start) + k * Fraction(signed) for k in range(len(got))]
    left_over = abs(Fraction(stop) - got[-1])
    assert 0 <= left_over < step
    assert (got[-1] == stop) == ((Fraction(stop) - Fraction(start)) % Fraction(step) == 0)


@lawful
@given(ends, steps, st.integers(1, 50))
def test_both_ends_are_in_when_the_step_divides_the_range(start, step, count) -> None:
    stop = Fraction(start) + count * Fraction(step)
    text = canonical_number(f"{float(stop):.5f}")
    got = values(f"{start}:{text}:{step}")
    assert (got[0], got[-1], len(got)) == (canonical_number(str(start)), text, count + 1)
    exclusive = values(f"range({start},{text},{step})")
    assert exclusive == got[:-1]


axes = st.lists(st.lists(st.integers(-9, 9), min_size=1, max_size=5), max_size=4)


@lawful
@given(axes)
def test_size_and_order_are_those_of_the_product(lists: list[list[int]]) -> None:
    grid = parse_overrides([f"k{i}={','.join(map(str, vs))}" for i, vs in enumerate(lists)])
    distinct = [[str(v) for v in dict.fromkeys(vs)] for vs in lists]
    points = list(grid.points())
    assert [tuple(point.values()) for point in points] == list(itertools.product(*distinct))
    assert grid.size == len(points) == math.prod(map(len, distinct))
    assert {*grid.fixed} | {*grid.varying} == {f"k{i}" for i in range(len(lists))}
    assert [key for key in grid.varying if len({point[key] for point in points}) == 1] == []


tokens = st.lists(
    st.text() | st.text("az=:,()'\"[]0129.eE+- ") | st.text("0123456789.:,-e()").map("a={}".format),
    max_size=3,
)


@lawful
@given(tokens)
def test_anything_either_parses_or_is_refused_in_one_line(given_tokens: list[str]) -> None:
    try:
        grid = parse_overrides(given_tokens)
    except InputError as exc:
        assert len(str(exc).splitlines()) == 1
    else:
        assert 1 <= grid.size <= MAX_POINTS
        assert all(value.strip() for value in next(grid.points()).values())


def test_reading_overrides_imports_neither_numpy_nor_hydra() -> None:
    code = "import sys, fracbench.harness.config.grid; sys.exit(bool({'numpy', 'hydra'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- thinned ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("token", "kept"),
    [
        ("alpha=0:2:0.1", ["0", "1", "2"]),
        ("lambda_sb=1:10:1", ["1", "5", "10"]),
        ("shift=0:24:1", ["0", "12", "24"]),
        ("theta=0.05,0.1:1:0.1", ["0.05", "0.5", "1"]),
        ("alpha=0,1,2", ["0", "1", "2"]),
        ("alpha=0,2", ["0", "2"]),
        ("region=a,b,c", ["a", "b"]),
        ("sequence=a,b,c,d", ["a", "b"]),
        ("protocol=reference,published,as_printed,recommended", None),
        ("n_scales=auto,3,4,5", None),
    ],
)
def test_a_thinned_axis_keeps_its_ends_and_its_middle(token: str, kept: list[str] | None) -> None:
    (axis,) = parse_overrides([token]).thinned().axes
    whole = parse_overrides([token]).axes[0]
    assert axis == (whole if kept is None else Axis(whole.keys, tuple((value,) for value in kept)))


def test_a_thinned_grid_has_the_same_axes_and_zipped_keys_stay_together() -> None:
    grid = parse_overrides(["alpha=0:2:0.5", "zip(lambda,theta)=(1,5),(2,6),(3,7),(4,8),(5,9)", "method=tvl1"])
    thin = grid.thinned()
    assert [axis.keys for axis in thin.axes] == [axis.keys for axis in grid.axes]
    assert thin.axes[1].values == (("1", "5"), ("3", "7"), ("5", "9"))
    assert thin.size == 9


@lawful
@given(st.integers(1, 40), st.integers(2, 6))
def test_thinning_keeps_at_most_n_distinct_values_in_order_with_both_ends(length: int, n: int) -> None:
    values = tuple((str(k),) for k in range(length))
    (axis,) = Grid((Axis(("alpha",), values),)).thinned(n).axes
    kept = [int(value) for (value,) in axis.values]
    assert len(kept) == min(n, length) and kept == sorted(set(kept))
    assert (kept[0], kept[-1]) == (0, length - 1)
    gaps = {b - a for a, b in itertools.pairwise(kept)}
    assert not gaps or max(gaps) - min(gaps) <= 1
