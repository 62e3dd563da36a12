"""Numbers in the documents: those that a stored table holds, too, must agree with it."""

from __future__ import annotations

import re

import pandas as pd
import pytest

from fracbench.harness.config.paths import checkout

HALF = 0.006  # documents give two digits

ROOT = checkout()
pytestmark = pytest.mark.skipif(ROOT is None, reason="documents and tables are those of a checkout")


def rows(text: str) -> list[list[str]]:
    """The cells of every row of a Markdown file's tables."""
    return [
        [cell.strip() for cell in line.strip("|\n").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]


def numbers(cell: str) -> list[float]:
    return [float(found) for found in re.findall(r"\d*\.?\d+", cell.replace(" of 8", ""))]


def test_the_switches_of_the_protocols_are_those_of_the_stored_study():
    study = pd.read_csv(ROOT / "results/committed/tables/protocol_study.csv").fillna({"switch": ""})
    study = study.set_index(["protocol", "switch"])
    told = {
        row[0].split("`")[1] if "`" in row[0] else row[0]: row[1:] for row in rows(document()) if len(row) == 3
    }
    switches = [switch for switch in study.loc["published"].index if switch]
    assert {"none", *switches} <= set(told)
    for switch in ("", *switches):
        for protocol, cell in zip(("reference", "published"), told[switch or "none"], strict=True):
            assert numbers(cell) == [pytest.approx(study.loc[(protocol, switch), "distance"], abs=HALF)]


def test_the_protocols_are_those_of_the_stored_tables():
    study = pd.read_csv(ROOT / "results/committed/tables/protocol_study.csv").fillna({"switch": ""})
    told = {row[0].strip("`"): row[2:] for row in rows(document()) if len(row) == 7}
    for protocol in ("reference", "published"):
        found = study[(study["protocol"] == protocol) & (study["switch"] == "")].iloc[0]
        distance, five, ten, better, errors = map(numbers, told[protocol])
        assert distance == [pytest.approx(found["distance"], abs=HALF)]
        assert [*five, *ten] == [found["within 5 %"], found["within 10 %"]]
        assert better == [found["SB better, AAE"], found["SB better, AEPE"]]
        assert errors == [pytest.approx(found[f"AEPE {method}"], abs=HALF) for method in ("tvl1", "tvl1_sb")]


def document() -> str:
    return (ROOT / "docs/protocol.md").read_text(encoding="utf-8")


def test_the_readme_shows_the_stored_answer():
    answer = (ROOT / "results/committed/tables/answer.md").read_text(encoding="utf-8")
    assert answer in (ROOT / "README.md").read_text(encoding="utf-8"), "run: make publish"
