"""The elements of a page: prose, tables, pictures; and the template that turns them into one HTML file."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from markdown_it import MarkdownIt
    from numpy.typing import NDArray

_TEMPLATES = Path(__file__).resolve().parent / "templates"
_WIDTH = 480  # of photographs, at most


@dataclass(frozen=True)
class Cell:
    """A cell of a table, with smaller text below.

    `tone` is its CSS class: a tint, or the colour of the badge that the text becomes. It sorts by its text unless
    `sort` is given.
    """

    text: str
    note: str = ""
    tone: str = ""
    badge: bool = False
    sort: str = ""


@dataclass(frozen=True)
class Column:
    """A column's heading, the heading above it that it may share, and whether it holds numbers."""

    title: str
    group: str = ""
    numeric: bool = False


@dataclass(frozen=True)
class Text:
    """Prose in Markdown; HTML in it is shown as text."""

    markdown: str
    role: str = ""


@dataclass(frozen=True)
class Table:
    """A table that can be sorted, and filtered where it names the words for it; a row's first cell names the row.

    The caption names its box for screen readers, too. As `cards`, for rows of sentences, rows become cards on a
    narrow screen.
    """

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    cards: bool = False
    filters: Sequence[str] = ()

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings above the headings, with the number of columns each spans; empty if there are none."""
        spans = [(name, len([*columns])) for name, columns in groupby(self.columns, lambda column: column.group)]
        return spans if any(name for name, _ in spans) else []


@dataclass(frozen=True)
class Picture:
    """An embedded picture: ``data:`` URI, words for readers who cannot see it, Markdown below, width and height.

    With `round`, only the disc in it is shown.
    """

    uri: str
    alt: str
    caption: str
    size: tuple[int, int]
    round: bool = False


@dataclass(frozen=True)
class Gallery:
    """Pictures in rows of three, with a legend above them."""

    label: str
    pictures: Sequence[Picture]
    legend: Sequence[Picture]


@dataclass(frozen=True)
class Missing:
    """Something that would stand here if it had been computed, and the command for it."""

    what: str
    command: str


@dataclass(frozen=True)
class Tally:
    """A card that counts the verdicts under one protocol: a line of text, and word, CSS class, number of each."""

    name: str
    text: str
    counts: Sequence[tuple[str, str, int]]


@dataclass(frozen=True)
class Tallies:
    """Cards side by side."""

    cards: Sequence[Tally]


@dataclass(frozen=True)
class Heading:
    """A heading inside a section."""

    text: str
    anchor: str


@dataclass(frozen=True)
class Details:
    """Blocks that are folded away until asked for."""

    summary: str
    blocks: Sequence[Block]


Block = Text | Table | Picture | Gallery | Missing | Tallies | Heading | Details


@dataclass(frozen=True)
class Section:
    """A part of the page, with its entry in the contents."""

    anchor: str
    entry: str
    title: str
    blocks: Sequence[Block]


def render_page(title: str, lead: str, facts: Sequence[tuple[str, str]], sections: Sequence[Section]) -> str:
    """Return the page as one HTML text that needs no other file; `facts` (name, value) stand below the title."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"kind": lambda block: type(block).__name__, "markdown": markdown_html}
    return environment.get_template("report.html.j2").render(
        title=title,
        lead=lead,
        facts=facts,
        sections=sections,
        css=(_TEMPLATES / "report.css").read_text(encoding="utf-8"),
        script=(_TEMPLATES / "report.js").read_text(encoding="utf-8"),
    )


def markdown_html(text: str) -> str:
    """Return Markdown as HTML; HTML in it is shown as text, and so are links to neighbours of its file."""
    # The page is one file: a link that leads neither to the web nor into the page would lead nowhere.
    return str(_markdown().render(re.sub(r"\[([^\]]*)\]\((?!https?://|#)[^)]*\)", r"\1", text)))


def plain(text: str) -> str:
    """Return Markdown that shows a text as it is, on one line: a name, an error, or another word of a store."""
    return re.sub(r"[\\`*_\[\]<>&|]", lambda match: f"&#{ord(match[0])};", " ".join(text.split()))


def code(text: str) -> str:
    """Return Markdown that shows a word as code, without its backticks."""
    return f"`{' '.join(text.replace('`', '').split())}`"


@lru_cache(maxsize=1)
def _markdown() -> MarkdownIt:
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table").disable("image")
    renderer: Any = parser.renderer
    # A table stands in a box of its own, so that it scrolls and not the page.
    renderer.rules["table_open"] = lambda *_: (
        '<div class="scroll" role="region" aria-label="table" tabindex="0">\n<table class="sortable prose">\n'
    )
    renderer.rules["table_close"] = lambda *_: "</table>\n</div>\n"
    return parser


def demoted(text: str, levels: int) -> str:
    """Return Markdown with its headings `levels` lower, so that they fit below a section's."""
    return re.sub(r"^(#+)(?= )", lambda match: "#" * min(len(match[1]) + levels, 6), text, flags=re.MULTILINE)


def photograph(image: NDArray[np.uint8], alt: str, caption: str) -> Picture:
    """Embed a frame or a map as JPEG in full colour, scaled down to `_WIDTH`."""
    from PIL import Image

    picture = Image.fromarray(image)
    if picture.width > _WIDTH:
        height = round(picture.height * _WIDTH / picture.width)
        picture = picture.resize((_WIDTH, height), Image.Resampling.BOX)
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=85, subsampling=0)
    return Picture(_uri(buffer.getvalue(), "jpeg"), alt, caption, picture.size)


def drawing(image: NDArray[np.uint8], alt: str, caption: str, *, disc: bool = False) -> Picture:
    """Embed a small picture as PNG."""
    from PIL import Image

    picture, buffer = Image.fromarray(image), io.BytesIO()
    picture.save(buffer, "PNG")
    return Picture(_uri(buffer.getvalue(), "png"), alt, caption, picture.size, disc)


def picture_file(path: Path, alt: str, caption: str) -> Picture:
    """Embed a PNG file, byte by byte."""
    from PIL import Image, UnidentifiedImageError

    try:
        content = path.read_bytes()
        with Image.open(io.BytesIO(content)) as picture:
            return Picture(_uri(content, "png"), alt, caption, picture.size)
    except (OSError, UnidentifiedImageError) as exc:
        raise InputError(f"{path}: cannot be read as a picture; draw the figure again") from exc


def _uri(content: bytes, media: str) -> str:
    return f"data:image/{media};base64,{base64.b64encode(content).decode('ascii')}"
