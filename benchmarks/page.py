"""The board page with 1,000 entries: CPU time of the server, calls, files, and weight.

Run: `python -m benchmarks.page`. The invented entries carry every interval that a real board has.
"""

import gzip
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import FrameType

from benchmarks.report import ms, show
from benchmarks.timing import cpu_seconds
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.board import Board, BoardEntry, FamilyCell, FamilyHead
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_server.boards.page import BoardPage, forget_shown_boards
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.responses import Site
from exceptiondrive_server.web.templating import render

ENTRIES = 1000
GROWTH = (100, 1_000, 10_000)
ROUNDS = 9
_ROOT = Path(__file__).parents[1]
_OURS = (str(_ROOT / "server"), str(_ROOT / "schemas"))
AT = datetime(2026, 11, 21, tzinfo=UTC)


def big_board(protocol: ProtocolDocument, n_entries: int = ENTRIES) -> Board:
    """Return a board of invented entries."""
    families = tuple(FamilyHead(id=f.id, title=f.title, n=70) for f in protocol.families)
    return Board(
        challenge=PLANNING.id,
        phase="bench",
        split=SplitRef(name="bench", revision="sha256:" + "3f9a" * 16),
        protocol=ProtocolRef(version=protocol.version, digest=protocol.digest),
        headline=protocol.grading.headline,
        board=2,
        published_at=AT,
        n_samples=420,
        confidence=protocol.ranking.confidence,
        families=families,
        entries=tuple(_entry(number, n_entries, protocol) for number in range(n_entries)),
    )


def _entry(number: int, n_entries: int, protocol: ProtocolDocument) -> BoardEntry:
    hcc = round(0.95 - 0.9 * number / n_entries, 4)
    row: dict[str, float | None] = {
        "hcc": hcc, "ur": round(0.97 - hcc, 4), "hpr": round(0.8 * hcc, 4),
        "cts": 2.31, "cts_x": 2.04, "cts_y": 0.33,
    }  # fmt: skip
    intervals = {key: (round(v - 0.03, 4), round(v + 0.03, 4)) for key, v in row.items() if v}
    cell = FamilyCell.model_validate({"n": 70, **row, "intervals": intervals})
    return BoardEntry(
        source="scored",
        rank=number + 1,
        rank_interval=(max(1, number - 3), number + 4),
        previous_rank=number + 2,
        submission_id=f"s{number:07d}kq",
        method=f"Planner {number}",
        team=f"Team {number % 97}",
        description="An invented planner.",
        links=Links(paper="https://example.org/p", code="https://example.org/c"),
        submitted_at=AT,
        metrics=row,
        micro=row,
        macro_family=row,
        intervals=dict(intervals),
        families={family.id: cell for family in protocol.families},
        coverage={"edited": 1.0, "source": 1.0},
    )


def _page(board: Board, protocol: ProtocolDocument) -> bytes:
    page = BoardPage(BoardQuery.parse([]), (), None, board, protocol, ("1.0",), "1.0")
    site = Site("auto", "/", "board")
    return render("boards/board.html", site=site, page=page, own=None, wheel=None).encode()


def calls_in(work: Callable[[], object]) -> Counter[str]:
    """Return how often Python functions of this project are entered or resumed, by file.

    Functions of templates count, each under its template.
    """
    calls: Counter[str] = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(_OURS):
            calls[frame.f_code.co_filename] += 1

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return calls


def _first_page(board: Board, protocol: ProtocolDocument) -> bytes:
    forget_shown_boards()
    return _page(board, protocol)


def _calls(calls: Counter[str]) -> str:
    return f"{calls.total():,} calls in {len(calls)} files"


def _median_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(ROUNDS):
        started = time.process_time()
        work()
        times.append(1000 * (time.process_time() - started))
    return statistics.median(times)


def run(protocol: ProtocolDocument) -> None:
    """Print how the cost of a board grows with its entries, in the server."""
    _page(big_board(protocol, 10), protocol)  # compiles the templates
    rows = []
    for n_entries in GROWTH:
        made = big_board(protocol, n_entries)
        body = canonical_json(made)
        reading = cpu_seconds(partial(Board.model_validate_json, body))
        first = cpu_seconds(partial(_first_page, made, protocol))
        again = cpu_seconds(partial(_page, made, protocol))
        per_entry = f"{(reading + first) / n_entries * 1e6:.0f}"
        megabytes = f"{len(body) / 1e6:.1f}"
        rows.append((f"{n_entries:,}", megabytes, ms(reading), ms(first), per_entry, ms(again)))
    heads = ("entries", "MB", "read ms", "first page ms", "us an entry", "again ms")
    show("A board in the server as it grows", heads, rows)


def main() -> None:
    """Print the figures."""
    protocol = packaged_protocol()
    body = canonical_json(big_board(protocol)).decode("utf-8")
    board = Board.model_validate_json(body)
    html = _page(board, protocol)  # compiles the templates, as the start of a server does
    read_ms = _median_ms(lambda: Board.model_validate_json(body))
    first_ms = _median_ms(lambda: _first_page(board, protocol))
    again_ms = _median_ms(lambda: _page(board, protocol))
    first = calls_in(lambda: _first_page(board, protocol))
    again = calls_in(lambda: _page(board, protocol))
    rows = (
        (f"board of {ENTRIES:,} entries", f"{len(body) / 1000:.0f} kB"),
        ("read in the background, once", f"{read_ms:.1f} ms"),
        ("page, asked for first", f"{first_ms:.1f} ms, {_calls(first)}"),
        ("page, asked for again", f"{again_ms:.1f} ms, {_calls(again)}"),
        ("page", f"{len(html) / 1000:.1f} kB, {len(gzip.compress(html)) / 1000:.1f} kB compressed"),
    )
    for name, figure in rows:
        sys.stdout.write(f"{name:<34}{figure}\n")


if __name__ == "__main__":
    main()
