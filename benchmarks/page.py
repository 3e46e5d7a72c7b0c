"""The board page of 100 to 10,000 entries: CPU time of the server, calls, and weight.

The invented entries carry every interval that a real board has.
"""

import gzip
import sys
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
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_server.boards import page as board_page
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.responses import Site
from exceptiondrive_server.web.templating import render

GROWTH = (100, 1_000, 10_000)
_ROOT = Path(__file__).parents[1]
_OURS = (str(_ROOT / "server"), str(_ROOT / "schemas"))
AT = datetime(2026, 11, 21, tzinfo=UTC)


def big_board(protocol: ProtocolDocument, n_entries: int = 1_000) -> Board:
    """Return a board of invented entries."""
    families = tuple(FamilyHead(id=f.id, title=f.title, n=70) for f in protocol.families)
    return Board(
        challenge=PLANNING.id,
        phase="bench",
        split=SplitRef(name="bench", revision="sha256:" + "3f9a" * 16),
        protocol=ProtocolRef.of(protocol),
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


def forget_shown_boards() -> None:
    """Forget what was made of boards, as after a start of the server."""
    board_page._MADE.make_room(2**40)
    board_page._metrics.cache_clear()
    board_page._scene.cache_clear()


def _first_page(board: Board, protocol: ProtocolDocument) -> bytes:
    forget_shown_boards()
    return _page(board, protocol)


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
        n_calls = calls_in(partial(_first_page, made, protocol)).total()
        kilobytes = len(gzip.compress(_page(made, protocol))) / 1e3
        rows.append(
            (
                f"{n_entries:,}",
                f"{len(body) / 1e6:.1f}",
                ms(reading),
                ms(first),
                per_entry,
                f"{n_calls:,}",
                ms(again),
                f"{kilobytes:.1f}",
            )
        )
    heads = (
        "entries",
        "MB",
        "read ms",
        "first page ms",
        "us an entry",
        "calls",
        "again ms",
        "gzip kB",
    )
    show("A board in the server as it grows", heads, rows)
