from __future__ import annotations

import numpy as np
import pytest

from fracbench.figures.contact_sheet import MOST_FLOWS, chosen, contact_sheet
from fracbench.figures.style import render


def test_a_long_clip_is_shown_in_part_from_end_to_end():
    names = [f"f{i}" for i in range(1000)]
    shown = chosen(names)
    assert len(shown) == MOST_FLOWS and (shown[0], shown[-1]) == ("f0", "f999")
    assert set(np.diff([int(name[1:]) for name in shown])) == {37}
    assert chosen(names[:1]) == names[:1] and chosen(names[:9]) == names[:9]


@pytest.mark.parametrize("shape", [(400, 700), (700, 50), (5, 7)])
def test_frame_flows_and_wheel_are_of_one_size(shape):
    flows = [(f"f{i}", np.full((*shape, 3), 40 * i, np.uint8)) for i in range(3)]
    fig = contact_sheet(np.full(shape, 65535, np.uint16), flows, 3.14159, "a clip")
    shown = [ax for ax in fig.axes if ax.images]
    assert [ax.get_title() for ax in shown] == ["first frame", "f0", "f1", "f2", "rim: 3.14 px"]
    pictures = [np.asarray(ax.images[0].get_array()) for ax in shown]
    assert {picture.shape[:2] for picture in pictures} == {pictures[0].shape[:2]}
    assert max(pictures[0].shape[:2]) <= 350 and (pictures[0] == 255).all() and (pictures[2] == 40).all()
    assert fig.get_suptitle() == "a clip"


@pytest.mark.parametrize("name", ["a$b$", "$\\frac{", "映像_0001", "x" * 100 + "_0042", " "])
def test_any_name_of_a_file_can_be_shown(name):
    fig = contact_sheet(np.zeros((20, 30), np.uint8), [(name, np.zeros((20, 30, 3), np.uint8))], 1.0, "")
    assert render(fig, "png").startswith(b"\x89PNG")
    assert fig.axes[1].get_title().replace("\\$", "$")[-4:] == name[-4:]


def test_letters_that_the_font_lacks_are_question_marks():
    fig = contact_sheet(
        np.zeros((20, 30), np.uint8), [("映像_1é\udcff", np.zeros((20, 30, 3), np.uint8))], 1.0, ""
    )
    assert fig.axes[1].get_title() == "??_1é?"
