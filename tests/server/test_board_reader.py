"""Boards are read before the first visitor asks."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_records.boards import boards
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_server.boards.reader import BoardReader

MakeEntry = Callable[..., BoardEntry]


def test_each_current_board_is_read_once_and_a_new_one_when_it_comes(
    api: Any, make_entry: MakeEntry
) -> None:
    reader = BoardReader(api.database)
    before = reader.read_new()
    api.publish(make_entry("One"))
    assert reader.read_new() == 1
    assert reader.read_new() == 0
    api.publish(make_entry("Two"))
    assert (before, reader.read_new()) == (0, 1)


def test_a_page_takes_the_board_that_was_read_ahead(
    api: Any, make_entry: MakeEntry, monkeypatch: pytest.MonkeyPatch
) -> None:
    api.publish(make_entry("Read ahead of all others"))
    BoardReader(api.database).read_new()
    monkeypatch.setattr(boards, "Board", None)  # nobody can read a board any more
    assert api.get("/leaderboard").status_code == 200


def test_it_reads_in_a_thread_of_its_own_and_ends_when_told(
    api: Any, make_entry: MakeEntry
) -> None:
    api.publish(make_entry("One"))
    has_read = threading.Event()
    reader = BoardReader(api.database, interval_s=0.01)

    def read_new() -> int:
        has_read.set()
        return 0

    reader.read_new = read_new  # type: ignore[method-assign]
    reader.start()
    assert has_read.wait(20)
    reader.stop()
    assert "board-reader" not in {thread.name for thread in threading.enumerate()}
