"""Boards as files."""

import csv
import io
import re
import shutil
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import pandas as pd
import pytest
from tests.server.pages.invented_board import KEYS

from exceptiondrive_records.boards.reported_files import read_rows
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING
from exceptiondrive_schemas.method_facts import EntryFacts, MethodFacts
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards import exports
from exceptiondrive_server.boards.exports import bibtex, comma_separated, latex, tex_escape

SITE = "https://board.test"


def test_latex_is_a_booktabs_table_with_the_published_digits(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    text = latex(lively_board, protocol, SITE)
    assert r"\toprule" in text
    assert text.count(r"\midrule") == 2
    published = ("61.40", "31.10", "52.71", "2.81", "2.44", "0.92")
    by_key = dict(zip(KEYS, published, strict=True))
    columns = CHALLENGES[lively_board.challenge].columns
    cells = [by_key.get(metric.key, "--") for metric in columns]  # of this board no other is told
    assert " & ".join(["1", r"\textbf{Kestrel-2}", *cells]) + r" \\" in text
    assert "6 & nerve (Blind to the edit) & 22.18" in text
    assert r" (62.00 \% answered) &" in text, "why it has no rank"
    assert "-- & FREEZE (reference, Stands still) & 97.20" in text
    assert "ST-P3" not in text
    assert f"{SITE}/?phase=sample&board=7" in text


SPECIAL = re.compile(r"(?<!\\)[#$%&_{}~^<>|\"]")
COMMANDS = re.compile(
    r"\\text(?:backslash|braceleft|braceright|asciitilde|asciicircum|less|greater|bar)\{\}|\\[&%$#_]|\\\\$"
)


def test_every_latex_row_has_the_columns_of_the_head_whatever_the_names_are(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    nasty = lively_board.entries[0].model_copy(
        update={"method": 'a&b \\ 5% of $x_1^2$ {#1} ~ <"|">\n\\end{tabular}'}
    )
    board = lively_board.model_copy(update={"entries": (nasty, *lively_board.entries[1:])})
    lines = [line for line in latex(board, protocol, SITE).splitlines() if "&" in line]
    table = [line for line in lines if not line.startswith("%")]
    assert len(table) == 1 + len([e for e in board.entries if e.source != "reported"])
    n_columns = 2 + len(CHALLENGES[board.challenge].columns)
    assert {len(re.findall(r"(?<!\\)&", line)) for line in table} == {n_columns - 1}
    name = table[1].split(" & ")[1].removeprefix(r"\textbf{").removesuffix("}")
    assert SPECIAL.search(COMMANDS.sub("", name)) is None
    assert "\\" not in COMMANDS.sub("", name)


@pytest.mark.parametrize("write", [latex, bibtex, comma_separated])
def test_every_file_says_which_board_it_is(
    lively_board: Board,
    protocol: ProtocolDocument,
    write: Callable[..., str],
) -> None:
    text = write(lively_board, protocol, SITE)
    assert f"{SITE}/?phase=sample&board=7" in text
    assert "1.0" in text
    assert "21 Nov 2026" in text or "2026-11-21T02:05:00Z" in text
    if write is not bibtex:
        assert protocol.digest in text


def test_the_table_has_the_bytes_that_pandas_writes(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    nasty = [
        entry.model_copy(update={"method": name, "team": "=1+1", "cite": None})
        for entry, name in zip(
            lively_board.entries,
            ('a "b", c', "two\nlines", "back\rward", " ", "x;y\tz"),
            strict=False,
        )
    ]
    board = lively_board.model_copy(
        update={"entries": (*nasty, *lively_board.entries[len(nasty) :])}
    )
    address = exports.permalink(board, SITE)
    told = {nasty[0].submission_id or "": EntryFacts(facts=MethodFacts(type="vla"))}
    lines = [
        {
            **exports._csv_line(board, entry, address),
            **exports._fact_cells(told.get(entry.submission_id or "", EntryFacts())),
        }
        for block in exports.in_blocks(board)
        for entry in block
    ]
    frame = pd.DataFrame(lines, columns=exports._columns(board), dtype=object)
    made = frame.to_csv(index=False, lineterminator="\n")
    assert comma_separated(board, protocol, SITE, told) == made


def test_names_cannot_break_out_of_latex() -> None:
    assert tex_escape("a_b & 50% \\input{x}\n$") == (
        r"a\_b \& 50\% \textbackslash{}input\textbraceleft{}x\textbraceright{} \$"
    )


def test_bibtex_cites_the_paper_and_this_very_board(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    text = bibtex(lively_board, protocol, SITE)
    assert text.count("@misc{") == 2
    assert "month        = nov," in text
    assert text.count("{") == text.count("}")
    assert r"\url{https://board.test/?phase=sample&board=7}" in text


def test_csv_holds_every_entry_with_stable_columns(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    rows = list(csv.DictReader(io.StringIO(comma_separated(lively_board, protocol, SITE))))
    assert len(rows) == len([e for e in lively_board.entries if e.source != "reported"])
    assert (rows[0]["phase"], rows[0]["board"]) == ("sample", "7")
    assert (rows[0]["rank"], rows[0]["hcc"], rows[0]["hcc_low"]) == ("1", "0.614", "0.573")
    assert rows[-1]["rank"] == ""
    assert {row["source"] for row in rows} == {"scored", "reference"}
    assert [row["method"] for row in rows if row["leads"] == "True"] == ["Kestrel-2"]
    assert (
        rows[6]["unranked_because"]
        == "62.00% of the samples as edited are answered; a rank needs 99%"
    )
    assert {row["average"] for row in rows} == {"macro_family"}


def test_csv_has_columns_for_what_a_board_can_tell(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    """No ends of what never has an interval; over-caution where a split has controls."""

    def rows_of(board: Board) -> list[dict[str, str]]:
        return list(csv.DictReader(io.StringIO(comma_separated(board, protocol, SITE))))

    (first, *_) = rows_of(lively_board)
    ends = {key.removesuffix("_low") for key in first if key.endswith("_low")} - {"rank"}
    assert ends == {metric.key for metric in PLANNING.interval_metrics}
    assert "over_caution" not in first
    entry = lively_board.entries[0]
    tried = entry.model_copy(update={"micro": {**entry.micro, "over_caution": 0.14}})
    changes = {"entries": (tried, lively_board.entries[1])}
    with_controls = lively_board.model_copy(update=changes)
    told, other, *_ = rows_of(with_controls)
    assert (told["over_caution"], other["over_caution"]) == ("0.14", "")
    assert told["hcc"] == first["hcc"]
    assert told["is_late"] == "False"
    imported, *_ = read_rows(comma_separated(with_controls, protocol, SITE), PLANNING)
    assert imported.metrics["hcc"] == float(first["hcc"]), "it can be imported beside another board"


@pytest.mark.parametrize("method", ["=1+1", "+A1", "-A1", "@SUM(A1)"])
def test_a_spreadsheet_never_runs_a_name(
    lively_board: Board, protocol: ProtocolDocument, method: str
) -> None:
    entry = lively_board.entries[0].model_copy(update={"method": method})
    board = lively_board.model_copy(update={"entries": (entry,)})
    row = next(csv.DictReader(io.StringIO(comma_separated(board, protocol, SITE))))
    assert row["method"] == "'" + method


@pytest.mark.parametrize("form", ["csv", "tex", "bib"])
async def test_exports_are_downloads_of_one_board(lively_site: Any, form: str) -> None:
    answer = await lively_site.get(f"/export/board.{form}?phase=sample&board=1")
    assert answer.status_code == 200
    assert answer.headers["content-disposition"] == (
        f'attachment; filename="exceptiondrive-sample-board-1.{form}"'
    )
    tag = answer.headers["etag"]
    again = await lively_site.get(f"/export/board.{form}?phase=sample&board=1", if_none_match=tag)
    assert (again.status_code, again.content) == (304, b"")


async def test_the_csv_of_page_and_api_is_the_same_file(lively_site: Any) -> None:
    page = await lively_site.get("/export/board.csv?phase=sample&board=1")
    api = await lively_site.get("/api/v1/leaderboard.csv?phase=sample&board=1", accept="*/*")
    assert page.content == api.content
    for name in ("etag", "content-disposition", "content-type"):
        assert page.headers[name] == api.headers[name]


async def test_an_unknown_export_is_not_found(lively_site: Any) -> None:
    assert (await lively_site.get("/export/board.xlsx")).status_code == 404


def compiled(tex: Path) -> tuple[bytes, str]:
    """Let a real LaTeX set a document; return the PDF and what was said."""
    if shutil.which("pdflatex") is None:
        pytest.skip("no LaTeX is installed on this machine")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", tex.name]
    done = subprocess.run(command, cwd=tex.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    return tex.with_suffix(".pdf").read_bytes(), done.stdout


@pytest.mark.parametrize("phase", ["sample", "strategy"])
async def test_the_latex_compiles(shown_site: Any, tmp_path: Path, phase: str) -> None:
    table = (await shown_site.get(f"/export/board.tex?phase={phase}")).text
    paper = tmp_path / "paper.tex"
    head = "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\n"
    paper.write_text(f"{head}{table}\\end{{document}}\n")
    pdf, said = compiled(paper)
    assert pdf[:5] == b"%PDF-"
    assert "Missing character" not in said


async def test_the_feed_lists_boards_newest_first(lively_site: Any, empty_board: Board) -> None:
    lively_site.publish(empty_board)
    answer = await lively_site.get("/feed.atom?phase=sample")
    assert answer.headers["content-type"].startswith("application/atom+xml")
    feed = Xml.fromstring(answer.text)
    name = {"a": "http://www.w3.org/2005/Atom"}
    titles = [entry.findtext("a:title", "", name) for entry in feed.findall("a:entry", name)]
    assert [title.split(" of ")[0] for title in titles] == ["Board 2", "Board 1"]
    newly = "1 newly ranked (brake-late to rank 3); 1 moved up (Kestrel-2 to rank 1);"
    assert f": {newly}" in titles[1], "a list of titles says what is new"
    said = [entry.findtext("a:summary", "", name) for entry in feed.findall("a:entry", name)]
    assert said[0].startswith("6 left. No planner is ranked on this board.")
    assert said[1].startswith(newly)
    assert said[1].endswith(" Protocol 1.0.")
    assert "Of 6 ranked planners, Kestrel-2 leads, though 1 other could be first: it" in said[1]
    assert feed.findtext("a:id", "", name) == "http://site.test/feed.atom?phase=sample"
    assert feed.findtext("a:title", "", name) == "ExceptionDrive: Sample"


def test_a_feed_is_as_new_as_the_newest_that_it_tells() -> None:
    opened, newer = datetime(2026, 11, 1, tzinfo=UTC), datetime(2026, 11, 9, tzinfo=UTC)
    items = [exports.FeedItem(at, "Something", "/phases/sample") for at in (opened, newer)]
    told = exports.Feed("sample", "Sample", tuple(items))
    feed = Xml.fromstring(exports.atom_feed(told, "http://site.test"))
    assert feed.findtext("{*}updated") == "2026-11-09T00:00:00Z"


async def test_a_feed_that_has_not_changed_is_not_sent_again(
    lively_site: Any, empty_board: Board
) -> None:
    asks = {"If-None-Match": (await lively_site.get("/feed.atom?phase=sample")).headers["etag"]}
    assert (await lively_site.get("/feed.atom?phase=sample", **asks)).status_code == 304
    lively_site.publish(empty_board)
    assert (await lively_site.get("/feed.atom?phase=sample", **asks)).status_code == 200


def test_facts_are_columns_and_no_formula(lively_board: Board, protocol: ProtocolDocument) -> None:
    first = lively_board.entries[0]
    assert first.submission_id is not None
    told = EntryFacts(
        facts=MethodFacts(
            type="other",
            type_note="=HYPERLINK(1)",
            sensors=("radar", "lidar"),
            extra_data_note="@cmd",
            hardware="+1 & 50% \\input{x}",
            parameters_millions=350,
        ),
        edited_at=datetime(2026, 11, 22, tzinfo=UTC),
    )
    facts = {first.submission_id: told}
    lines = list(csv.DictReader(io.StringIO(comma_separated(lively_board, protocol, SITE, facts))))
    row = next(line for line in lines if line["submission_id"] == first.submission_id)
    assert row["type_note"] == "'=HYPERLINK(1)"
    assert row["extra_data_note"] == "'@cmd"
    assert row["hardware"] == "'+1 & 50% \\input{x}"
    assert (row["type"], row["sensors"]) == ("other", "lidar radar")
    assert (row["parameters_millions"], row["open_code"]) == ("350.0", "")
    assert row["edited_at"] == "2026-11-22T00:00:00Z"
    table = latex(lively_board, protocol, SITE, facts)
    assert "& Type &" in table
    assert "=HYPERLINK(1) &" in table
    assert "Type" not in latex(lively_board, protocol, SITE)
