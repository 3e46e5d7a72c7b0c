"""Render organizers' Markdown as safe HTML: parsed without raw HTML, then sanitized.

CommonMark with tables. Either library alone keeps scripts out; both are used in case one of them has
a fault (docs/decisions/0016-markdown.md).
"""

from functools import lru_cache
from itertools import pairwise

import nh3
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

_TAGS = {
    *("p", "br", "hr", "em", "strong", "s", "code", "pre", "blockquote", "a"),
    *("h2", "h3", "h4", "h5", "h6", "ul", "ol", "li", "table", "thead", "tbody", "tr", "th", "td"),
}
_DEEPEST = 6


_FOR_INBOXES = MarkdownIt("commonmark", {"html": False}).enable("table")
_MARKDOWN = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
_MARKDOWN.disable("image")  # a picture of another host tells it who reads


@lru_cache(maxsize=256)
def markdown(text: str, below: int = 2) -> Markup:
    """Return a text in Markdown as HTML: no raw HTML, picture, script or address but https and mailto.

    Its headings stand `below` the level of the heading over it, and skip none, whatever its author skips.
    """
    tokens = _MARKDOWN.parse(text)
    over: list[int] = []
    for token in tokens:
        if token.type == "heading_open":
            level = int(token.tag[1:])
            over = [*(each for each in over if each < level), level]
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(below + len(over), _DEEPEST)}"
    html = _MARKDOWN.renderer.render(tokens, _MARKDOWN.options, {})
    clean = nh3.clean(
        html,
        tags=_TAGS,
        attributes={"*": set(), "a": {"href"}, "ol": {"start"}},
        attribute_filter=_of_this_site_or_https,
        url_schemes={"https", "mailto"},
        link_rel="nofollow noopener noreferrer",
    )
    return Markup(clean.replace("<pre>", '<pre tabindex="0">'))  # a long line scrolls by keyboard


def _of_this_site_or_https(tag: str, attribute: str, value: str) -> str | None:
    """Leave out an address that borrows the scheme of the page, such as `//host/`."""
    return None if value.lstrip().startswith(("//", "\\", "/\\")) else value


@lru_cache(maxsize=256)
def first_paragraph(text: str) -> Markup:
    """Return the first paragraph of a text in Markdown, for a place that has no room for all of it."""
    return markdown(_first_paragraph(_MARKDOWN.parse(text)))


def plain_text(text: str) -> str:
    """Return a text in Markdown as plain paragraphs, for inboxes and mails: so is each item and each row."""
    blocks: list[str] = []
    mark = ""
    cells: list[str] | None = None
    for one in _FOR_INBOXES.parse(text):
        words = _plain(one.children) if one.children else one.content.strip()
        if one.type.startswith("list_item"):
            mark = f"{one.info}{one.markup} " if one.nesting == 1 else ""
        elif one.type == "tr_open":
            cells = []
        elif one.type == "tr_close":
            blocks.append(" | ".join(cells or ()))
            cells = None
        elif cells is not None and one.type == "inline":
            cells.append(words)
        elif words:
            blocks.append(mark + words)
            mark = ""
    return "\n\n".join(blocks)


def _plain(tokens: list[Token]) -> str:
    """Return words; the address of a link follows those that it stands behind."""
    words, address, start = "", "", 0
    for token in tokens:
        if token.type == "link_open":
            address, start = str(token.attrs["href"]), len(words)
        elif token.type == "link_close" and words[start:] != address.removeprefix("mailto:"):
            words += f" ({address})"
        words += "\n" if token.type in ("softbreak", "hardbreak") else token.content
    return words


def _first_paragraph(tokens: list[Token]) -> str:
    for opening, words in pairwise(tokens):
        if opening.type == "paragraph_open" and opening.level == 0:
            return words.content
    return ""
