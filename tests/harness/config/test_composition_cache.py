"""Compositions are made once for a configuration, and again when any of its files changes."""

from __future__ import annotations

import pytest

from fracbench.harness.config import composition_cache
from fracbench.harness.config.composition_cache import cached_composition

CHOICES = (("protocol", "reference"),)


@pytest.fixture
def conf(tmp_path, monkeypatch):
    """A configuration, and a cache that does not exist yet."""
    monkeypatch.setattr(composition_cache, "cache_folder", lambda: tmp_path / "deep" / "cache")
    folder = tmp_path / "conf"
    (folder / "protocol").mkdir(parents=True)
    (folder / "config.yaml").write_text("a: 1\n")
    return folder


def cached(folder, choices, compose):
    return cached_composition(sorted(folder.rglob("*.yaml")), choices, compose)


class Compose:
    """A function that counts its calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return {"params": {"alpha": 0.1, "pad": 0, "gain": None, "warm": True}, "rows": [90, 250]}


def test_the_second_answer_is_the_first(conf):
    compose = Compose()
    assert cached(conf, CHOICES, compose) == cached(conf, CHOICES, compose) == compose()
    assert compose.calls == 2  # one of them is the line above


@pytest.mark.parametrize("change", ["config.yaml", "protocol/new.yaml"])
def test_a_changed_or_new_file_is_seen(conf, change):
    compose = Compose()
    cached(conf, CHOICES, compose)
    (conf / change).write_text("a: 2\n")
    cached(conf, CHOICES, compose)
    assert compose.calls == 2


def test_other_choices_are_other_compositions(conf):
    compose = Compose()
    for choices in (CHOICES, (), (("protocol", "published"),)):
        cached(conf, choices, compose)
    assert compose.calls == 3


def test_a_broken_or_forbidden_cache_is_done_without(conf, tmp_path, monkeypatch):
    compose = Compose()
    cached(conf, CHOICES, compose)
    (entry,) = (tmp_path / "deep" / "cache").iterdir()
    entry.write_text('{"params": ')
    assert cached(conf, CHOICES, compose)["rows"] == [90, 250] and compose.calls == 2
    (tmp_path / "deep2").write_text("a file where the folder should be")
    monkeypatch.setattr(composition_cache, "cache_folder", lambda: tmp_path / "deep2" / "cache")
    assert cached(conf, CHOICES, compose)["rows"] == [90, 250] and compose.calls == 3
