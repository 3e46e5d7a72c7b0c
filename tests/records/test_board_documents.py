"""The document of a board is read and written entry by entry: same values, same bytes, little memory."""

import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from typing import Any
from unittest.mock import Mock

import pytest
from pydantic import ValidationError
from tests.support.documents import make_board

from exceptiondrive_records.boards import boards
from exceptiondrive_records.boards.documents import entries_of, entry_documents, read_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_schemas.base import canonical_json, content_digest
from exceptiondrive_schemas.board import Board, BoardEntry, FamilyCell
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import Flag
from exceptiondrive_worker.boards.run import with_previous_ranks

KEYS = PLANNING.metric_keys
NASTY = 'a "entries":[{} \\ planner, "entries":[] \n \u2028 \U0001f697'
N_ENTRIES = 500
MOST_KEPT = 3
"""Bytes of a board in memory by byte of its document."""
MOST_TO_READ = 3.5
MOST_TO_WRITE = 2.5
MOST_OF_RANKS = 0.5


def entry(number: int, **changes: Any) -> BoardEntry:
    row = {key: (number * 37 + place) % 10_000 / 10_000 for place, key in enumerate(KEYS)}
    intervals = {key: (round(number % 90 / 100, 2), 0.95) for key in KEYS[:7]}
    cell = FamilyCell.model_validate({"n": 80, **row, "intervals": intervals})
    fields: dict[str, Any] = {
        "source": "scored",
        "rank": number + 1,
        "rank_interval": (1, 1),
        "submission_id": f"s{number}",
        "method": f"Planner {number}",
        "team": f"Team {number % 97}",
        "submitted_at": datetime(2026, 1, 1, tzinfo=UTC),
        "metrics": row,
        "micro": row,
        "macro_family": row,
        "intervals": intervals,
        "families": {family.id: cell for family in packaged_protocol().families},
        "coverage": {"edited": 1.0, "source": 1.0},
    }
    return BoardEntry(**fields | changes)


def board_of(*entries: BoardEntry) -> Board:
    return make_board(*entries, board=7)


NASTY_BOARD = board_of(
    entry(0, method=NASTY, links=Links(paper="https://example.org/p"), cite=NASTY),
    entry(1, intervals={"hcc": (-0.0, 1.0), "ur": (0.0, 1.0), "cts": None}),
    entry(2, metrics={"hcc": -0.0, "ur": 0.0, "cts": 1.0}, rank_interval=(1, 1)),
    entry(3, intervals={"hcc": (1.0, 1.0)}, rank=None, rank_interval=None, team=NASTY),
    entry(4, flags=(Flag(code="x", label="X", detail=NASTY),), is_late=True, previous_rank=1),
)


@pytest.mark.parametrize("board", [board_of(), board_of(entry(0)), NASTY_BOARD])
def test_a_board_is_read_and_written_to_the_same_bytes(board: Board) -> None:
    body = canonical_json(board).decode()
    read = read_board(body)
    assert read == Board.model_validate_json(body) == board
    assert b"".join(read.canonical_pieces()).decode() == canonical_json(read).decode() == body
    assert tuple(entries_of(body)) == read.entries
    documents = [row.model_dump(mode="json", by_alias=True) for row in board.entries]
    assert list(entry_documents(body)) == documents


def test_the_digest_of_a_board_is_that_of_what_it_says() -> None:
    document = NASTY_BOARD.model_dump(mode="json", by_alias=True)
    del document["board"], document["published_at"]
    assert NASTY_BOARD.content_digest == content_digest(document)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda body: body[:-40],
        lambda body: body.replace('"entries"', '"rows"'),
        lambda body: body.replace('"team"', '"crew"', 1),
        lambda body: body.replace('"n_samples":3', '"n_samples":"3"'),
        lambda body: body.replace('},{"cite"', '}{"cite"'),
        lambda body: body.replace("}]", "},]"),
        lambda _: "",
    ],
)
def test_what_is_no_board_is_refused_as_ever(spoil: Callable[[str], str]) -> None:
    with pytest.raises(ValidationError):
        read_board(spoil(canonical_json(NASTY_BOARD).decode()))


def test_a_board_of_a_newer_worker_is_read_without_what_is_not_known() -> None:
    body = canonical_json(NASTY_BOARD).decode()
    newer = body.replace('{"cite"', '{"added_later":[1],"cite"').replace(
        '{"board"', '{"added":1,"board"'
    )
    assert newer.count("added") == 1 + len(NASTY_BOARD.entries)
    for read in (read_board(newer), board_of(*entries_of(newer))):
        assert canonical_json(read).decode() == body


def test_a_board_with_blanks_is_read() -> None:
    body = canonical_json(NASTY_BOARD).decode()
    assert read_board(body.replace('},{"cite"', '} , {"cite"')) == NASTY_BOARD


def test_a_long_board_takes_a_few_times_its_document() -> None:
    body = canonical_json(board_of(*(entry(number) for number in range(N_ENTRIES)))).decode()
    read_board(body)  # what is made once is made by now
    tracemalloc.start()
    try:
        board = read_board(body)
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        assert "".join(piece.decode() for piece in board.canonical_pieces()) == body
        peak_written = tracemalloc.get_traced_memory()[1] - kept
    finally:
        tracemalloc.stop()
    found = [round(each / len(body), 2) for each in (kept, peak, peak_written)]
    assert found[0] <= MOST_KEPT, found
    assert found[1] <= MOST_TO_READ, found
    assert found[2] <= MOST_TO_WRITE, found


def test_ranks_of_the_board_before_are_read_without_keeping_its_entries() -> None:
    body = canonical_json(board_of(*(entry(number) for number in range(N_ENTRIES)))).decode()
    last = entry(N_ENTRIES - 1, rank=1)
    tracemalloc.start()
    try:
        (row,) = with_previous_ranks((last,), None, body)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert row.previous_rank == N_ENTRIES
    assert peak < MOST_OF_RANKS * len(body), peak / len(body)


def test_all_who_ask_for_a_new_board_at_once_get_the_same_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(boards, "_PARSED", Memory(1))
    read = Mock(wraps=read_board)
    monkeypatch.setattr(boards, "read_board", read)
    body = canonical_json(NASTY_BOARD).decode()
    row = BoardRow(body=body, body_digest="d", published_at=NASTY_BOARD.published_at)
    monkeypatch.setattr(BoardRow, "told_at", NASTY_BOARD.published_at)
    monkeypatch.setattr(BoardRow, "forgotten", None)
    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(boards.parsed_board, [row] * 8))
    assert all(each is found[0] for each in found)
    assert read.call_count == 1


def test_the_boards_of_a_big_year_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists of a team ask for them in turn: were one too many, each would be read for every list."""
    monkeypatch.setattr(boards, "_PARSED", Memory(boards._PARSED._room))
    read = Mock(wraps=read_board)
    monkeypatch.setattr(boards, "read_board", read)
    entry = NASTY_BOARD.entries[0].model_copy(update={"description": "x" * 1_800_000})
    body = canonical_json(NASTY_BOARD.model_copy(update={"entries": (entry,)})).decode()
    monkeypatch.setattr(BoardRow, "told_at", NASTY_BOARD.published_at)
    monkeypatch.setattr(BoardRow, "forgotten", None)
    for number in [*range(7)] * 2:
        row = BoardRow(body=body, body_digest=f"d{number}", published_at=NASTY_BOARD.published_at)
        boards.parsed_board(row)
    assert read.call_count == 7
