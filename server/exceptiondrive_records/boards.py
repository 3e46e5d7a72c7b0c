"""Boards: immutable snapshots; "the current board" is one pointer."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import func, or_, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import NotFound
from exceptiondrive_records.tables import (
    BoardFlip,
    BoardRequest,
    BoardRow,
    Phase,
    ScoreSheetRow,
    Submission,
    Team,
)
from exceptiondrive_schemas.base import canonical_json, content_digest
from exceptiondrive_schemas.board import Board, Links
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.submission import SubmissionStatus


@dataclass(frozen=True)
class EntryRecord:
    """What a board needs to know of one entry."""

    submission_id: str
    team: str
    team_slug: str
    is_reference: bool
    method: str
    description: str
    links: Links
    submitted_at: datetime
    file_digest: str
    sheet: ScoreSheet
    measurement_key: str
    exact_digest: str
    scorer_version: str


@dataclass(frozen=True)
class BoardClaim:
    """The lease of one build."""

    phase_id: str
    protocol_digest: str
    wanted: int
    fence: int
    claimed_at: datetime


def entries_for_board(session: Session, phase_id: str, protocol_digest: str) -> list[EntryRecord]:
    """Return the latest scored submission of each (team, method), in order of submission.

    A method whose latest submission was withdrawn falls back to the one before it.

    Raises:
        NotFound: No such phase.
    """
    phase = session.get(Phase, phase_id)
    if phase is None:
        raise NotFound("phase", phase_id)
    query = (
        select(Submission, Team, ScoreSheetRow)
        .join(Team, Team.id == Submission.team_id)
        .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
        .where(
            Submission.phase_id == phase_id,
            Submission.status == SubmissionStatus.SCORED,
            ScoreSheetRow.protocol_digest == protocol_digest,
            ScoreSheetRow.split_revision == phase.split_revision,
        )
        .order_by(Submission.received_at, Submission.id)
    )
    latest: dict[tuple[int, str], EntryRecord] = {}
    for submission, team, sheet in session.execute(query):
        latest[team.id, submission.method] = _entry(submission, team, sheet)
    return sorted(latest.values(), key=lambda entry: (entry.submitted_at, entry.submission_id))


def claim_board(
    session: Session, phase_id: str, protocol_digest: str, lease_s: float
) -> BoardClaim | None:
    """Lease the building of a board if one is wanted and nobody builds it."""
    now = database_now(session)
    taken = session.execute(
        update(BoardRequest)
        .where(
            BoardRequest.phase_id == phase_id,
            BoardRequest.protocol_digest == protocol_digest,
            BoardRequest.wanted > BoardRequest.built,
            or_(BoardRequest.lease_until.is_(None), BoardRequest.lease_until < now),
        )
        .values(
            fence=BoardRequest.fence + 1,
            lease_until=now + timedelta(seconds=lease_s),
            rung_at=None,
        )
        .returning(BoardRequest.wanted, BoardRequest.fence)
        .execution_options(synchronize_session=False)
    ).first()
    if taken is None:
        return None
    return BoardClaim(phase_id, protocol_digest, taken.wanted, taken.fence, now)


def release_board(session: Session, claim: BoardClaim) -> None:
    """Give a build up, so that the next ring may take it at once."""
    session.execute(
        update(BoardRequest)
        .where(
            BoardRequest.phase_id == claim.phase_id,
            BoardRequest.protocol_digest == claim.protocol_digest,
            BoardRequest.fence == claim.fence,
        )
        .values(lease_until=None)
    )


def publish_board(session: Session, claim: BoardClaim, board: Board) -> BoardRow | None:
    """Append a board and, under the phase's own protocol, make it the current one.

    Number and date are given here. A board that says what the latest one of this protocol says
    is not appended again.

    Returns:
        The row that holds the board; None when the lease was lost and nothing was recorded.
    """
    request = session.get(
        BoardRequest,
        (claim.phase_id, claim.protocol_digest),
        with_for_update=True,
        populate_existing=True,
    )
    if request is None or request.fence != claim.fence:
        audit(session, "worker", "stale fence rejected", f"board:{claim.phase_id}")
        return None
    request.built = claim.wanted
    request.lease_until = None
    phase = session.get(Phase, claim.phase_id, with_for_update=True, populate_existing=True)
    assert phase is not None
    row = _latest(session, claim)
    if row is None or row.digest != board.content_digest:
        row = _append(session, claim, board)
    if phase.protocol_digest == claim.protocol_digest:
        flip_board(session, phase, row)
    return row


def flip_board(session: Session, phase: Phase, row: BoardRow) -> None:
    """Point the phase at a board; the caller holds the lock of the phase."""
    if phase.current_board_id == row.id:
        return
    phase.current_board_id = row.id
    session.add(BoardFlip(phase_id=phase.id, board_id=row.id, at=database_now(session)))


def is_board_wanted(session: Session, phase_id: str, protocol_digest: str) -> bool:
    """Whether a newer board is wanted than was built."""
    request = session.get(BoardRequest, (phase_id, protocol_digest))
    return request is not None and request.wanted > request.built


def current_board(session: Session, phase_id: str) -> BoardRow | None:
    """Return the board that the phase shows now."""
    query = (
        select(BoardRow)
        .join(Phase, Phase.current_board_id == BoardRow.id)
        .where(Phase.id == phase_id)
    )
    return session.scalars(query).first()


def board_at(session: Session, phase_id: str, as_of: datetime) -> BoardRow | None:
    """Return the board that the phase showed at a time."""
    query = (
        select(BoardRow)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .where(BoardFlip.phase_id == phase_id, BoardFlip.at <= as_of)
        .order_by(BoardFlip.at.desc(), BoardFlip.id.desc())
        .limit(1)
    )
    return session.scalars(query).first()


def latest_board(session: Session, phase_id: str, protocol_digest: str) -> BoardRow | None:
    """Return the newest board of a phase under a protocol."""
    query = (
        select(BoardRow)
        .where(BoardRow.phase_id == phase_id, BoardRow.protocol_digest == protocol_digest)
        .order_by(BoardRow.number.desc())
        .limit(1)
    )
    return session.scalars(query).first()


def find_board(session: Session, phase_id: str, number: int) -> BoardRow:
    """Return a board by its permanent number.

    Raises:
        NotFound: There is none.
    """
    query = select(BoardRow).where(BoardRow.phase_id == phase_id, BoardRow.number == number)
    row = session.scalars(query).first()
    if row is None:
        raise NotFound("board", f"{phase_id}/{number}")
    return row


def list_boards(session: Session, phase_id: str) -> list[BoardRow]:
    """Return all boards of a phase, newest first."""
    query = select(BoardRow).where(BoardRow.phase_id == phase_id)
    return list(session.scalars(query.order_by(BoardRow.number.desc())))


def _latest(session: Session, claim: BoardClaim) -> BoardRow | None:
    return latest_board(session, claim.phase_id, claim.protocol_digest)


def _append(session: Session, claim: BoardClaim, board: Board) -> BoardRow:
    query = select(func.max(BoardRow.number)).where(BoardRow.phase_id == claim.phase_id)
    number = (session.scalar(query) or 0) + 1
    now = database_now(session)
    final = board.model_copy(update={"board": number, "published_at": now})
    row = BoardRow(
        phase_id=claim.phase_id,
        protocol_digest=claim.protocol_digest,
        split_revision=board.split.revision,
        number=number,
        digest=final.content_digest,
        body_digest=content_digest(final),
        body=canonical_json(final).decode("utf-8"),
        published_at=now,
    )
    session.add(row)
    session.flush()
    detail = {"number": number, "digest": row.digest, "protocol": claim.protocol_digest}
    audit(session, "worker", "board published", claim.phase_id, detail)
    return row


def _entry(submission: Submission, team: Team, row: ScoreSheetRow) -> EntryRecord:
    return EntryRecord(
        submission_id=submission.id,
        team=team.name,
        team_slug=team.slug,
        is_reference=team.is_reference,
        method=submission.method,
        description=submission.description,
        links=Links(paper=submission.paper_url, code=submission.code_url),
        submitted_at=submission.received_at,
        file_digest=submission.file_digest,
        sheet=row.sheet,
        measurement_key=row.measurement_key,
        exact_digest=row.exact_digest,
        scorer_version=row.scorer_version,
    )
