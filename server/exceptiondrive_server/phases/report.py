"""The final report of a phase, made from its published boards only."""

from collections import Counter
from datetime import timedelta

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import (
    board_at,
    current_board,
    find_board,
    last_shown_of_part,
    parsed_board,
    served_body,
    was_shown,
)
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.allowances import running_deadlines
from exceptiondrive_records.phases.policy import (
    frozen_since,
    has_closed,
    is_late,
    is_split_revealed,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.phase_report import PhaseReport, PlaceChange, ShakeUp
from exceptiondrive_schemas.api.submission import WAITING
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.board import Board
from exceptiondrive_server.boards.entry_facts import challenge_of, is_listed
from exceptiondrive_server.boards.queries import protocol_versions

N_PLACES = 3


def has_ended(session: Session, phase: Phase) -> bool:
    """Whether a phase is closed to every team, what came in time is scored, and its board is shown."""
    now = database_now(session)
    return (
        has_closed(phase, now)
        and not running_deadlines(session, phase)
        and frozen_since(phase, now) is None
        and phase.current_board_id is not None
        and not _waits_in_time(session, phase)
    )


def _waits_in_time(session: Session, phase: Phase) -> bool:
    waiting = (
        select(Submission)
        .where(Submission.phase_id == phase.id, Submission.status.in_(WAITING))
        .order_by(Submission.received_at)
    )
    return any(not is_late(phase, each) for each in session.scalars(waiting))


def report_of(session: Session, phase: Phase) -> PhaseReport:
    """Tell how a phase ended.

    Raises:
        NotFound: It has not ended.
    """
    row = current_board(session, phase.id)
    if row is None or not has_ended(session, phase):
        until = (
            " yet: it comes when all teams are done, what they sent in time is scored, "
            "and the board is shown"
        )
        raise NotFound("report of the phase", phase.id, until)
    board = parsed_board(row)
    scored = [entry for entry in board.entries if entry.source == "scored"]
    leading = [entry for entry in scored if entry.may_lead]  # the best first
    places = {entry.rank for entry in leading[:N_PLACES]}
    order = find_protocol(session, row.protocol_digest).ranking.order_of(challenge_of(board))
    could_be_first = board.contenders(order[0])
    before = board_before_reveal(session, phase, row)
    stood = select(func.count(BoardEntryRow.submission_id.distinct())).join(
        BoardRow, BoardRow.id == BoardEntryRow.board_id
    )
    boards = select(func.count(BoardFlip.board_id.distinct())).where(BoardFlip.phase_id == phase.id)
    assert phase.closes_at is not None
    return PhaseReport(
        phase=phase.id,
        title=phase.title,
        challenge=board.challenge,
        opened_at=phase.opens_at,
        closed_at=phase.closes_at,
        board=board.board,
        board_digest=bytes_digest(served_body(row).encode()),
        published_at=board.published_at,
        split=board.split,
        part=board.part,
        protocol=board.protocol,
        n_samples=board.n_samples,
        n_boards=session.scalar(boards) or 0,
        n_teams=len({entry.team for entry in scored}),
        n_submissions=session.scalar(stood.where(BoardRow.phase_id == phase.id, was_shown())) or 0,
        n_ranked=sum(entry.rank is not None for entry in scored),
        n_listed=sum(is_listed(entry) for entry in scored),
        winners=tuple(entry for entry in leading if entry.rank in places),
        may_be_first=tuple(
            entry.submission_id
            for entry in could_be_first
            if entry.submission_id and entry.may_lead
        ),
        flags=dict(Counter(flag.code for entry in scored for flag in entry.flags)),
        shake_up=None if before is None else _shake_up(session, parsed_board(before), board),
        protocols=protocol_versions(session, phase.id),
    )


def board_before_reveal(session: Session, phase: Phase, final: BoardRow) -> BoardRow | None:
    """Return the last board that readers saw before a reveal; None where nothing was revealed.

    Where both were, the other part of the split counts, not the end of a freeze; a freeze that ended
    before the deadline, or hid nothing, is no reveal. Of several the first one counts.
    """
    if is_split_revealed(session, phase):
        return last_shown_of_part(session, phase, "public")
    if phase.closes_at is None:
        return None
    ended = AuditLine.subject == phase.id, AuditLine.action == "freeze ended"
    after = select(AuditLine).where(*ended, AuditLine.at >= phase.closes_at)
    told = [line.detail for line in session.scalars(after.order_by(AuditLine.id))]
    if phase.unfrozen_at and any("board" not in each for each in told):  # by an earlier version
        row = board_at(session, phase.id, phase.unfrozen_at - timedelta.resolution)
        return None if row is final else row
    number = next((each["board"] for each in told if each["board"]), final.number)
    return None if number == final.number else find_board(session, phase.id, number)


def _shake_up(session: Session, before: Board, after: Board) -> ShakeUp:
    """Compare the ranks of planners: of one that another run stands for, too."""
    old, new = (
        {each.submission_id: each for each in board.entries if each.rank is not None}
        for board in (before, after)
    )
    query = select(Submission.id, Submission.team_id, Submission.method)
    changed = session.execute(query.where(Submission.id.in_(old.keys() ^ new.keys())))
    planner_of = {key: (team_id, method) for key, team_id, method in changed}
    gone = {planner_of[key]: key for key in old if key and key not in new}
    earlier = {key: key if key in old else gone.pop(planner_of[key], None) for key in new if key}

    def place(was: str | None, now: str | None) -> PlaceChange:
        entry = old[was] if now is None else new[now]
        return PlaceChange(
            submission_id=entry.submission_id or "",
            method=entry.method,
            team=entry.team,
            before=None if was is None else old[was].rank,
            after=None if now is None else new[now].rank,
            is_another_run=None not in (was, now) and was != now,
        )

    places = [place(was, now) for now, was in earlier.items()]
    lost = old.keys() - new.keys() - set(earlier.values())
    places += [place(key, None) for key in old if key in lost]
    return ShakeUp(board=before.board, part=before.part, places=tuple(places))
