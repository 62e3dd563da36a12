"""The elements of a page: prose, tables, pictures; and the template that turns them into one HTML file."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from fracbench.errors import InputError

if TYPE_CHECKING:
    from markdown_it import MarkdownIt

_TEMPLATES = Path(__file__).resolve().parent / "templates"


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes
    ----------
    text : str
        The text.
    note : str
        Smaller text below.
    tone : str
        CSS class: a tint, or with `badge` the colour of the badge.
    badge : bool
        Whether the text is a badge.
    sort : str
        The sort key; the text if empty.
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

    kind: ClassVar[str] = "text"
    markdown: str
    role: str = ""

    @property
    def html(self) -> str:
        """The prose as HTML."""
        return markdown_html(self.markdown)


@dataclass(frozen=True)
class Table:
    """A table that can be sorted; the first cell of a row names the row.

    Attributes
    ----------
    caption : str
        The caption, which names its box for screen readers, too.
    columns : sequence of Column
        Headings.
    rows : sequence of sequence of Cell
        As long as `columns` each.
    cards : bool
        Whether rows become cards on a narrow screen: for rows of sentences.
    filters : sequence of str
        Words to filter rows by; empty for a table without a filter.
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    cards: bool = False
    filters: Sequence[str] = ()

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings above the headings, with the number of columns each spans; empty if there are none."""
        spans: list[tuple[str, int]] = []
        for column in self.columns:
            if spans and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        return spans if any(name for name, _ in spans) else []


@dataclass(frozen=True)
class Picture:
    """An embedded picture.

    Attributes
    ----------
    uri : str
        ``data:`` URI.
    alt : str
        Description for readers who cannot see it.
    caption : str
        Text below it, Markdown.
    size : (int, int)
        Width and height in pixels.
    round : bool
        Whether only the disc in it is shown.
    """

    kind: ClassVar[str] = "picture"
    uri: str
    alt: str
    caption: str
    size: tuple[int, int]
    round: bool = False

    @property
    def caption_html(self) -> str:
        """The caption as HTML."""
        return markdown_html(self.caption)


@dataclass(frozen=True)
class Gallery:
    """Pictures in rows of equal length, with a legend above them."""

    kind: ClassVar[str] = "gallery"
    label: str
    pictures: Sequence[Picture]
    legend: Sequence[Picture] = ()
    columns: int = 3


@dataclass(frozen=True)
class Missing:
    """Something that would stand here if it had been computed, and the command for it."""

    kind: ClassVar[str] = "missing"
    what: str
    command: str


@dataclass(frozen=True)
class Tally:
    """How often each verdict was given, for several protocols: one bar each.

    Attributes
    ----------
    name, text : str
        Heading of the card and the line below it.
    counts : sequence of (str, str, int)
        Word, CSS class, number.
    """

    name: str
    text: str
    counts: Sequence[tuple[str, str, int]]


@dataclass(frozen=True)
class Tallies:
    """Cards side by side."""

    kind: ClassVar[str] = "tallies"
    cards: Sequence[Tally]


@dataclass(frozen=True)
class Heading:
    """A heading inside a section."""

    kind: ClassVar[str] = "heading"
    text: str
    anchor: str


@dataclass(frozen=True)
class Details:
    """Blocks that are folded away until asked for."""

    kind: ClassVar[str] = "details"
    summary: str
    blocks: Sequence[Block]


Block = Text | Table | Picture | Gallery | Missing | Tallies | Heading | Details


@dataclass(frozen=True)
class Section:
    """A part of the page, with its entry in the contents."""

    anchor: str
    entry: str
    title: str
    blocks: Sequence[Block] = field(default_factory=list)


def render_page(title: str, lead: str, facts: Sequence[tuple[str, str]], sections: Sequence[Section]) -> str:
    """Return the page as one HTML text that needs no other file.

    Parameters
    ----------
    title : str
        Heading of the page.
    lead : str
        The introduction, in Markdown.
    facts : sequence of (str, str)
        Names and values below the heading.
    sections : sequence of Section
        Content, in order.

    Returns
    -------
    str
        HTML. Equal arguments give equal text.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(
        title=title,
        lead=markdown_html(lead),
        facts=facts,
        sections=sections,
        css=template_text("report.css"),
        script=template_text("report.js"),
    )


def template_text(name: str) -> str:
    """Return a file of the templates' folder: style sheet or script."""
    return (_TEMPLATES / name).read_text(encoding="utf-8")


def markdown_html(text: str) -> str:
    """Return Markdown (with tables) as HTML; links stay text unless they lead to the web or into the page.

    Parameters
    ----------
    text : str
        Markdown. HTML in it is shown as text.

    Returns
    -------
    str
        HTML; tables stand in a box of their own, so that they scroll and not the page.
    """
    return str(_markdown().render(text))


@lru_cache(maxsize=1)
def _markdown() -> MarkdownIt:
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table").disable("image")
    renderer: Any = parser.renderer
    renderer.rules["table_open"] = lambda *_: (
        '<div class="scroll" role="region" aria-label="table" tabindex="0">\n<table class="sortable prose">\n'
    )
    renderer.rules["table_close"] = lambda *_: "</table>\n</div>\n"
    validate = parser.validateLink
    # The page is one file: a link to a neighbour of the Markdown file would lead nowhere.
    parser.validateLink = lambda url: bool(re.match(r"https?://|#", url)) and validate(url)  # type: ignore[method-assign]
    return parser


def demoted(text: str, levels: int) -> str:
    """Return Markdown with its headings `levels` lower, so that they fit below a section's."""
    return re.sub(r"^(#+)(?= )", lambda match: "#" * min(len(match[1]) + levels, 6), text, flags=re.MULTILINE)


def embedded(image: Any, *, width: int = 0, lossy: bool = False) -> tuple[str, tuple[int, int]]:
    """Return a picture as a ``data:`` URI, and its size.

    Parameters
    ----------
    image : PIL.Image.Image or ndarray of uint8, (H, W) or (H, W, 3)
        The picture.
    width : int, optional
        Larger ones are scaled down to it; 0 for never.
    lossy : bool, optional
        JPEG with full colour, for frames and maps; PNG otherwise.

    Returns
    -------
    uri : str
        With media type and content.
    size : (int, int)
        Width and height in pixels.
    """
    from PIL import Image

    picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
    if width and picture.width > width:
        height = round(picture.height * width / picture.width)
        picture = picture.resize((width, height), Image.Resampling.BOX)
    buffer = io.BytesIO()
    if lossy:
        picture.save(buffer, "JPEG", quality=85, subsampling=0)
    else:
        picture.save(buffer, "PNG")
    media = "image/jpeg" if lossy else "image/png"
    return data_uri(buffer.getvalue(), media), picture.size


def embedded_file(path: Path) -> tuple[str, tuple[int, int]]:
    """Return a PNG file, byte by byte, as a ``data:`` URI, and its size.

    Raises
    ------
    InputError
        The file cannot be read or is no picture.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        content = path.read_bytes()
        with Image.open(io.BytesIO(content)) as picture:
            return data_uri(content, "image/png"), picture.size
    except (OSError, UnidentifiedImageError) as exc:
        raise InputError(f"{path}: cannot be read as a picture; draw the figure again") from exc


def data_uri(content: bytes, media: str) -> str:
    """Return bytes as a ``data:`` URI of a media type."""
    return f"data:{media};base64,{base64.b64encode(content).decode('ascii')}"
