"""The documentation site that `make docs` has built: its links, and its pages in a browser."""

from __future__ import annotations

import html as markup
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from fracbench.harness.config.paths import checkout

SITE = (checkout() or Path()) / "build" / "site"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="`make docs` builds the site")

PROBE = """
<script>
const problems = [];
addEventListener("error", (event) => problems.push(String(event.message)));
addEventListener("load", async () => {
  const images = Array.from(document.images);
  for (const image of images) image.loading = "eager";
  await Promise.all(images.map((image) => image.decode().catch(() => problems.push("image " + image.src))));
  const field = document.querySelector(".searchable-field");
  const all = Array.from(document.querySelectorAll(".searchable tbody tr"));
  const rows = () => all.filter((row) => !row.hidden).length;
  const counts = [rows()];
  if (field) {
    field.value = "corners";
    field.dispatchEvent(new Event("input"));
    counts.push(rows());
  }
  setTimeout(() => parent.postMessage(JSON.stringify({
    problems, counts, wide: document.documentElement.scrollWidth, title: document.title,
    found: document.querySelectorAll("#search-results li").length,
    unnamed: images.filter((image) => !image.hasAttribute("alt")).map((image) => image.src),
  }), "*"), SEARCHES ? 3000 : 0);
});
</script>
"""
FRAME = """<!doctype html><title>frame</title><pre id="found"></pre>
<script>
addEventListener("message", (event) => { document.getElementById("found").textContent = event.data; });
</script>
<iframe src="PAGE" width="WIDTH" height="900" style="border: 0"></iframe>"""


class Links(HTMLParser):
    """The links, pictures and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        for name in ("href", "src"):
            if values.get(name):
                self.links.add(values[name])
        if values.get("id"):
            self.anchors.add(values["id"])


@pytest.fixture(scope="module")
def pages() -> dict[Path, Links]:
    return {
        path.resolve(): Links(path.read_text(encoding="utf-8"))
        for path in SITE.rglob("*.html")
        if "_static" not in path.parts
    }


def test_every_link_of_the_site_leads_somewhere(pages):
    assert len(pages) > 30
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or link == "#":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchors = pages[target].anchors if target in pages else None
            if not target.exists() or (parts.fragment and anchors is not None and parts.fragment not in anchors):
                broken.append(f"{path.relative_to(SITE.resolve())}: {link}")
    assert broken == []


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize(
    "page",
    [
        "index.html",
        "start.html",
        "answer.html",
        "auto_gallery/index.html",
        "auto_gallery/plot_01_first_flow.html",
        "generated/api/fracbench.estimate_flow.html",
        "generated/commands.html",
        "search.html?q=vorticity",
    ],
)
def test_a_page_works_in_a_browser(page, width, tmp_path):
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed (Debian: apt-get install chromium)")
    name, _, query = page.partition("?")
    site = tmp_path / "site"
    shutil.copytree(SITE, site)
    probe = PROBE.replace("SEARCHES", json.dumps(bool(query)))
    text = (site / name).read_text(encoding="utf-8")
    (site / name).write_text(text.replace("<head>", f"<head>{probe}", 1), encoding="utf-8")
    frame = FRAME.replace("PAGE", page).replace("WIDTH", str(width))
    (site / "frame.html").write_text(frame, encoding="utf-8")
    flags = (
        "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync "
        f"--window-size=1400,1000 --dump-dom --user-data-dir={tmp_path / 'profile'}"
    )
    command = [CHROMIUM, *flags.split(), (site / "frame.html").as_uri()]
    for attempt in range(6):  # virtual time may run out while images are decoded: then there is more of it
        budget = f"--virtual-time-budget={15_000 * 4**attempt}"
        done = subprocess.run(
            [*command[:-1], budget, command[-1]], capture_output=True, text=True, timeout=120, check=False
        )
        read = re.search(r'<pre id="found">(.+?)</pre>', done.stdout, re.DOTALL)
        if read:
            break
    assert read, f"the page did not load: {done.stderr[-2000:]}"
    found = json.loads(markup.unescape(read[1]))
    assert found["problems"] == [] and found["unnamed"] == []
    assert found["wide"] <= width
    assert "fracbench" in found["title"]
    if query:
        assert found["found"] > 0
    if page == "answer.html":
        every, some = found["counts"]
        assert every >= 39 and 0 < some < every
