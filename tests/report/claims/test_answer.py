"""The short answer: its numbers, its picture, and its block in the README."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.report.claims import answer
from fracbench.report.claims.answer import HEADLINES, answer_figure, answer_table, answer_text, renew, write_answer
from fracbench.report.claims.claims import load_claims
from fracbench.report.claims.judging import CONTEXT, captioned_regions, published_table2
from fracbench.report.sources import Sources

FIRST, LAST = answer._MARKS


def curve(best):
    alphas = np.round(np.arange(0, 2.01, 0.1), 1)
    return pd.DataFrame({"alpha": alphas, "aae": 0.1, "aepe": 0.1 * (1 + (alphas - best) ** 2)})


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """Made-up results: each region is best at 1.1 under the reference, at 0.5 otherwise."""
    parts = {"main": ("reference", 1.1), "protocols": ("published", 0.5), "context": ("reference", 0.5)}
    made = {}
    for figure in ("fig6", "fig7"):
        made[figure] = pd.concat(
            curve(best).assign(region=region, part=part, protocol=protocol, lambda_sb=weight)
            for region, (home, weight) in captioned_regions().items()
            for part, (protocol, best) in parts.items()
            if home == figure
        ).assign(dataset="middlebury", status="done")
    printed = published_table2()
    made["table2"] = pd.concat(
        printed.assign(protocol=protocol, aepe=printed["aepe"] * factor)
        for protocol, factor in (("reference", 0.1), ("published", 1.1))
    ).assign(dataset="middlebury", status="done")
    sources = Sources(tmp_path, ["dataset=synthetic"])
    monkeypatch.setattr(sources, "load", made.get)
    return sources


def test_every_mark_has_a_row(sources):
    table = answer_table(sources)
    alphas = table[table["panel"] == "alpha"].set_index(["place", "source"])
    assert alphas.loc[("grove2_B", "paper"), "value"] == 0 and len(alphas) == 6 * 4
    assert alphas.loc[("urban3_A", "reference"), ["value", "low", "high"]].tolist() == [1.1, 1.0, 1.2]
    assert alphas.loc[("urban3_A", CONTEXT), "value"] == 0.5
    errors = table[table["panel"] == "aepe"].set_index(["place", "source"])["value"]
    assert errors["venus", "reference"] == pytest.approx(0.1 * errors["venus", "paper"]) and len(errors) == 8 * 3


def test_the_picture_shows_them(sources):
    left, right = answer_figure(answer_table(sources), "Title").axes
    marks = {line.get_label(): line.get_xdata() for line in left.lines if not line.get_label().startswith("_")}
    assert list(marks) == ["paper", "reference", "published", CONTEXT]
    np.testing.assert_allclose(marks["reference"], 1.1)
    assert [label.get_text() for label in left.get_yticklabels()] == list(captioned_regions())
    assert right.get_xscale() == "log" and len(right.get_yticks()) == 8


def test_without_all_points_there_is_no_picture(sources, monkeypatch):
    (sources.results / "tables").mkdir()
    monkeypatch.setattr(sources, "load", lambda name: None)
    assert [path.name for path in write_answer(sources)] == ["answer_synthetic.md"]
    assert not (sources.results / "figures").exists()


def test_headlines_are_claims():
    assert set(HEADLINES) <= {claim.id for claim in load_claims()}


def test_the_text_counts_and_lists(sources):
    text = answer_text(sources)
    n = len(load_claims())
    counts = next(line for line in text.splitlines() if line.startswith("| `reference`:")).split("|")[2:-1]
    assert int(counts[0]) == sum(map(int, counts[1:])) == n
    assert all(f"`{name}`" in text for name in HEADLINES)
    widths = {line.count("|") for line in text.split("\n\n")[1].splitlines()}
    assert len(widths) == 1


def test_a_readme_is_renewed_between_its_marks(sources, tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{FIRST}\nold \\1\n{LAST}\nafter\n")
    for _ in range(2):
        renew(readme, sources)
        assert readme.read_text() == f"before\n{FIRST}\n{answer_text(sources)}{LAST}\nafter\n"


@pytest.mark.parametrize("text", ["no marks\n", f"{LAST}\n{FIRST}\n"])
def test_a_file_without_marks_is_left_alone(sources, tmp_path, text):
    (tmp_path / "README.md").write_text(text)
    with pytest.raises(InputError, match="has no block between"):
        renew(tmp_path / "README.md", sources)
    assert (tmp_path / "README.md").read_text() == text
