"""The report: a complete, well-formed page, the same on each run, that names missing parts."""

from __future__ import annotations

import html as markup
import itertools
import json
import re
import shutil
import subprocess
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from fracbench.data.files import write_flow
from fracbench.errors import InputError
from fracbench.harness.run.store import Row, Store
from fracbench.report.claims import claims
from fracbench.report.claims.claims import Claim, Judged, Verdict
from fracbench.report.page import background, exhibits, gallery, html, sections
from fracbench.report.page.elements import (
    Cell,
    Column,
    Gallery,
    Missing,
    Section,
    Table,
    demoted,
    drawing,
    markdown_html,
    photograph,
    picture_file,
    render_page,
)
from fracbench.report.sources import Sources
from fracbench.studies.paper.table2 import versus_published

VOID = {"meta", "img", "br", "hr", "input", "link", "col", "wbr"}
SETTINGS = ("dataset=synthetic", "parallel.jobs=1")


class Page(HTMLParser):
    """A page, read strictly: tags must be closed in the order in which they were opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.problems: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if len(dict(attrs)) < len(attrs):
            self.problems.append(f"an attribute twice in {tag} at {self.getpos()}")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.problems.append(f"</{tag}> at {self.getpos()}")

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("style", "script"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, *names):
        return [attributes for tag, attributes in self.tags if tag in names]


def made_up(source, *, created="2024-03-01T12:00:00+00:00", status="done", **changes) -> list[Row]:
    """Rows for all points of an experiment."""
    rows = []
    for i, (key, point) in enumerate(source.plan.unique().items()):
        result = {"aae": 0.1 + 0.01 * i, "aepe": 0.2 + 0.01 * i, "sdae": 0.3, "iterations": [[3]]}
        given = {
            "key": key,
            "identity": point.identity,
            "spec": point.spec,
            "solver_version": 7,
            "status": status,
            "result": result if status == "done" else {},
            "error": None if status == "done" else "made up",
            "seconds": 2.0,
            "provenance": {"cpu": "Abacus", "python": "3.11.0", "versions": {"numpy": "2.0"}, "commit": "ab" * 20},
            "created": created,
        }
        rows.append(Row(**given | changes))
    return rows


def fill(results: Path, rows: list[Row]) -> None:
    with Store(results / "runs" / "store.sqlite") as store:
        for row in rows:
            store.put(row)


def keep_flows(sources: Sources) -> None:
    """Store the true flow in place of the pictures' flows, so that none is computed."""
    folder = sources.results / "runs" / "flows"
    folder.mkdir(parents=True)
    for _, entries in gallery._shown(sources.get("table2").plan, sources):
        for _, point in entries:
            truth = gallery.point_arrays(point, None)[2]
            write_flow(gallery.flow_file(point, folder), truth + 0.25)


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Results in small form on the scenes: Table 2 is there, Figure 5 is drawn, all else is missing."""
    folder = tmp_path_factory.mktemp("results")
    sources = Sources(folder, SETTINGS, small=True)
    fill(folder, made_up(sources.get("table2")))
    (folder / "private").mkdir()
    Image.new("RGB", (64, 32), "navy").save(folder / "private" / "fig5_synthetic_small.png")
    keep_flows(sources)
    return folder


@pytest.fixture(scope="module")
def report(results) -> Path:
    return html.write_report(Sources(results, SETTINGS, small=True))


@pytest.fixture(scope="module")
def page(report) -> Page:
    return Page(report.read_text(encoding="utf-8"))


# -- the page as a whole -------------------------------------------------------------------------


def test_the_page_is_written_where_it_is_never_committed(results, report):
    assert report == results / "runs" / "report_synthetic_small.html"
    assert sorted(path.name for path in report.parent.iterdir() if "report" in path.name) == [report.name]


def test_the_page_is_well_formed(page):
    assert page.problems == [] and page.open == []
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert [name for name, count in Counter(ids).items() if count > 1] == []
    linked = [link["href"] for link in page.all("a") if link["href"].startswith("#")]
    assert len(linked) >= 10 and {href[1:] for href in linked} <= set(ids)
    assert len(page.all("h1")) == 1
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch("h[1-6]", tag)]
    assert all(later <= earlier + 1 for earlier, later in itertools.pairwise(levels))


def test_the_page_needs_no_other_file(report, page):
    places = [
        tag[name] for tag in page.all(*{tag for tag, _ in page.tags}) for name in ("src", "href") if name in tag
    ]
    assert {place for place in places if not place.startswith(("data:image/", "#"))} == {
        "https://arxiv.org/abs/1512.01398"
    }
    assert page.all("link", "iframe", "object", "embed", "base") == []
    text = report.read_text(encoding="utf-8")
    assert "url(" not in text and "@import" not in text
    assert len(text) < 25e6


def test_every_picture_has_words_and_a_size(page):
    pictures = page.all("img")
    assert len(pictures) >= 1 + 2 * 9
    for picture in pictures:
        assert picture["alt"].strip() and int(picture["width"]) > 0 and int(picture["height"]) > 0


def test_every_table_has_a_name_and_scrolls_in_its_own_box(page):
    boxes = [box for box in page.all("div") if box.get("class") == "scroll"]
    assert len(boxes) >= len(page.all("table")) > 8
    assert all(box["role"] == "region" and box["tabindex"] == "0" and box["aria-label"] for box in boxes)


def test_the_answer_comes_first(page):
    entries = [link["href"] for link in page.all("a") if link["href"].startswith("#")]
    assert entries == [
        "#main", "#verdicts", "#why", "#table2", "#figures", "#pictures", "#solvers",
        "#beyond", "#fluids", "#errata", "#open", "#conventions", "#provenance",
    ]  # fmt: skip


def test_equal_stores_give_equal_bytes(results, report, tmp_path):
    other = tmp_path / "results"
    other.mkdir()
    for folder in ("private", "runs/flows"):
        shutil.copytree(results / folder, other / folder)
    fill(other, made_up(Sources(other, SETTINGS, small=True).get("table2"))[::-1])
    assert html.write_report(Sources(other, SETTINGS, small=True)).read_bytes() == report.read_bytes()


def test_what_is_missing_is_said_with_its_command(page):
    text = page.text
    for name, command in {
        "fig2": "figure 2",
        "fig7": "figure 7",
        "solver_study": "experiment solver_study",
    }.items():
        command = f"Command: fracbench {command} dataset=synthetic parallel.jobs=1 --small"
        assert re.search(rf"Not computed yet: all of the \d+ points of {name}\. {re.escape(command)}", text), name
    assert "Not computed yet: the drawing of fig1. Command: fracbench figure 1" in text
    assert "points of table2" not in text
    assert "points of protocol_study" in text


def test_a_picture_that_is_there_is_shown(page):
    (drawn,) = [picture for picture in page.all("img") if picture["alt"].startswith("Figure 5")]
    assert (drawn["width"], drawn["height"]) == ("64", "32")
    assert "the drawing of fig5" not in page.text


def test_failed_points_are_said(tmp_path):
    source = Sources(tmp_path, SETTINGS, small=True).get("table2")
    fill(tmp_path, made_up(source, status="failed"))
    sources = Sources(tmp_path, SETTINGS, small=True)
    (said,) = exhibits.state(sources.get("table2"))
    assert said.markdown == f"{source.n_points} points of table2 failed or diverged; the first: made up"


def test_a_folder_that_cannot_be_used_is_said(tmp_path):
    (tmp_path / "runs").write_text("in the way")
    with pytest.raises(InputError, match=r"results folder .* cannot be created"):
        html.write_report(Sources(tmp_path, SETTINGS, small=True))


# -- verdicts ------------------------------------------------------------------------------------


def judged(*words, quote="the <b>quote</b>"):
    claim = Claim("id", quote, "Section 1", "the test", "rule", {})
    verdicts = [Verdict(name, word, f"because of {name}") for name, word in zip("xyz", words, strict=False)]
    return Judged(claim, tuple(verdicts))


def test_verdicts_are_counted_and_shown_with_their_evidence():
    section = sections.verdicts([judged("holds", "does not hold"), judged("holds in part", "does not hold")])
    _, tallies, table = section.blocks
    counts = {card.name: {word: number for word, _, number in card.counts} for card in tallies.cards}
    assert counts["x"] == {"holds": 1, "holds in part": 1, "does not hold": 0, "cannot be judged": 0}
    assert counts["y"]["does not hold"] == 2
    first = table.rows[0]
    assert [cell.text for cell in first] == ["“the <b>quote</b>”", "holds", "does not hold"]
    assert [cell.tone for cell in first[1:]] == ["holds", "fails"]
    assert first[1].note == "because of x" and first[1].badge
    assert first[0].note == "Section 1\nTest: the test"
    assert table.filters == ["holds", "holds in part", "does not hold"]
    order = [sections.verdicts([judged(word)]).blocks[2].rows[0][1].sort for word in sections.VERDICTS]
    assert order == ["0", "1", "2", "3"]


def test_a_claim_without_a_verdict_under_a_protocol_has_an_empty_cell():
    table = sections.verdicts([judged("holds", "holds"), judged("does not hold")]).blocks[2]
    assert table.rows[1][2] == Cell("")
    text = render_page("t", "l", [], [Section("a", "a", "a", [table])])
    assert re.search(r'<td data-label="y"></td>', text)


def test_words_of_the_paper_are_never_taken_for_html():
    text = render_page("t", "l", [], [sections.verdicts([judged("holds", quote="<script>alert(1)</script>")])])
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text


def test_the_page_judges_by_the_claims_of_the_project(page):
    assert f"{len(claims.load_claims())} sentences of the paper" in page.text
    assert "cannot be judged" in page.text  # results on scenes support no claim about Middlebury


# -- Table 2 -------------------------------------------------------------------------------------


def one_sequence(**ratios) -> pd.DataFrame:
    """Table 2 of one sequence, with AAE of TV-L1 and AAE, AEPE of TV-L1-SB off by given ratios."""
    published = pd.DataFrame(
        {"sequence": "venus", "method": ["tvl1", "tvl1_sb"], "aae": 1.0, "aepe": 2.0, "sdae": [3.0, 4.0]}
    )
    ours = published.assign(protocol="reference", part="reference")
    ours.loc[0, "aae"] = ratios.get("tvl1_aae", 1.0)
    ours.loc[1, "aae"] = ratios.get("sb_aae", 1.0)
    ours.loc[1, "aepe"] = 2.0 * ratios.get("sb_aepe", 1.0)
    return versus_published(ours, published)


@pytest.mark.parametrize(
    ("ratio", "tone"),
    [
        (1.05, "close"),
        (0.953, "close"),
        (1.051, "near"),
        (0.95, "near"),
        (1.1, "near"),
        (1.101, "far"),
        (0.09, "far"),
    ],
)
def test_cells_are_tinted_by_agreement(ratio, tone):
    table = sections._wide(one_sequence(sb_aae=ratio), "reference")
    cells = dict(zip([f"{column.group} {column.title}" for column in table.columns], table.rows[1], strict=True))
    assert cells["AAE, rad ratio"] == Cell(f"{ratio:.2f}", tone=tone)
    assert cells["AEPE, px ratio"] == Cell("1.00", tone="close")
    assert cells["AAE, rad paper"] == Cell("1.0000")


def test_the_smaller_error_is_bold():
    table = sections._wide(one_sequence(sb_aae=0.9, sb_aepe=1.2), "reference")
    assert [[row[3].tone, row[6].tone] for row in table.rows] == [["", "strong"], ["strong", ""]]


def test_scenes_have_no_column_of_the_paper():
    both = one_sequence().assign(published=np.nan, ratio=np.nan)
    assert [column.title for column in sections._wide(both, "reference").columns] == [
        "sequence", "method", "ours", "ours", "ours",
    ]  # fmt: skip


# -- figures and pictures ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "small", "ending"),
    [(SETTINGS, False, "_synthetic"), (SETTINGS, True, "_synthetic_small")],
)
def test_figures_of_another_size_or_data_set_are_left_alone(tmp_path, settings, small, ending):
    (tmp_path / "figures").mkdir()
    for stem in ("fig2", "fig2_reference", "fig2_context", "fig20_reference"):
        for suffix in ("", "_synthetic", "_small", "_synthetic_small"):
            (tmp_path / "figures" / f"{stem}{suffix}.png").touch()
    found = exhibits.figure_files(tmp_path, Sources(tmp_path, settings, small).get("fig2"))
    assert {variant: path.name for variant, path in found.items()} == {
        variant: f"fig2{'_' if variant else ''}{variant}{ending}.png" for variant in ("", "reference", "context")
    }
    assert list(found) == ["", "reference", "context"]


def test_a_damaged_figure_is_an_input_error(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"a\.png: cannot be read as a picture"):
        picture_file(tmp_path / "a.png", "words", "caption")


def test_a_flow_is_computed_once(tmp_path):
    sources = _tiny(tmp_path)
    wanted = gallery.missing_flows(sources)
    point, folder, path = wanted[0]
    gallery.compute_flow(point, folder, path)
    truth = gallery.point_arrays(point, None)[2]
    assert np.abs(gallery.read_flow(path) - truth).mean() < 0.5 * np.abs(truth).mean()
    assert gallery.missing_flows(sources) == wanted[1:]


def test_a_page_without_its_flows_names_the_command(tmp_path):
    sources = _tiny(tmp_path)
    missing = [block for block in exhibits.pictures(sources).blocks if isinstance(block, Missing)]
    assert missing == [
        Missing("6 flows", " ".join(["fracbench report", *SETTINGS, "n_warps=1 max_iter=20 --small"]))
    ]
    assert not any(isinstance(block, Gallery) for block in exhibits.pictures(sources).blocks)


def _tiny(results):
    return Sources(results, (*SETTINGS, "n_warps=1", "max_iter=20"), small=True)


@pytest.mark.parametrize(
    ("top", "expected"), [(0.0, 1.0), (0.19, 0.2), (0.2, 0.2), (0.21, 0.5), (4.9, 5.0), (7.0, 10.0), (20.0, 20.0)]
)
def test_the_shared_scale_is_round(top, expected):
    error = np.full((4, 5), top)
    error[0, :2] = np.nan, np.inf
    scene = gallery.Scene("s", (error, error), np.zeros((2, 4, 5)), [gallery.Estimate("e", error, error, 1.0)])
    assert gallery.shared_scale([scene, scene]) == pytest.approx(expected)


def test_error_pictures_run_from_dark_to_bright_and_know_the_unknown():
    picture = gallery.error_picture(np.array([[0.0, 1.0, 2.0, 9.0, np.inf, np.nan]]), 2.0)
    brightness = picture[0].astype(int).sum(axis=1)
    assert brightness[0] < brightness[1] < brightness[2]
    assert (picture[0, 2] == picture[0, 3]).all() and (picture[0, 2] == picture[0, 4]).all()
    assert len(set(picture[0, 5].tolist())) == 1 and picture[0, 5, 0] == 0x9E


def test_a_sequence_is_shown_in_three_rows(results):
    (first, second) = gallery.scenes(Sources(results, SETTINGS, small=True))
    shown = gallery.gallery(first, 1.0)
    titles = ["TV-L1, reference", "TV-L1-SB, reference", "TV-L1-SB-alpha, recommended (α = 1.1)"]
    error = "its error: mean 0.354 px"  # the flows are the truth moved by a quarter of a pixel along both axes
    assert [picture.caption for picture in shown.pictures] == [
        "first frame", "second frame", "true flow", *titles, *[error] * 3,
    ]  # fmt: skip
    assert len(shown.legend) == 2 and first.name != second.name


def test_large_pictures_are_scaled_down():
    image = np.zeros((300, 600, 3), np.uint8)
    assert photograph(image, "", "").size == (480, 240)
    assert drawing(image, "", "").size == (600, 300)
    assert photograph(image, "", "").uri.startswith("data:image/jpeg;base64,")


# -- prose, background ---------------------------------------------------------------------------


def test_markdown_keeps_to_the_page():
    text = markdown_html(
        "a [link](other.md), [the web](https://arxiv.org/x) <i>x</i>\n\n| a | b |\n|---|---|\n| 1 | 2 |\n"
    )
    assert "a link, " in text and "other.md" not in text and 'href="https://arxiv.org/x"' in text
    assert "&lt;i&gt;" in text
    assert text.index('<div class="scroll"') < text.index("<table") < text.index("</table>\n</div>")


def test_headings_are_put_below_those_of_the_section():
    assert demoted("# a\n\n## b\n\n`# c`\n#d", 2) == "### a\n\n#### b\n\n`# c`\n#d"


def test_the_errata_are_all_there(page):
    assert "the two double sums over the other pixels are added" in page.text
    assert "Item 3: when Jacobi diverges" in page.text


def test_open_parameters_are_those_the_paper_does_not_give():
    table = background._parameters()
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert rows["tol"][:2] == ["not given", "0.01"] and "max_iter" in rows and "upsample_gain" in rows
    assert "theta" not in rows and "lambda" not in rows
    marked = {row[0].text for row in table.rows if row[3].tone == "strong"}
    assert {"upsample_gain", "max_iter"} <= marked and "relinearise" not in marked


def test_provenance_comes_from_the_rows(tmp_path):
    source = Sources(tmp_path, SETTINGS, small=True).get("table2")
    first, second, *_ = rows = made_up(source)
    fill(tmp_path, [first])
    newer = {
        "created": "2025-01-02T00:00:00+00:00",
        "provenance": {**second.provenance, "cpu": "Zuse", "dirty": True},
    }
    fill(tmp_path, [row for row in made_up(source, **newer) if row.key != first.key])
    sources = Sources(tmp_path, SETTINGS, small=True)
    section = background.provenance([sources.get("table2"), sources.get("fig2")])
    text, table = section.blocks
    n = len(rows)
    assert f"{n} stored, {2 * n} s of computing" in text.markdown
    assert f"**Processor**: Zuse ({n - 1} points); Abacus (1 points)" in text.markdown
    assert "**Solver version**: 7\n" in text.markdown
    assert "`abababababab` with local changes" in text.markdown
    assert "2024-03-01 to 2025-01-02" in text.markdown
    cells = [[cell.text for cell in row] for row in table.rows]
    assert cells[0][:6] == ["table2", str(n), str(n), "0", str(2 * n), "2025-01-02"]
    assert cells[1][2] == "0" and cells[1][5] == ""


# -- in a browser --------------------------------------------------------------------------------

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PROBE = """
<script>
addEventListener("load", async () => {
  const found = {errors: window.problems, wide: document.documentElement.scrollWidth, width: innerWidth};
  const tables = Array.from(document.querySelectorAll("table"));
  const table = tables.find((one) => one.caption?.textContent.startsWith(CAPTION));
  const column = (i) => Array.from(table.tBodies[0].rows, (row) => row.cells[i].textContent);
  const heading = table.tHead.rows[table.tHead.rows.length - 1].cells[1];
  found.sorted = [column(1)];
  for (let i = 0; i < 2; i++) {
    heading.querySelector("button").click();
    found.sorted.push([heading.getAttribute("aria-sort"), ...column(1)]);
  }
  const filter = document.querySelector("form.filter");
  found.filtered = [];
  if (filter) {
    for (const [name, value] of FILTERS) {
      filter.elements[name].value = value;
      filter.dispatchEvent(new Event("input"));
      found.filtered.push(filter.querySelector("output").textContent);
    }
  }
  const images = Array.from(document.images);
  for (const image of images) image.loading = "eager";
  await Promise.all(images.map((image) => image.decode()));
  found.images = images.filter((image) => image.naturalWidth > 0).length;
  found.ground = getComputedStyle(document.body).backgroundColor;
  parent.postMessage(JSON.stringify(found), "*");
});
</script>
"""
WATCH = (
    '<script>window.problems = []; addEventListener("error", (e) => problems.push(String(e.message)));</script>'
)
FRAME = """<!doctype html><title>frame</title><pre id="found"></pre>
<script>
addEventListener("message", (event) => { document.getElementById("found").textContent = event.data; });
</script>
<iframe src="probed.html" width="390" height="800" style="border: 0"></iframe>"""


def probed(folder: Path, text: str, caption: str, *, filters=(), dark=False) -> tuple[dict, str]:
    """Open a page in a frame of 390 pixels; return the findings of a script in it, and Chromium's log."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed (Debian: apt-get install chromium)")
    script = PROBE.replace("CAPTION", json.dumps(caption)).replace("FILTERS", json.dumps(filters))
    text = text.replace("<style>", f"{WATCH}<style>", 1).replace("</body>", f"{script}</body>")
    (folder / "probed.html").write_text(text, encoding="utf-8")
    (folder / "frame.html").write_text(FRAME, encoding="utf-8")
    flags = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --enable-logging=stderr --virtual-time-budget=10000 --dump-dom"
    )
    command = [
        CHROMIUM,
        *flags.split(),
        f"--user-data-dir={folder / 'profile'}",
        f"--blink-settings=preferredColorScheme={0 if dark else 1}",
        (folder / "frame.html").as_uri(),
    ]
    for _ in range(
        5
    ):  # on a busy machine virtual time may run out while images are decoded, which takes real time
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        found = re.search(r'<pre id="found">(.+?)</pre>', done.stdout, re.DOTALL)
        if found:
            break
    assert found, f"the page did not load: {done.stdout[-500:]} {done.stderr[-2000:]}"
    return json.loads(markup.unescape(found[1])), done.stderr


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_report_works_in_a_browser(report, page, tmp_path, dark):
    text = report.read_text(encoding="utf-8")
    found, log = probed(tmp_path, text, "Experiments on this page", dark=dark)
    assert found["errors"] == [] and "CONSOLE" not in log
    assert found["width"] == 390 and found["wide"] <= 390
    assert found["images"] == len(page.all("img"))
    before, rising, falling = found["sorted"]
    assert rising == ["ascending", *sorted(before, key=int)] != ["ascending", *before]
    assert falling[0] == "descending" and falling[1:] == sorted(before, key=int, reverse=True)
    channels = [int(number) for number in re.findall(r"\d+", found["ground"])[:3]]
    assert (max(channels) < 64) if dark else (min(channels) > 192)


