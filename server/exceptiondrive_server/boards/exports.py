"""Boards as files: CSV for tools, LaTeX (booktabs) for papers, BibTeX for citations, an Atom feed."""

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from io import StringIO
from urllib.parse import quote, urlencode
from xml.etree import ElementTree as Xml

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.method_facts import NO_FACTS, EntryFacts, FactsOfBoard
from exceptiondrive_schemas.printable import one_line, spreadsheet_text
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.entry_facts import (
    board_fields,
    board_name,
    challenge_of,
    too_few_answers,
)
from exceptiondrive_server.boards.query import AVERAGE_TITLES, SOURCES
from exceptiondrive_server.web.numbers import Digits, day, iso, unit_of
from exceptiondrive_server.web.templating import https_only, template_filter

PAPER = """\
@misc{exceptiondrive,
  title  = {{ExceptionDrive: A Planning-Oriented Counterfactual Corner-Case Benchmark for Autonomous Driving}},
  author = {Luo, Ziyi and Sun, Zhe and Lu, Yehao and Zhou, Lei and Wu, Lisheng and Li, Xuewei and Qin, Zequn and Li, Xi},
  url    = {SITE/},
}
"""
ATOM = "http://www.w3.org/2005/Atom"
NOTHING_TOLD = EntryFacts()
_OF_ADDRESSES = ":/?#[]@!$&'()*+,;=%-._~"
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_TEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\textbraceleft{}",  # BibTeX counts an escaped brace as one
        "}": r"\textbraceright{}",
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        '"': "''",
    }
)


@dataclass(frozen=True)
class Export:
    """A kind of file: its media type and its writer (board, protocol, site's address, facts, citation of the benchmark)."""

    media_type: str
    write: Callable[[Board, ProtocolDocument, str, FactsOfBoard, str], str]


def permalink(board: Board, site_url: str) -> str:
    """Return the permanent address of a board; of a late view, which has none, that of the present one."""
    return f"{site_url}/?{urlencode(board_fields(board))}"


def file_name_header(board: Board, form: str) -> dict[str, str]:
    """Return the header that names the file of a board."""
    return {"Content-Disposition": f'attachment; filename="{_key(board)}.{form}"'}


def _key(board: Board) -> str:
    return f"exceptiondrive-{board.phase}-{board_name(board).lower().replace(' ', '-')}"


def tex_escape(text: str) -> str:
    """Return text that LaTeX prints as it is."""
    return one_line(text).translate(_TEX)


def in_blocks(board: Board) -> list[list[BoardEntry]]:
    """Return the entries of this board's own samples by source, in the order of the page."""
    blocks = [[e for e in board.entries if e.source == s] for s in SOURCES if s != "reported"]
    return [block for block in blocks if block]


