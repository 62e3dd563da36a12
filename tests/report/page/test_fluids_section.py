"""The section on fluids: it is made from files alone, which no data set of the paper marks."""

from __future__ import annotations

import pytest
from PIL import Image

from fracbench.report.page.elements import Details, Missing, Picture, Text
from fracbench.report.page.fluids import fluids
from fracbench.report.sources import Sources

TOLD = "# Title\n\n- It is 0.3 times as large.\n\n## By flow\n\n| flow | error |\n| --- | --- |\n| jet | 0.1 |\n"


@pytest.fixture
def sources(tmp_path):
    return Sources(tmp_path, ("dataset=synthetic", "parallel.jobs=1"))


def test_without_files_it_names_the_command(sources, monkeypatch):
    monkeypatch.setattr("fracbench.report.sources.checkout", lambda: None)  # which has copies
    missing = [block for block in fluids(sources).blocks if isinstance(block, Missing)]
    assert [block.what for block in missing] == ["the experiment fluids"]
    assert "fracbench experiment fluids" in missing[0].command


def test_it_shows_the_figures_and_folds_the_tables(sources, tmp_path):
    for folder in ("tables", "figures"):
        (tmp_path / folder).mkdir()
    (tmp_path / "tables/fluids.md").write_text(TOLD)
    for name in ("fluids", "fluids_settings", "fluids_flows"):
        Image.new("RGB", (4, 4)).save(tmp_path / f"figures/{name}.png")
    blocks = fluids(sources).blocks
    assert any(isinstance(block, Text) and "0.3 times as large" in block.markdown for block in blocks)
    assert len([block for block in blocks if isinstance(block, Picture)]) == 3
    folded = [block for block in blocks if isinstance(block, Details)]
    assert "By flow" in str(folded[0].blocks) and "docs/fluids.md" in folded[-1].summary
