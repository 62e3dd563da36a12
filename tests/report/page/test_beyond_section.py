"""The section beyond the paper: it is made from files alone and names the missing ones."""

from __future__ import annotations

import pytest
from PIL import Image

from fracbench.report.page import beyond
from fracbench.report.page.elements import Details, Heading, Missing, Picture, Text
from fracbench.report.sources import Sources

SETTINGS = ("dataset=synthetic", "parallel.jobs=1")
TOLD = """# Title

Legend of it.

Alpha by class is 1.0 % better.

## AEPE

| sequence | one |
| --- | --- |
| venus | .3 |
"""


@pytest.fixture
def sources(tmp_path, monkeypatch):
    made = Sources(tmp_path, SETTINGS, small=True)
    monkeypatch.setattr(made, "get", lambda name: pytest.fail("planned"))
    monkeypatch.setattr(beyond, "EXPERIMENTS", ("adaptive_alpha", "alpha_by_structure"))
    return made


def test_what_was_never_run_is_named_with_its_command(sources):
    section = beyond.beyond(sources)
    missing = [block for block in section.blocks if isinstance(block, Missing)]
    assert [block.what for block in missing] == [
        "the experiment adaptive_alpha",
        "the experiment alpha_by_structure",
    ]
    assert missing[0].command == "fracbench experiment adaptive_alpha dataset=synthetic parallel.jobs=1 --small"
    assert "make beyond" in section.blocks[0].markdown


def test_what_was_run_is_told_from_its_files(sources, tmp_path):
    for folder in ("tables", "figures", "private"):
        (tmp_path / folder).mkdir()
    (tmp_path / "tables/adaptive_alpha_synthetic_small.md").write_text(TOLD, encoding="utf-8")
    (tmp_path / "tables/alpha_by_structure.md").write_text(TOLD, encoding="utf-8")  # Middlebury, full grid
    for path in ("figures/adaptive_alpha", "private/adaptive_alpha_orders"):
        Image.new("RGB", (8, 4)).save(tmp_path / f"{path}_synthetic_small.png")
    _, heading, said, figure, orders, folded, *others = beyond.beyond(sources).blocks
    assert isinstance(heading, Heading) and heading.anchor == "beyond-adaptive_alpha"
    assert isinstance(said, Text) and said.markdown == "Legend of it.\n\nAlpha by class is 1.0 % better."
    assert isinstance(figure, Picture) and isinstance(orders, Picture)
    assert "orders chosen by the true flow" in orders.caption
    assert isinstance(folded, Details) and folded.blocks[0].markdown.startswith("#### AEPE\n\n| sequence")
    assert [block.what for block in others if isinstance(block, Missing)] == ["the experiment alpha_by_structure"]
