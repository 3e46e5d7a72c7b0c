"""What the board page says of the life of its phase: frozen, anonymous, a part, a late view."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.phase_settings import PhaseNow
from exceptiondrive_server.pages.numbers import minute
from exceptiondrive_server.pages.page_parts import Notice

if TYPE_CHECKING:
    from exceptiondrive_server.pages.board_page import BoardReading


def standing_notices(reading: "BoardReading") -> tuple[Notice, ...]:
    """Return a sentence for everything that a reader of this board should know of its phase."""
    if reading.board is None or reading.now is None or not reading.is_current:
        return ()
    return (*_late(reading.board, reading.has_late_view), *_kept_back(reading.board, reading.now))


def _late(board: Board, has_late_view: bool) -> Iterator[Notice]:
    if board.view == "late":
        words = (
            "This is the late view: entries that came after the deadline stand among the others, "
            "as they would rank. No rank of the board moves."
        )
        yield Notice(words, f"/?phase={board.phase}#board", "Show the board")
    elif has_late_view:
        words = "Entries that came after the deadline have a view of their own."
        yield Notice(words, f"/?phase={board.phase}&view=late#board", "Show the late view")


def _kept_back(board: Board, now: PhaseNow) -> Iterator[Notice]:
    if now.frozen_since is not None:
        words = (
            f"The board is frozen since {minute(now.frozen_since)}. Scoring goes on; what came "
            "later is shown when the organizers reveal the board."
        )
        yield Notice(words, "", "")
    if board.part == "public":
        words = (
            f"This board counts {board.n_samples:,} samples, the public part of the split. "
            "The others count when the organizers reveal them after the deadline."
        )
        yield Notice(words, "", "")
    if now.families_shown_from is not None:
        yield Notice(f"Families are shown from {minute(now.families_shown_from)}.", "", "")
    if now.is_anonymous:
        words = "Teams and methods stand under pseudonyms until the organizers reveal them."
        yield Notice(words, "", "")
