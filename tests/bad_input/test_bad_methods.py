"""Packages whose method cannot be used: one line that names entry point and package; all else goes on working."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from outside_package import SOURCE, forget, write_package

from fracbench import FlowParams, Method, estimate_flow
from fracbench.commands.cli import EXIT_DONE
from fracbench.data.files import read_flow
from fracbench.errors import InputError
from fracbench.methods.method import RESERVED
from fracbench.methods.registry import get_method
from fracbench.studies.race import measure

ENTRY = "entry point 'my_flow' of my-package 1.0: "
ESTIMATE = ["estimate", "a.png", "b.png", "-o", "out.flo", "--method", "my_flow"]
SWEEP = ["sweep", "method=my_flow", "sequence=synthetic_flat"]


def method(
    more: str = "", body: str = "return np.zeros((2, *frame0.shape))", fields: str = "strength: float = 1.0"
):
    """The module of a package with other parameters, another function, or further arguments of `Method`."""
    return (
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "from typing import Literal, Optional\n"
        "import numpy as np\nfrom fracbench import FlowResult, FlowParams, Method\n"
        f"@dataclass(frozen=True)\nclass Params:\n    {fields}\n"
        f"def estimate(frame0, frame1, params):\n    {body}\n"
        "METHOD = Method(**{**dict(name='my_flow', label='My flow', summary='one motion', estimate=estimate, "
        f"params=Params, version='1'), **dict({more})}})\n"
    )


@pytest.fixture
def package(images, monkeypatch):
    """A function that writes a package and makes it one that is installed; the working folder holds two frames."""
    site = images.parent / f"{images.name}_site"

    def write(source=SOURCE, **more):
        write_package(site, source, **more)
        monkeypatch.syspath_prepend(str(site))
        forget()

    yield write
    monkeypatch.undo()
    forget()


#: The module, and the end of the line after the entry point.
MODULES = [
    ("import nothing_of_the_kind", "cannot be loaded: ModuleNotFoundError: No module named 'nothing_of_the_kind'"),
    ("raise RuntimeError('two\\nlines')", "cannot be loaded: RuntimeError: two lines (my_package.py:1)"),
    ("raise SystemExit(0)", "cannot be loaded: SystemExit: 0"),
    ("METHOD =", "cannot be loaded: SyntaxError: invalid syntax"),
    ("method = 1", "cannot be loaded: AttributeError: module 'my_package' has no attribute 'METHOD'"),
    ("METHOD = 1", "my_package:METHOD is of type int, not a fracbench.Method"),
    ("def METHOD(frame0, frame1): ...", "my_package:METHOD is of type function, not a fracbench.Method"),
    (method("name='other'"), "the method is called 'other'; give the entry point the same name"),
    (method("name='my flow'"), "InputError: a method's name must be letters, digits and _, got 'my flow'"),
    (method("name='../my_flow'"), "a method's name must be letters, digits and _, got '../my_flow'"),
    (method("estimate=3"), "method 'my_flow': `estimate` must be a function, got 3"),
    (method("version=1"), "method 'my_flow': `version` must be one line of text, got 1"),
    (method("label=''"), "method 'my_flow': `label` must be one line of text, got ''"),
    (method("summary='a\\nb'"), "method 'my_flow': `summary` must be one line of text, got 'a\\nb'"),
    (method("params=dict"), "method 'my_flow': `params` must be FlowParams or a frozen dataclass of its own"),
    (
        method("params=type('P', (FlowParams,), {})"),
        "`params` must be FlowParams or a frozen dataclass of its own",
    ),
    (method("defaults={'strenth': 1}"), "unknown parameter 'strenth': did you mean 'strength'?"),
    (method("uses={'strenth'}"), "unknown parameter 'strenth': did you mean 'strength'?"),
    (method("limits={'strength': (2.0, 'no more')}"), "`limits` are for the methods with FlowParams"),
    (method("colour=1"), "TypeError: Method.__init__() got an unexpected keyword argument 'colour'"),
    (method().replace("(frozen=True)", ""), "must be a frozen dataclass: write @dataclass(frozen=True)"),
    (method(fields="strength: float = 'much'"), "the defaults are refused: `strength` must be a number"),
    (method(fields="strength: float"), "`params`: 'strength' needs a default value"),
    (method(fields="weights: list[float] = ()"), "'weights' must be bool, int, float, str or Literal"),
    (method(fields="size: int | str = 3"), "'size' must be bool, int, float, str or Literal"),
    (method(fields="size: Nonsense = 3"), "its annotations cannot be read: name 'Nonsense' is not defined"),
    (method(fields="iterations: int = 3"), "the name 'iterations' is taken by a key or a column; choose another"),
    (
        method(fields="size: int = 3\n    def __post_init__(self): raise ValueError('no')"),
        "the defaults are refused: no",
    ),
]


@pytest.mark.parametrize(("source", "named"), MODULES)
def test_modules_that_hold_no_method(package, refused, images, cli, source, named):
    package(source)
    for argv in (ESTIMATE, [*SWEEP, "--dry-run"]):
        refused(images, argv, ENTRY, named)
    listed = cli("methods")
    assert listed.code == EXIT_DONE and listed.err == ""
    assert [line for line in listed.out.splitlines() if line.startswith(f"cannot be used: {ENTRY}")]
    assert cli("sweep", "method=tvl1", "sequence=synthetic_flat", "--dry-run").err == ""  # nobody asked for it


#: The body of ``estimate``, and the end of the line.
BODIES = [
    ("return np.zeros(frame0.shape)", "returned an array of shape (24, 32), not (2, 24, 32)"),
    ("return np.zeros((*frame0.shape, 2))", "returned an array of shape (24, 32, 2), not (2, 24, 32)"),
    ("return np.zeros((2, 3, 4))", "returned an array of shape (2, 3, 4), not (2, 24, 32)"),
    ("return np.full((2, *frame0.shape), np.nan)", "1536 of 1536 values of its flow are NaN or infinite"),
    ("return np.full((2, *frame0.shape), 1e300)", "1536 of 1536 values of its flow are NaN or infinite"),
    ("return None", "returned NoneType, not an array of numbers"),
    ("return [[1], [2, 3]]", "returned list, not an array of numbers"),
    ("return np.zeros((2, *frame0.shape), complex)", "returned ndarray, not an array of numbers"),
    ("return FlowResult(np.zeros(3), '', None)", "returned an array of shape (3,), not (2, 24, 32)"),
    ("return 1 / 0", "raised ZeroDivisionError: division by zero (my_package.py:"),
    ("raise MemoryError", "raised MemoryError (my_package.py:"),
    ("raise SystemExit(3)", "raised SystemExit: 3 (my_package.py:"),
]


@pytest.mark.parametrize(("body", "named"), BODIES)
def test_functions_that_return_no_flow(package, refused, images, body, named):
    package(method(body=body))
    refused(images, ESTIMATE, ENTRY, named)


#: Overrides, and what is said.
VALUES = [
    (["strenth=1"], "unknown parameter 'strenth': did you mean 'strength'?"),
    (["alpha=1"], "unknown parameter 'alpha' (allowed: direction, strength)"),
    (["strength=much"], "method 'my_flow': `strength` must be a number, got 'much'"),
    (["strength=true"], "method 'my_flow': `strength` must be a number, got 'true'"),
    (["strength=101"], "method 'my_flow': strength 101 is more than 100"),
    (["strength=1,2"], "estimate takes one value a parameter (strength=1,2)"),
]


@pytest.mark.parametrize(("words", "named"), VALUES)
def test_parameters_of_a_package(package, refused, images, words, named):
    package()
    refused(images, [*ESTIMATE, *words], named)


SWEPT = [
    (["strenth=1"], "unknown key 'strenth': did you mean 'strength'?"),
    (["strength=0.5,much"], "method 'my_flow': `strength` must be a number, got 'much'"),
    (["strength=50:150:50"], "method 'my_flow': strength 150 is more than 100"),
    (["alpha=5"], "`alpha` must be in [0, 4], got 5"),
    (["strength=1", "params.strength=1"], "'strength' and 'params.strength' are the same key, given twice"),
]


@pytest.mark.parametrize(("words", "named"), SWEPT)
def test_grids_over_the_parameters_of_a_package(package, refused, images, words, named):
    package()
    refused(images, [*SWEEP, *words], named)
    refused(images, [*SWEEP, *words, "--dry-run"], named)


def test_a_parameter_of_no_chosen_method(package, refused, images):
    package()
    refused(images, ["sweep", "method=tvl1", "strength=1", "sequence=synthetic_flat"], "unknown key 'strength'")


def test_a_program_that_a_package_needs(package, refused, images):
    package(method("requires=('nothing_of_the_kind',)"))
    named = (
        "method 'my_flow' needs nothing_of_the_kind: it is not installed (entry point 'my_flow' of my-package 1.0)"
    )
    refused(images, ESTIMATE, named)
    refused(images, SWEEP, named)


def test_a_name_that_two_packages_offer(package, refused, images):
    package()
    package(module="your_package", release="2.0", entries="my_flow = your_package:METHOD")
    named = "entry point 'my_flow': my-package 1.0 and your-package 2.0 offer the same name; uninstall one"
    refused(images, ESTIMATE, named)


def test_a_name_of_ours_is_kept_and_said_once(package, cli, images):
    package(method("name='tvl1'"), entries="tvl1 = my_package:METHOD")
    line = (
        "entry point 'tvl1' of my-package 1.0: fracbench has a method of this name, which is used; choose another"
    )
    done = cli("sweep", "method=tvl1,tvl1_sb", "sequence=synthetic_flat", "--dry-run")
    assert (done.code, done.err) == (EXIT_DONE, f"note: {line}\n")
    assert f"cannot be used: {line}\n" in cli("methods").out
    assert get_method("tvl1").package == ""


def test_a_race_leaves_out_a_method_that_cannot_be_used_unless_it_is_asked_for(package, caplog):
    package("METHOD = 1")
    names = [contender.name for contender in measure.contenders()]
    assert "tvl1" in names and "my_flow" not in names
    assert f"{ENTRY}my_package:METHOD is of type int, not a fracbench.Method" in caplog.messages
    with pytest.raises(InputError, match="my_package:METHOD is of type int"):
        measure.contenders(["my_flow"])


def test_a_package_without_metadata_has_no_name(package, refused, images):
    package("METHOD = 1")
    (images.parent / f"{images.name}_site" / "my_package-1.0.dist-info" / "METADATA").unlink()
    refused(
        images, ESTIMATE, "entry point 'my_flow' of unknown-package of no version: my_package:METHOD is of type"
    )


def test_entry_points_that_cannot_be_read_leave_our_methods_alone(package, refused, images, cli):
    package(entries="my_flow")
    refused_line = "other packages are left out: their entry points cannot be read: "
    done = cli("sweep", "method=tvl1", "sequence=synthetic_flat", "--dry-run")
    assert done.code == EXIT_DONE and done.err.startswith(f"note: {refused_line}") and done.err.count("\n") == 1
    assert done.out.startswith("1 points")


def test_the_nearest_name_may_be_that_of_a_package(package, refused, images):
    package()
    refused(images, [*ESTIMATE[:-1], "my_flaw"], "unknown method 'my_flaw': did you mean 'my_flow'?")


def test_no_energy_is_recorded_for_parameters_that_are_not_ours(package):
    package()
    with pytest.raises(InputError, match="method 'my_flow' records no energy"):
        estimate_flow(np.zeros((9, 9)), np.zeros((9, 9)), method="my_flow", trace=True)


def test_the_tables_packages_would_work_but_for_their_mistake(package, cli, images):
    package(
        method(fields="strength: Optional[float] = 1.0\n    mode: Literal['a', 'b'] = 'a'\n    lambda_: int = 3")
    )
    done = cli(*ESTIMATE, "strength=none", "mode=b", "lambda=4")
    assert done.code == EXIT_DONE, done.err
    assert not read_flow("out.flo").any()
    values = get_method("my_flow").replace(get_method("my_flow").start(), {"strength": "none", "lambda": "4"})
    assert dataclasses.asdict(values) == {"strength": None, "mode": "a", "lambda_": 4}


def test_the_reserved_names_are_those_of_keys_and_columns(fake_rows):
    from fracbench.harness.config.compose import GROUPS, SETTINGS
    from fracbench.harness.run.plan import plan_experiment
    from fracbench.harness.run.tidy import tidy

    plan = plan_experiment({"main": ["sequence=synthetic_flat", "noise=1", "seed=1", "margin=2"]})
    columns = set(tidy(plan, fake_rows(plan)).columns) - set(plan.points[0].point.canonical)
    assert {key.partition(".")[0] for key in (*GROUPS, *SETTINGS)} | columns <= RESERVED
    assert not RESERVED & set(FlowParams.names())
    with pytest.raises(InputError, match="taken"):
        Method("a", "a", "a", print, params=dataclasses.make_dataclass("P", [("seed", int, 1)], frozen=True))


def test_a_method_gets_the_options_that_it_names_and_no_others():
    seen = []

    def estimate(frame0, frame1, params, **options):
        seen.append(options)
        return np.zeros((2, *frame0.shape))

    frames, mask = np.zeros((2, 9, 9)), np.eye(9, dtype=bool)
    taking = Method("taking", "T", "takes a mask", estimate, params=Plain, options=("mask",))
    taking.compute(*frames, Plain(), mask=mask)
    taking.compute(*frames, Plain())
    assert list(seen[0]) == ["mask"] and seen[0]["mask"] is mask and seen[1] == {}
    with pytest.raises(InputError, match="method 'taking' takes no `initial_flow`"):
        taking.compute(*frames, Plain(), initial_flow=np.zeros((2, 9, 9)))
    with pytest.raises(InputError, match="unknown option 'maks': did you mean 'mask'"):
        Method("other", "O", "takes more", estimate, params=Plain, options=frozenset({"maks"}))


@dataclasses.dataclass(frozen=True)
class Plain:
    """No parameters."""