def test_tables_sort_and_filter(tmp_path):
    values = ["10", "9", "", "-1.5", "2e-3", "b", "A", "Grove10", "Grove2"]
    rows = [[Cell(f"row {i}"), Cell(value)] for i, value in enumerate(values)]
    rows.append([Cell("row last"), Cell("shown", sort="9.5")])
    table = Table("to sort", [Column("name"), Column("value")], rows)
    given = [judged("holds", "does not hold"), judged("holds in part", "does not hold", quote="second")]
    text = render_page("t", "l", [], [Section("a", "a", "a", [table]), sections.verdicts(given)])
    steps = {
        ("word", "holds"): 1,  # not the one that holds in part
        ("column", "2"): 0,
        ("word", "does not hold"): 2,
        ("text", "SECOND"): 1,
        ("column", "1"): 0,
        ("word", ""): 1,
    }
    found, log = probed(tmp_path, text, "to sort", filters=list(steps))
    assert found["errors"] == [] and "CONSOLE" not in log
    assert found["filtered"] == [f"{shown} of 2 shown" for shown in steps.values()]
    _, rising, falling = found["sorted"]
    assert rising == ["ascending", "-1.5", "2e-3", "9", "shown", "10", "A", "b", "Grove2", "Grove10", ""]
    assert falling == ["descending", "Grove10", "Grove2", "b", "A", "10", "shown", "9", "2e-3", "-1.5", ""]


def test_a_page_about_chosen_experiments_judges_no_claim(results):
    text = html.page(Sources(results, SETTINGS, small=True, only=["table2"]))
    chosen = Page(text)
    assert "chosen experiments" in chosen.text and "Table 2 beside the paper" in chosen.text
    assert "cannot be judged" not in chosen.text and "missing" not in chosen.text
