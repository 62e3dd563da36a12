"""Names of others: of folders, files, pairs, methods; and texts out of a store. No reader is fooled by them."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from fracbench.data.datasets.base import Dataset
from fracbench.data.datasets.registry import _OTHERS as DATASETS
from fracbench.data.files import write_image, write_text
from fracbench.errors import InputError
from fracbench.harness.config.records import require_name
from fracbench.harness.run.store import Store
from fracbench.methods.method import Method
from fracbench.report.page import html
from fracbench.report.page.elements import markdown_html, plain, render_page
from fracbench.report.sources import Sources

SMALL = ("n_scales=1", "n_warps=1", "max_iter=1", "parallel.jobs=1")
HOSTILE = [
    "<img src=x onerror=alert(1)>",
    "a\x1b[31mred",
    "a\nb",
    "a\u202egnp.b",
    "..",
    "a/b",
    "a b",
    "=cmd",
    "-rf",
    "a" * 81,
    "",
    "caf\u00e9",
    "`x`",
]


class Tags(HTMLParser):
    """The tags of a page, each with its attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def harmless(page: str) -> bool:
    """Tell whether a page holds one script, its own, and no attribute or link that runs one."""
    tags = Tags(page).found
    runs = [tag for tag, attrs in tags if any(name.startswith("on") for name in attrs)]
    sources = [attrs.get("src") or attrs.get("href") or "" for _, attrs in tags]
    elsewhere = [source for source in sources if re.match(r"\s*(javascript|vbscript|data:text)", source, re.I)]
    return [tag for tag, _ in tags].count("script") == 1 and not runs and not elsewhere


def pairs(folder: Path, name: str) -> None:
    """A folder of one pair, which is called `name`."""
    (folder / name).mkdir(parents=True)
    frame = np.random.default_rng(0).integers(0, 256, (16, 16), dtype=np.uint8)
    for i in range(2):
        write_image(folder / name / f"frame{i}.png", frame)


@pytest.mark.parametrize("name", HOSTILE)
def test_no_other_name_than_one_of_plain_letters(name):
    with pytest.raises(InputError) as caught:
        require_name(name, "the name", "here")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("command", "name"),
    [
        *((["sweep"], name) for name in HOSTILE if name.strip(".") and "/" not in name),
        *((words, HOSTILE[0]) for words in (["run"], ["report", "--only", "table2"], ["experiment", "table2"])),
    ],
)
def test_a_pair_of_such_a_name_is_refused_before_anything_is_written(work, refused, command, name):
    pairs(work / "pairs", name)
    settings = SMALL if command[0] in ("sweep", "run") else ()
    said = refused(work, [*command, "dataset=folder", "paths.data=pairs", *settings], "the name of a pair must be")
    assert said[:-1].isprintable()


@pytest.mark.parametrize("name", ["../../out", "a\x1bb", "<script>"])
def test_a_pair_of_another_package_is_no_path(work, refused, monkeypatch, name):
    made = Dataset(
        name="theirs",
        summary="s",
        names=lambda _: [name],
        shape=lambda *_: (16, 16),
        load=lambda *_, **__: None,
        digest=lambda *_, **__: "d",
    )
    monkeypatch.setattr(type(DATASETS), "names", lambda _: ["theirs"])
    monkeypatch.setattr(type(DATASETS), "load", lambda *_: made)
    monkeypatch.setattr(type(DATASETS), "__contains__", lambda _, word: word == "theirs")
    refused(work, ["sweep", "dataset=theirs", *SMALL], "the name of a pair must be")


@pytest.mark.parametrize("name", HOSTILE)
def test_a_method_of_another_package_is_no_path(name):
    with pytest.raises(InputError) as caught:
        Method(name, "label", "summary", lambda *_: None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "name", ["a\x1b]0;title\x07.png", "a\x9b31m.png", "a\nb.png", "a\u202eb.png", "a\udcff.png"]
)
def test_a_terminal_never_obeys_the_name_of_a_file(work, cli, name):
    """Escape sequences, line breaks, text that runs backwards, and bytes that are no UTF-8."""
    done = cli("estimate", name, name, "-o", "flow.flo")
    assert done.code == 2 and done.err.count("\n") == 1 and done.err[:-1].isprintable()
    pairs(work / "pairs" / name, "one")
    done = cli("sweep", "dataset=folder", f"paths.data={work / 'pairs' / name}", *SMALL)
    assert all(c.isprintable() or c == "\n" for c in done.out + done.err)


