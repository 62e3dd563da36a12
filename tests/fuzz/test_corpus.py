"""All inputs that a fuzzer has kept, and small changes of them: an answer, or one line of refusal, and soon."""

from __future__ import annotations

from pathlib import Path

import fuzz_targets
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fracbench.errors import InputError

CORPUS = Path(__file__).parent / "corpus"
CASES = sorted(path for path in CORPUS.rglob("*") if path.is_file())


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Keep compositions out of the user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def test_every_door_has_inputs():
    assert {path.parent.name for path in CASES} == set(fuzz_targets.TARGETS)


@pytest.mark.parametrize("name", fuzz_targets.TARGETS)
def test_some_inputs_are_taken_and_some_refused(name):
    """Each input as it is; if all were refused at the first byte, they would test nothing."""
    answers = {fuzz_targets.run(name, path.read_bytes()) for path in CASES if path.parent.name == name}
    assert answers == {True, False}


@pytest.mark.parametrize(
    "path", [path for path in CASES if path.parent.name == "protocol"], ids=lambda path: path.name
)
def test_the_door_for_protocols_answers_as_hydra_does(work, path):
    """The door leaves Hydra out, which takes most of the time."""
    answers = []
    for door in (fuzz_targets.protocol, fuzz_targets.by_hydra):
        try:
            answers.append(door(path.read_bytes()))
        except InputError:
            answers.append(None)
    assert answers[0] == answers[1]


@pytest.mark.parametrize("name", fuzz_targets.TARGETS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_changed_inputs(name, data):
    seeds = [path for path in CASES if path.parent.name == name]
    content = bytearray(data.draw(st.sampled_from(seeds)).read_bytes())
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    fuzz_targets.run(name, bytes(content))
