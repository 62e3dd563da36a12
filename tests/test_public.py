"""The public names: each exists, has a docstring of its own, and its examples are true."""

from __future__ import annotations

import doctest
import importlib
import inspect

import pytest

import fracbench

MODULES = sorted(set(fracbench._HOMES.values()))


@pytest.mark.parametrize("name", fracbench.__all__)
def test_a_public_name_is_there_and_documented(name):
    found = getattr(fracbench, name)
    if name != "__version__":
        assert name in dir(importlib.import_module(fracbench._HOMES[name]))
        assert len(inspect.getdoc(found)) > 60


def test_the_homes_are_those_of_the_public_names():
    assert set(fracbench._HOMES) == set(fracbench.__all__) - {"__version__"}


@pytest.mark.parametrize("module", MODULES)
def test_the_examples_of_docstrings_are_true(module, work):
    assert doctest.testmod(importlib.import_module(module)).failed == 0


def test_some_docstrings_have_examples():
    finder = doctest.DocTestFinder()
    modules = [importlib.import_module(module) for module in MODULES]
    assert sum(len(test.examples) for module in modules for test in finder.find(module)) > 10
