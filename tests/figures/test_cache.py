"""Figures are drawn again if and only if their content or their files have changed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from fracbench.figures import cache, style
from fracbench.figures.cache import draw, keep


@pytest.fixture
def calls(monkeypatch):
    """Figures are not written but counted; their files hold the number."""
    made = []

    def save(figure, stem):
        made.append(figure)
        for path in style.figure_files(stem):
            path.write_text(str(len(made)))

    monkeypatch.setattr(style, "save_figure", save)
    return made


def picture(*shown, **looks):
    return (shown, looks)


def other(*shown, **looks):
    return (shown, looks)


TABLE = pd.DataFrame({"alpha": [0.0, 0.1], "aae": [0.25, np.nan]})


def test_what_has_not_changed_is_not_drawn_again(tmp_path, calls):
    for _ in range(2):
        files = draw(tmp_path / "a1.2", picture, TABLE.copy(), {"x": (1, None)}, title="t")
    assert [path.name for path in files] == ["a1.2.png", "a1.2.pdf"] and len(calls) == 1


@pytest.mark.parametrize(
    ("make", "shown", "looks"),
    [
        (other, (TABLE, 1), {"title": "t"}),
        (picture, (TABLE.assign(aae=0.3), 1), {"title": "t"}),
        (picture, (TABLE.rename(columns={"aae": "aepe"}), 1), {"title": "t"}),
        (picture, (TABLE.astype({"alpha": int}), 1), {"title": "t"}),
        (picture, (TABLE, 1.0), {"title": "t"}),
        (picture, (TABLE, "1"), {"title": "t"}),
        (picture, (TABLE, np.ones(1)), {"title": "t"}),
        (picture, (TABLE, 1), {"title": "u"}),
        (picture, (TABLE, 1), {}),
    ],
)
def test_anything_that_is_shown_makes_a_difference(tmp_path, calls, make, shown, looks):
    draw(tmp_path / "a", picture, TABLE, 1, title="t")
    draw(tmp_path / "a", make, *shown, **looks)
    assert len(calls) == 2


@pytest.mark.parametrize("suffix", ["png", "pdf"])
@pytest.mark.parametrize("harm", [lambda path: path.write_text("by hand"), lambda path: path.unlink()])
def test_a_file_that_was_changed_or_removed_is_made_again(tmp_path, calls, suffix, harm):
    draw(tmp_path / "a", picture, TABLE)
    harm(tmp_path / f"a.{suffix}")
    draw(tmp_path / "a", picture, TABLE)
    assert len(calls) == 2 and (tmp_path / f"a.{suffix}").read_text() == "2"


def test_new_code_draws_anew(tmp_path, calls, monkeypatch):
    draw(tmp_path / "a", picture, TABLE)
    monkeypatch.setattr(cache, "_code", lambda: "other sources")
    draw(tmp_path / "a", picture, TABLE)
    assert len(calls) == 2


def test_what_cannot_be_made_is_tried_again(tmp_path):
    def fail():
        raise RuntimeError("no ink")

    with pytest.raises(RuntimeError):
        keep([tmp_path / "a.csv"], 1, fail)
    assert list(tmp_path.iterdir()) == []
    keep([tmp_path / "a.csv"], 1, lambda: (tmp_path / "a.csv").write_text("made"))
    assert (tmp_path / "a.csv").read_text() == "made"


def test_a_change_in_any_folder_of_a_room_that_draws_counts(tmp_path, monkeypatch):
    file = tmp_path / cache._ROOMS[0] / "deeper" / "lines.py"
    file.parent.mkdir(parents=True)
    monkeypatch.setattr(cache, "_PACKAGE", tmp_path)
    states = set()
    for text in ("thin", "thick"):
        file.write_text(text)
        cache._code.cache_clear()
        states.add(cache._code())
    cache._code.cache_clear()
    assert len(states) == 2
