"""Pages that are made of the project's own files: stored tables, protocols, the parser of the command line.

They are written below ``docs/generated`` before Sphinx reads its sources. Links that lead out of ``docs`` are
turned to the page that holds the file.
"""

from __future__ import annotations

import argparse
import re
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
from sphinx.application import Sphinx

from fracbench.commands.options import build_parser
from fracbench.figures.style import RC

ROOT = Path(__file__).parents[2]
TABLES = ROOT / "results" / "committed" / "tables"
#: Links of the documents that lead out of ``docs``, and their pages, seen from ``docs``.
PAGES = (
    (r"(?:\.\./)*results/committed/tables/(\w+)\.md", r"generated/tables/\1.md"),
    (r"(?:\.\./)*CONTRIBUTING\.md", "generated/contributing.md"),
    (r"(?:\.\./)*CHANGELOG\.md", "generated/changelog.md"),
    (r"(?:\.\./)*CITATION\.cff", "https://arxiv.org/abs/1512.01398"),
    (r"docs/(\w+)\.md", r"\1.md"),
)
#: The words of tables for readers of the site; every other table keeps its name.
TITLES = {"table1": "Table 1", "table2": "Table 2", "claims": "Claims", "answer": "Answer"}


def turned(text: str, depth: int = 0) -> str:
    """Return Markdown whose links lead to pages of the site, for a page `depth` folders below ``docs``."""
    for pattern, page in PAGES:
        up = "" if page.startswith("https") else "../" * depth
        text = re.sub(rf"\]\({pattern}(#[^)]*)?\)", rf"]({up}{page}\g<{page.count(chr(92)) + 1}>)", text)
    return text


def pages() -> dict[str, str]:
    """Return the text of each page by its path below ``docs/generated``."""
    found = {"commands.md": _commands(), "parts/claims.md": _claims(), "protocols.md": _protocols()}
    names = sorted(path.stem for path in TABLES.glob("*.md"))
    for name in names:
        text = (TABLES / f"{name}.md").read_text(encoding="utf-8")
        if not text.startswith("# "):
            text = f"# {TITLES.get(name, name)}\n\n{text}"
        found[f"tables/{name}.md"] = f"---\norphan: true\n---\n\n{turned(text, depth=2)}"
    listed = "\n".join(f"tables/{name}" for name in names)
    found["tables.md"] = (
        "# Stored tables\n\nThe tables of `results/committed`, as the last `make publish` wrote them.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"
    )
    text = (TABLES / "table2.md").read_text(encoding="utf-8")
    found["parts/table2.md"] = re.sub(r"^#", "##", text.partition("\n")[2], flags=re.MULTILINE)
    found["contributing.md"] = _document("CONTRIBUTING.md")
    found["changelog.md"] = _document("CHANGELOG.md")
    return found


def _document(name: str) -> str:
    return turned((ROOT / name).read_text(encoding="utf-8"), depth=1)


def _commands() -> str:
    parser = build_parser()
    (action,) = (each for each in parser._actions if isinstance(each, argparse._SubParsersAction))
    parts = ["# Command line", f"{parser.description}\n", f"{parser.epilog}.\n"]
    for name, sub in action.choices.items():
        if sub.description:
            parts += [f"## fracbench {name}", f"```text\n{_help(sub)}\n```"]
    return "\n\n".join(parts) + "\n"


def _help(parser: argparse.ArgumentParser) -> str:
    parser.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=100)
    return parser.format_help().rstrip()


def _claims() -> str:
    table = pd.read_csv(TABLES / "claims.csv", dtype=str).fillna("")
    protocols = list(dict.fromkeys(table["protocol"]))
    lines = [f"| {' | '.join(['the paper says', 'where', *protocols])} |", "| --- " * (2 + len(protocols)) + "|"]
    for _, rows in table.groupby("id", sort=False):
        first = rows.iloc[0]
        verdicts = dict(zip(rows["protocol"], rows["verdict"], strict=True))
        cells = [f"“{first['quote']}”", first["place"], *(verdicts.get(name, "") for name in protocols)]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    body = "\n".join(lines)
    return f":::{{container}} searchable\n\n{body}\n\n:::\n"


def _protocols() -> str:
    parts = [
        "# Protocols",
        "A protocol is a named set of parameters, a file of `conf/protocol`; `protocol=NAME` chooses it.\n",
    ]
    for path in sorted((ROOT / "conf" / "protocol").glob("*.yaml")):
        parts += [f"## {path.stem}", f"```yaml\n{path.read_text(encoding='utf-8').rstrip()}\n```"]
    return "\n\n".join(parts) + "\n"


def write_pages(app: Sphinx) -> None:
    """Write the pages; one whose text is the same is left alone, so that Sphinx does not read it again."""
    folder = Path(app.srcdir) / "generated"
    found = pages()
    for path in folder.rglob("*.md"):
        if path.relative_to(folder).as_posix() not in found:
            path.unlink()
    for name, text in found.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def read_source(app: Sphinx, name: str, source: list[str]) -> None:
    """Turn the links of a document, and those of the parts that it includes."""
    if not name.startswith(("generated/", "auto_gallery/")):
        source[0] = turned(source[0], depth=name.count("/"))


def read_include(app: Sphinx, _: Path, name: str, content: list[str]) -> None:
    """Turn the links of a file that the document `name` includes."""
    content[0] = turned(content[0], depth=name.count("/"))


def copy_gallery(source: Path, copy: Path) -> None:
    """Copy the gallery's scripts to a folder of their own, where what they write harms nobody."""
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(source, copy)


def house_look(_: Any, __: Any) -> None:
    """Give the gallery's figures the look of those of the tables and the report."""
    import matplotlib.pyplot as plt

    plt.rcdefaults()
    plt.rcParams.update({**RC, "figure.dpi": 100, "savefig.dpi": 160})


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the steps to Sphinx's events."""
    app.connect("builder-inited", write_pages)
    app.connect("source-read", read_source)
    app.connect("include-read", read_include)
    return {"parallel_read_safe": True}