def latex(
    board: Board,
    protocol: ProtocolDocument,
    site_url: str,
    facts: FactsOfBoard = NO_FACTS,
    citation: str = "",
) -> str:
    """Write a booktabs table: scored and reference rows apart, the leader bold, flags named."""
    challenge, digits = challenge_of(board), Digits.of(protocol.publication)
    leader = board.leader
    arrows = {"higher": r" $\uparrow$", "lower": r" $\downarrow$", None: ""}
    heads = [
        f"{_tex_label(m.label)} ({tex_escape(unit_of(m))}){arrows[m.better]}"
        for m in challenge.columns
    ]
    types = {id: told.facts.tag for id, told in facts.items() if told.facts.tag}
    names = [challenge.words.subject.capitalize(), *(["Type"] if types else [])]
    lines = [
        f"% {permalink(board, site_url)}",
        (
            f"% {board_name(board).lower()} of {day(board.published_at)}, split {board.split.name} "
            f"({board.n_samples} samples), protocol {board.protocol.version} "
            f"{board.protocol.digest}"
        ),
        f"% every number is the {AVERAGE_TITLES[board.headline]}",
        f"% leads: {one_line(leader.method) if leader else 'nobody'}",
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{r{'l' * len(names)}{'r' * len(heads)}}}",
        r"\toprule",
        " & ".join(["Rank", *names, *heads]) + r" \\",
    ]
    for block in in_blocks(board):
        lines.append(r"\midrule")
        for entry in block:
            cells = [digits.text(m, entry.metrics.get(m.key)) or "--" for m in challenge.columns]
            name = tex_escape(entry.method)
            name = rf"\textbf{{{name}}}" if entry is leader else name
            marks = [flag.label for flag in entry.flags]
            marks = marks if entry.source == "scored" else [entry.source, *marks]
            marks += ["late"] if entry.is_late else []
            marks += too_few_answers(entry, protocol.ranking, digits)
            name += f" ({tex_escape(', '.join(marks))})" if marks else ""
            told = [tex_escape(types.get(entry.submission_id or "", "--"))] if types else []
            lines.append(" & ".join([str(entry.rank or "--"), name, *told, *cells]) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", ""]
    return "\n".join(lines).replace("\u2212", "$-$")


def _tex_label(label: str) -> str:
    return f"CTS$_{label[3]}$" if len(label) == 4 and label.startswith("CTS") else label


def bibtex(
    board: Board,
    protocol: ProtocolDocument,
    site_url: str,
    facts: FactsOfBoard = NO_FACTS,
    citation: str = "",
) -> str:
    """Write a citation of the benchmark, as organizers set it or of its paper, and one of this very board."""
    at = board.published_at
    return (
        f"{(citation or PAPER.replace('SITE', site_url)).strip()}\n\n"
        f"@misc{{{_key(board)},\n"
        f"  title        = {{{{ExceptionDrive leaderboard, phase {board.phase}, "
        f"{board_name(board).lower()}}}}},\n"
        f"  year         = {{{at.year}}},\n"
        f"  month        = {_MONTHS[at.month - 1]},\n"
        f"  howpublished = {{\\url{{{permalink(board, site_url)}}}}},\n"
        f"  url          = {{{permalink(board, site_url)}}},\n"
        f"  note         = {{protocol {board.protocol.version}, {board.n_samples} samples, "
        f"published {day(at)}}},\n"
        "}\n"
    )


@template_filter
def entry_bibtex(board: Board, entry: BoardEntry, site_url: str) -> str:
    """Write a citation of an entry: by its paper, else its code, if its team links to one, and by this board."""
    at = entry.submitted_at or board.published_at
    here = f"{site_url}/entries/{entry.submission_id}?{urlencode(board_fields(board))}"
    own = https_only(entry.links.paper) or https_only(entry.links.code) or here
    return (
        f"@misc{{exceptiondrive-{entry.submission_id},\n"
        f"  title  = {{{{{tex_escape(entry.method)}}}}},\n"
        f"  author = {{{{{tex_escape(entry.team or 'Anonymous')}}}}},\n"
        f"  year   = {{{at.year}}},\n"
        f"  url    = {{{quote(own, safe=_OF_ADDRESSES)}}},\n"
        f"  note   = {{ExceptionDrive leaderboard, phase {board.phase}, {board_name(board).lower()}, protocol "
        f"{board.protocol.version}: \\url{{{permalink(board, site_url)}}}}},\n"
        "}\n"
    )


def comma_separated(
    board: Board,
    protocol: ProtocolDocument,
    site_url: str,
    facts: FactsOfBoard = NO_FACTS,
    citation: str = "",
) -> str:
    """Write one line per entry: fractions and metres as published, intervals, families, flags.

    The facts of the methods are those of this moment; `edited_at` says when a team changed them last.
    """
    address, text = permalink(board, site_url), StringIO()
    lines = csv.DictWriter(text, _columns(board), extrasaction="ignore", lineterminator="\n")
    lines.writeheader()
    for block in in_blocks(board):
        for entry in block:
            told = facts.get(entry.submission_id or "", NOTHING_TOLD)
            lines.writerow({**_csv_line(board, entry, address), **_fact_cells(told)})
    return text.getvalue()


def _columns(board: Board) -> list[str]:
    challenge = challenge_of(board)
    of_controls = [
        metric.key
        for metric in challenge.of_controls
        if any(metric.key in entry.micro for entry in board.entries)
    ]
    return [
        *(
            "phase",
            "board",
            "published_at",
            "protocol",
            "protocol_digest",
            "split",
            "split_revision",
            "n_samples",
        ),
        *("source", "rank", "rank_low", "rank_high"),
        *("submission_id", "method", "team", "submitted_at"),
        *(*challenge.metric_keys, *of_controls),
        *(f"{m.key}_{end}" for m in challenge.interval_metrics for end in ("low", "high")),
        *(f"{challenge.metrics[0].key}.{family.id}" for family in board.families),
        *("flags", "is_late", "leads", "unranked_because", "average", "board_url"),
        *_fact_cells(NOTHING_TOLD),
    ]


def _fact_cells(told: EntryFacts) -> dict[str, object]:
    """The facts of a method, one column each."""
    cells = {
        name: spreadsheet_text(value) if isinstance(value, str) else value
        for name, value in told.facts.cells.items()
    }
    return {**cells, "edited_at": iso(told.edited_at) if told.edited_at else None}


def _csv_line(board: Board, entry: BoardEntry, address: str) -> dict[str, object]:
    challenge = challenge_of(board)
    first = challenge.metrics[0].key
    low, high = entry.rank_interval or (None, None)
    intervals = {key: ends or (None, None) for key, ends in entry.intervals.items()}
    return {
        "phase": board.phase,
        "board": board.board,
        "published_at": iso(board.published_at),
        "protocol": board.protocol.version,
        "protocol_digest": board.protocol.digest,
        "split": board.split.name,
        "split_revision": board.split.revision,
        "n_samples": board.n_samples,
        "source": entry.source,
        "rank": entry.rank,
        "rank_low": low,
        "rank_high": high,
        "submission_id": entry.submission_id,
        "method": spreadsheet_text(entry.method),
        "team": spreadsheet_text(entry.team),
        "submitted_at": iso(entry.submitted_at) if entry.submitted_at else None,
        **entry.metrics,
        **{metric.key: entry.micro.get(metric.key) for metric in challenge.of_controls},
        **{f"{key}_low": ends[0] for key, ends in intervals.items()},
        **{f"{key}_high": ends[1] for key, ends in intervals.items()},
        **{f"{first}.{id}": cell.metrics.get(first) for id, cell in entry.families.items()},
        "flags": " ".join(flag.code for flag in entry.flags),
        "is_late": entry.is_late,
        "leads": entry is board.leader,
        "unranked_because": entry.unranked_because,
        "average": board.headline,
        "board_url": address,
    }


EXPORTS: Mapping[str, Export] = {
    "csv": Export("text/csv; charset=utf-8", comma_separated),
    "tex": Export("text/x-tex; charset=utf-8", latex),
    "bib": Export("text/x-bibtex; charset=utf-8", bibtex),
}


@dataclass(frozen=True)
class FeedItem:
    """Something that happened to a phase, in words."""

    at: datetime
    title: str
    path: str
    """The page that tells more."""
    mark: str = ""
    """Tells it from others of the same page, behind its path."""
    summary: str = ""
    """More than the title."""


@dataclass(frozen=True)
class Feed:
    """What happened to a phase: the boards that it showed, each as often as it did, news and dates."""

    phase: str
    title: str
    items: tuple[FeedItem, ...]


def atom_feed(feed: Feed, site_url: str) -> str:
    """Write the feed of a phase."""
    Xml.register_namespace("", ATOM)
    root = Xml.Element(f"{{{ATOM}}}feed")
    _add_text(root, "title", f"ExceptionDrive: {feed.title}")
    _add_text(root, "id", f"{site_url}/feed.atom?phase={feed.phase}")
    _add_link(root, f"{site_url}/feed.atom?phase={feed.phase}", "self")
    _add_link(root, f"{site_url}/?phase={feed.phase}", "alternate")
    times = [item.at for item in feed.items]
    _add_text(root, "updated", iso(max(times)) if times else "1970-01-01T00:00:00Z")
    author = Xml.SubElement(root, f"{{{ATOM}}}author")
    _add_text(author, "name", "ExceptionDrive")
    for item in feed.items:
        entry = Xml.SubElement(root, f"{{{ATOM}}}entry")
        _add_text(entry, "title", item.title)
        _add_text(entry, "id", f"{site_url}{item.path}{item.mark}")
        _add_link(entry, f"{site_url}{item.path}", "alternate")
        _add_text(entry, "updated", iso(item.at))
        _add_text(entry, "summary", item.summary or item.title)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + Xml.tostring(root, encoding="unicode")


def _add_text(parent: Xml.Element, name: str, text: str) -> None:
    Xml.SubElement(parent, f"{{{ATOM}}}{name}").text = one_line(text)


def _add_link(parent: Xml.Element, address: str, relation: str) -> None:
    Xml.SubElement(parent, f"{{{ATOM}}}link", {"href": address, "rel": relation})