# -- links ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["sweeps", "runs", "runs/flows", "runs/store.sqlite"])
def test_no_link_leads_out_of_the_results_folder(work, refused, place):
    (work / "elsewhere").mkdir()
    link = work / "results" / place
    link.parent.mkdir(parents=True)
    link.symlink_to(work / "elsewhere" / ("" if link.suffix == "" else "x.sqlite"))
    argv = ["sweep", "sequence=synthetic_flat", *SMALL]
    refused(work, argv, f"results/{place}: is a link that leads out of the results folder; set paths.results")


def test_the_results_folder_itself_may_be_a_link(work, cli):
    (work / "elsewhere").mkdir()
    (work / "results").symlink_to("elsewhere")
    for _ in range(2):  # the second time there are files in it, and a link that stays within
        assert cli("sweep", "sequence=synthetic_flat", *SMALL).code == 0
        assert (work / "elsewhere" / "runs" / "store.sqlite").is_file()
        (work / "elsewhere" / "latest").unlink(missing_ok=True)
        (work / "elsewhere" / "latest").symlink_to("sweeps")


def test_a_file_that_is_a_link_is_replaced_not_followed(work):
    (work / "precious").write_text("precious")
    (work / "table.csv").symlink_to("precious")
    write_text("a,b\n", work / "table.csv")
    assert (work / "precious").read_text() == "precious" and not (work / "table.csv").is_symlink()


# -- the page ------------------------------------------------------------------------------------

TEXTS = [
    "<img src=x onerror=alert(1)>",
    "</style><script>alert(1)</script>",
    "[click](javascript:alert(1))",
    "![x](https://example.org/spy.png)",
    '" onmouseover="alert(1)',
    "<https://example.org>",
    "# heading\n\n<b>bold</b>",
    "`code` & *stress* | a _b_ \\",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_shown_as_it_is(text):
    shown = markdown_html(f"The first: {plain(text)}")
    tags = [tag for tag, _ in Tags(shown).found]
    assert tags == ["p"]
    words: list[str] = []
    reader = HTMLParser(convert_charrefs=True)
    reader.handle_data = words.append
    reader.feed(shown)
    assert "".join(words).strip() == f"The first: {' '.join(text.split())}"


def test_texts_of_a_store_and_of_others_files_do_nothing_on_the_page(work, fake_rows):
    """The page of results of others: errors, machines, versions, commits; titles of experiments; files."""
    evil = "".join(TEXTS)
    settings = ("dataset=synthetic", "parallel.jobs=1")
    (work / "experiments").mkdir()
    title = json.dumps(evil)
    (work / "experiments" / "fig5.yaml").write_text(f"title: {title}\ngrid: [alpha=1, sequence=synthetic_flat]\n")
    sources = Sources(work / "results", settings, small=True)
    provenance = {"cpu": evil, "python": evil, "versions": {evil: evil}, "commit": evil, "host": evil}
    for name, status in (("fig5", "failed"), ("table2", "done")):
        rows = fake_rows(sources.get(name).plan, status=status, provenance=provenance, created=evil)
        with Store(work / "results" / "runs" / "store.sqlite") as store:
            for row in rows.values():
                store.put(row if status == "done" else type(row)(**{**vars(row), "error": evil}))
    (work / "results" / "private").mkdir()
    write_image(
        work / "results/private" / "fig5_<img src=x onerror=alert(1)>`x`_synthetic_small.png",
        np.zeros((4, 4), np.uint8),
    )
    page = html.page(Sources(work / "results", settings, small=True))
    assert "onerror=alert(1)" in page and "&lt;img src=x onerror" in page  # it is there, as text
    assert harmless(page)


def test_the_check_of_the_page_works():
    """Without the escapes the same texts would run."""
    sound = render_page("t", "l", [], [])
    assert harmless(sound)
    for text in (TEXTS[0], "<script>alert(1)</script>", '<a href="javascript:alert(1)">x</a>'):
        assert not harmless(sound.replace("</main>", f"{text}</main>"))
