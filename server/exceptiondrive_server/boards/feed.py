"""An Atom feed of new boards."""

from dataclasses import dataclass
from datetime import datetime
from xml.etree import ElementTree as Xml

from exceptiondrive_schemas.printable import one_line
from exceptiondrive_server.web.numbers import iso

ATOM = "http://www.w3.org/2005/Atom"


@dataclass(frozen=True)
class BoardNote:
    """One published board, without its entries."""

    number: int
    digest: str
    protocol: str
    published_at: datetime


@dataclass(frozen=True)
class History:
    """The boards of a phase, newest first."""

    phase: str
    title: str
    boards: tuple[BoardNote, ...]


def atom_feed(history: History, site_url: str) -> str:
    """Write the feed of a phase."""
    Xml.register_namespace("", ATOM)
    root = Xml.Element(f"{{{ATOM}}}feed")
    _text(root, "title", f"ExceptionDrive: boards of {history.title}")
    _text(root, "id", f"{site_url}/feed.atom?phase={history.phase}")
    _link(root, f"{site_url}/feed.atom?phase={history.phase}", "self")
    _link(root, f"{site_url}/?phase={history.phase}", "alternate")
    epoch = "1970-01-01T00:00:00Z"
    _text(root, "updated", iso(history.boards[0].published_at) if history.boards else epoch)
    author = Xml.SubElement(root, f"{{{ATOM}}}author")
    _text(author, "name", "ExceptionDrive")
    for board in history.boards:
        _board(root, history, board, site_url)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + Xml.tostring(root, encoding="unicode")


def _board(root: Xml.Element, history: History, board: BoardNote, site_url: str) -> None:
    entry = Xml.SubElement(root, f"{{{ATOM}}}entry")
    address = f"{site_url}/?phase={history.phase}&board={board.number}"
    _text(entry, "title", f"Board {board.number} of {history.title}, protocol {board.protocol}")
    _text(entry, "id", address)
    _link(entry, address, "alternate")
    _text(entry, "updated", iso(board.published_at))
    _text(entry, "summary", f"Content {board.digest}.")


def _text(parent: Xml.Element, name: str, text: str) -> None:
    Xml.SubElement(parent, f"{{{ATOM}}}{name}").text = one_line(text)


def _link(parent: Xml.Element, address: str, relation: str) -> None:
    Xml.SubElement(parent, f"{{{ATOM}}}link", {"href": address, "rel": relation})
