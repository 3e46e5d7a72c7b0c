"""What the entry and compare pages read from the records."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import (
    boards_by_protocol,
    boards_with,
    newest_board_with,
    parsed_board,
)
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import find_phase, list_phases
from exceptiondrive_records.phases.policy import is_anonymous, shown_sheet
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.drawings import entry_drawings
from exceptiondrive_records.splits.pictures import pictures_of
from exceptiondrive_records.splits.tables import SamplePictureRow, SplitRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.method_facts import EntryFacts, MethodFacts
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.boards.comparison import MAX_COMPARED, default_pair
from exceptiondrive_server.boards.entry_facts import find_entry, find_named
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.queries import (
    choose_board,
    choose_phase,
    facts_on,
    read_board,
    without_reported,
)
from exceptiondrive_server.boards.query import BoardQuery

MOST_PROTOCOLS = 8


@dataclass(frozen=True)
class PastPosition:
    """An entry on the newest board of one protocol that shows it, and on the oldest."""

    board: Board
    entry: BoardEntry
    first_board: Board
    first_entry: BoardEntry


@dataclass(frozen=True)
class EntryData:
    """What the records say of an entry."""

    board: Board
    entry: BoardEntry
    protocol: ProtocolDocument
    phase_title: str
    is_current: bool
    """Whether the board is the present one; else it is how the entry stood there."""
    sheet: ScoreSheet | None
    submission: Submission | None
    """What was uploaded, and when; None for reported entries and while names are hidden."""
    past: tuple[PastPosition, ...]
    drawings: EntryDrawings | None
    pictures: Mapping[str, tuple[SamplePictureRow, ...]]
    """Of the drawn samples, by their id."""
    told: EntryFacts
    """What the team tells of the method now."""
    is_withheld: bool
    """Whether the regions of its split are."""
    borrows_scenes: bool
    """Whether they are, and scenes of a public split can be shown in its place."""


def read_entry(session: Session, key: str, query: BoardQuery) -> EntryData:
    """Read an entry that stands, or stood, on a board.

    Raises:
        NotFound: No board shows it. Submissions that are on no board are their team's alone.
    """
    submission = _shown_submission(session, key)
    row, is_current = _board_with(session, key, submission, query)
    board = without_reported(parsed_board(row))
    entry = find_entry(board, key)
    phase = session.get(Phase, board.phase)
    if entry is None or phase is None:
        raise NotFound("entry", key)
    drawings = _drawings(session, submission, board) if submission else None
    drawn_ids = [each.drawing.sample_id for each in drawings.samples] if drawings else []
    is_withheld = not _is_public(session, phase)
    return EntryData(
        board=board,
        entry=entry,
        protocol=find_protocol(session, board.protocol.digest),
        phase_title=phase.title,
        is_current=is_current,
        sheet=_sheet(session, key, board) if submission else None,
        submission=None if is_anonymous(phase) else submission,
        past=_past_positions(session, submission) if submission else (),
        drawings=drawings,
        pictures=pictures_of(session, board.split, drawn_ids),
        told=facts_on(session, board).get(key, EntryFacts()),
        is_withheld=is_withheld,
        borrows_scenes=is_withheld and _borrows_scenes(session, phase),
    )


def _is_public(session: Session, phase: Phase) -> bool:
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    return split.public_file_digest is not None


def _borrows_scenes(session: Session, phase: Phase) -> bool:
    return CHALLENGES[phase.challenge].has_waypoints and any(
        CHALLENGES[each.challenge].has_waypoints and _is_public(session, each)
        for each in list_phases(session)
    )


def _shown_submission(session: Session, key: str) -> Submission | None:
    """Return a submission, unless its phase is hidden, which must look like a missing one."""
    submission = session.get(Submission, key)
    if submission is None:
        return None
    phase = session.get_one(Phase, submission.phase_id)
    return None if phase.visibility == "hidden" else submission


def _board_with(
    session: Session, key: str, submission: Submission | None, query: BoardQuery
) -> tuple[BoardRow, bool]:
    """The board asked for, else the current one, its late view, or the newest that shows the entry."""
    if submission is None or query.board is not None:
        asked_phase = query.phase or (submission.phase_id if submission else None)
        asked = BoardQuery(phase=asked_phase, board=query.board, protocol=query.protocol)
        with suppress(NotFound):  # what there is not would tell whether it was submitted, and where
            phase = choose_phase(session, asked)
            row = choose_board(session, phase, asked) if phase else None
            if phase is not None and row is not None:
                return row, row.id in (phase.current_board_id, phase.late_board_id)
        raise NotFound("entry", key)
    phase = find_phase(session, submission.phase_id)
    is_private = phase.policy.entries_private and submission.published_at is None
    if is_private or submission.status == SubmissionStatus.WITHDRAWN:
        raise NotFound("entry", key)
    now = boards_with(session, key, (phase.current_board_id, phase.late_board_id))
    if now:
        return now[0], True
    last = newest_board_with(session, submission.id)
    if last is None:
        raise NotFound("entry", key)
    return last, False


@dataclass(frozen=True)
class ComparedEntries:
    """A board, the entries of it that are compared, and the published sheet of each."""

    board: BoardPage
    entries: tuple[BoardEntry, ...]
    sheets: tuple[ScoreSheet | None, ...]


def read_comparison(
    session: Session, query: BoardQuery, pairs: Sequence[tuple[str, str]]
) -> ComparedEntries:
    """Read two or more entries of a board; without names the two best; none if there are none.

    The pairs are those of the address: `a`, `b` and any number of `more`, who step in where `a` or
    `b` is missing; empty ones are nobody.

    Raises:
        NotFound: A named entry does not stand on this board.
    """
    reading = read_board(session, query)
    board, given = reading.board, dict(pairs)
    if board is None:
        return ComparedEntries(reading, (), ())
    more = list(dict.fromkeys(value for key, value in pairs if key == "more" and value))
    first_two = [given.get(key) or (more.pop(0) if more else None) for key in ("a", "b")]
    named = [_require_entry(board, key) for key in first_two]
    rest = [_require_entry(board, key) for key in more]
    pair = _pair_to_compare(board, *named)
    if pair is None:
        return ComparedEntries(reading, (), ())
    others = [entry for entry in rest if entry and entry not in pair]
    entries = (*pair, *others)[:MAX_COMPARED]
    sheets = tuple(_sheet(session, entry.submission_id, board) for entry in entries)
    return ComparedEntries(reading, entries, sheets)


def _pair_to_compare(
    board: Board, a: BoardEntry | None, b: BoardEntry | None
) -> tuple[BoardEntry, BoardEntry] | None:
    """Those who are named, and the best who are not."""
    best = default_pair(board)
    if a and b:
        return a, b
    if best is None or not (a or b):
        return best
    other = best[1] if best[0] in (a, b) else best[0]
    return a or other, b or other


def _require_entry(board: Board, key: str | None) -> BoardEntry | None:
    entry = find_named(board, key) if key else None
    if key and entry is None:
        raise NotFound("entry on this board", key)
    return entry


def _sheet(session: Session, key: str | None, board: Board) -> ScoreSheet | None:
    """As it may be shown: families and tasks wait for their date; reported entries have none."""
    if key is None:
        return None
    row = session.get(ScoreSheetRow, (key, board.protocol.digest, board.split.revision))
    phase = session.get_one(Phase, board.phase)
    return shown_sheet(phase, row, database_now(session)) if row else None


def _past_positions(session: Session, submission: Submission) -> tuple[PastPosition, ...]:
    """Where the entry stands, or stood last, under each protocol that was ever shown; newest first."""
    rows = boards_by_protocol(session, submission, MOST_PROTOCOLS)
    found = (_standing(submission.id, first, last) for first, last in rows)
    return tuple(standing for standing in found if standing is not None)


def _standing(submission_id: str, first: BoardRow, last: BoardRow) -> PastPosition | None:
    board, first_board = parsed_board(last), parsed_board(first)
    entry, first_entry = (find_entry(each, submission_id) for each in (board, first_board))
    if entry is None or first_entry is None:
        return None
    return PastPosition(board, entry, first_board, first_entry)


def _drawings(session: Session, submission: Submission, board: Board) -> EntryDrawings | None:
    """Nothing of what was withdrawn is drawn, also where an old board names it."""
    if submission.status == SubmissionStatus.WITHDRAWN:
        return None
    return entry_drawings(session, submission.id, board.protocol.digest, board.split.revision)


class EntryView(BaseModel):
    """A row of a board with its score sheet, rounded as the protocol says."""

    phase: str
    board: int
    entry: BoardEntry
    sheet: ScoreSheet
    facts: MethodFacts = MethodFacts()
    """What the team tells of the method now."""
    edited_at: datetime | None = None
    """When the team last changed name, words, links or facts."""


def published_entry(session: Session, submission_id: str, query: BoardQuery) -> EntryView:
    """Return what the board of a number shows of a submission; without one, a current board or late view.

    Raises:
        NotFound: It does not stand there; the same whether or not it was submitted.
    """
    submission = _shown_submission(session, submission_id)
    if submission is None or query.phase not in (None, submission.phase_id):
        raise NotFound("entry", submission_id)
    row, is_current = _board_with(session, submission_id, submission, query)
    board = parsed_board(row)
    entry, sheet = find_entry(board, submission_id), _sheet(session, submission_id, board)
    if entry is None or sheet is None or not (is_current or query.board):
        raise NotFound("entry", submission_id)
    told = facts_on(session, board).get(submission_id, EntryFacts())
    return EntryView(
        phase=board.phase,
        board=board.board,
        entry=entry,
        sheet=sheet,
        facts=told.facts,
        edited_at=told.edited_at,
    )
