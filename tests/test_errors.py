from __future__ import annotations

import pytest

from fracbench.errors import InputError, nearest, unknown_name


@pytest.mark.parametrize(
    ("name", "allowed", "where", "message"),
    [
        (
            "grove",
            ["grove2", "venus"],
            "",
            "unknown region 'grove': did you mean 'grove2'? (allowed: grove2, venus)",
        ),
        ("zzz", ["venus", "grove2"], "", "unknown region 'zzz' (allowed: grove2, venus)"),
        ("VENUS", ["venus"], "a.yaml", "a.yaml: unknown region 'VENUS': did you mean 'venus'? (allowed: venus)"),
    ],
)
def test_an_unknown_name_offers_the_nearest_if_there_is_one(name, allowed, where, message):
    error = unknown_name("region", name, allowed, where)
    assert isinstance(error, InputError)
    assert str(error) == message


def test_the_nearest_name_has_its_own_spelling():
    assert nearest("GROVE_2", ["Grove2", "Venus"]) == "Grove2"
    assert nearest("x", ["Grove2", "Venus"]) is None
