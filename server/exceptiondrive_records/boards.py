"""Boards: immutable snapshots; "the current board" is one pointer."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, Select, exists, func, or_, select, update
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
class LinkedRecord:
    """The scored counterpart of an entry, whether or not it is an entry itself."""

    submission_id: str
    method: str
    file_digest: str
    measurement_key: str


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
    linked: LinkedRecord | None = None


@dataclass(frozen=True)
class BoardClaim:
    """The lease of one build."""

    phase_id: str
    protocol_digest: str
    split_revision: str
    wanted: int
    fence: int
    claimed_at: datetime


def entries_for_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> list[EntryRecord]:
    """Return the latest scored submission of each (team, method), in order of submission.

    Without `split_revision`, against the one that the phase shows. A method whose latest
    submission was withdrawn falls back to the one before it.

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
        .where(*_scored_under(phase_id, protocol_digest, split_revision or phase.split_revision))
        .order_by(Submission.received_at, Submission.id)
    )
    latest: dict[tuple[int, str], EntryRecord] = {}
    scored: dict[str, LinkedRecord] = {}
    for submission, team, sheet in session.execute(query):
        linked = scored.get(submission.linked_to or "")
        latest[team.id, submission.method] = _entry(submission, team, sheet, linked)
        scored[submission.id] = _linked(submission, sheet)
    return sorted(latest.values(), key=lambda entry: (entry.submitted_at, entry.submission_id))


def entry_ids_for_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str
) -> set[str]:
    """Return the submissions of `entries_for_board`, without reading a sheet."""
    query = (
        select(Submission.team_id, Submission.method, Submission.id)
        .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
        .where(*_scored_under(phase_id, protocol_digest, split_revision))
        .order_by(Submission.received_at, Submission.id)
    )
    return set({(team, method): entry for team, method, entry in session.execute(query)}.values())


def _scored_under(
    phase_id: str, protocol_digest: str, split_revision: str
) -> tuple[ColumnElement[bool], ...]:
    return (
        Submission.phase_id == phase_id,
        Submission.status == SubmissionStatus.SCORED,
        ScoreSheetRow.protocol_digest == protocol_digest,
        ScoreSheetRow.split_revision == split_revision,
    )


def claim_board(
    session: Session,
    phase_id: str,
    protocol_digest: str,
    lease_s: float,
    split_revision: str | None = None,
) -> BoardClaim | None:
    """Lease the building of a board if one is wanted and nobody builds it."""
    now = database_now(session)
    if split_revision is None:
        split_revision = session.get_one(Phase, phase_id).split_revision
    taken = session.execute(
        update(BoardRequest)
        .where(
            BoardRequest.phase_id == phase_id,
            BoardRequest.protocol_digest == protocol_digest,
            BoardRequest.split_revision == split_revision,
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
    return BoardClaim(phase_id, protocol_digest, split_revision, taken.wanted, taken.fence, now)


def release_board(session: Session, claim: BoardClaim) -> None:
    """Give a build up, so that the next ring may take it at once."""
    session.execute(
        update(BoardRequest)
        .where(
            BoardRequest.phase_id == claim.phase_id,
            BoardRequest.protocol_digest == claim.protocol_digest,
            BoardRequest.split_revision == claim.split_revision,
            BoardRequest.fence == claim.fence,
        )
        .values(lease_until=None)
    )


def publish_board(session: Session, claim: BoardClaim, board: Board) -> BoardRow | None:
    """Append a board and, under the phase's own protocol and split, make it the current one.

    Number and date are given here. A board that says what the latest one of this protocol says
    is not appended again.

    Returns:
        The row that holds the board; None when the lease was lost and nothing was recorded.
    """
    request = session.get(
        BoardRequest,
        (claim.phase_id, claim.protocol_digest, claim.split_revision),
        with_for_update=True,
        populate_existing=True,
    )
    if request is None or request.fence != claim.fence:
        audit(session, "worker", "stale fence rejected", f"board:{claim.phase_id}")
        return None
    request.built = claim.wanted
    request.lease_until = None
    request.built_at = database_now(session)
    request.build_s = (request.built_at - claim.claimed_at).total_seconds()
    phase = session.get(Phase, claim.phase_id, with_for_update=True, populate_existing=True)
    assert phase is not None
    row = _latest(session, claim)
    if row is None or row.digest != board.content_digest:
        row = _append(session, claim, board)
    shown = (phase.protocol_digest, phase.split_revision)
    if shown == (claim.protocol_digest, claim.split_revision):
        flip_board(session, phase, row)
    return row


def flip_board(session: Session, phase: Phase, row: BoardRow) -> BoardFlip | None:
    """Point the phase at a board; the caller holds the lock of the phase.

    Returns:
        The flip; None when the phase showed this board already.
    """
    if phase.current_board_id == row.id:
        return None
    phase.current_board_id = row.id
    flip = BoardFlip(phase_id=phase.id, board_id=row.id, at=database_now(session))
    session.add(flip)
    session.flush()
    return flip


def is_board_wanted(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> bool:
    """Whether a newer board is wanted than was built."""
    if split_revision is None:
        split_revision = session.get_one(Phase, phase_id).split_revision
    request = session.get(BoardRequest, (phase_id, protocol_digest, split_revision))
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


def latest_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> BoardRow | None:
    """Return the newest board of a phase under a protocol (and split revision), drafts too."""
    return session.scalars(_newest_first(phase_id, protocol_digest, split_revision)).first()


def latest_public_board(session: Session, phase_id: str, protocol_digest: str) -> BoardRow | None:
    """Return the newest board of a phase under a protocol that was ever shown."""
    query = _newest_first(phase_id, protocol_digest, None).where(was_shown())
    return session.scalars(query).first()


def public_protocols(session: Session, phase_id: str) -> list[str]:
    """Return the digests of the protocols under which a board of the phase was ever shown."""
    query = select(BoardRow.protocol_digest).where(BoardRow.phase_id == phase_id, was_shown())
    return list(session.scalars(query.distinct()))


def public_board_with(
    session: Session,
    submission: Submission,
    *,
    oldest: bool = False,
    protocol_digest: str | None = None,
) -> BoardRow | None:
    """Return the newest (or the oldest) board that shows a submission and was ever shown itself.

    Drafts are for organizers alone.
    """
    query = select(BoardRow).where(
        BoardRow.phase_id == submission.phase_id,
        BoardRow.body.contains(submission.id, autoescape=True),
        was_shown(),
    )
    if protocol_digest is not None:
        query = query.where(BoardRow.protocol_digest == protocol_digest)
    if oldest:  # boards from before it came are not even looked at
        query = query.where(BoardRow.published_at >= submission.received_at)
    order = BoardRow.number.asc() if oldest else BoardRow.number.desc()
    return session.scalars(query.order_by(order).limit(1)).first()


def _newest_first(
    phase_id: str, protocol_digest: str, split_revision: str | None
) -> Select[BoardRow]:
    query = select(BoardRow).where(
        BoardRow.phase_id == phase_id, BoardRow.protocol_digest == protocol_digest
    )
    if split_revision is not None:
        query = query.where(BoardRow.split_revision == split_revision)
    return query.order_by(BoardRow.number.desc()).limit(1)


def was_shown() -> ColumnElement[bool]:
    """Condition on `BoardRow`: a phase pointed at it once. Drafts are for organizers alone."""
    return exists().where(BoardFlip.board_id == BoardRow.id)


def find_board(session: Session, phase_id: str, number: int) -> BoardRow:
    """Return a board by its permanent number.

    Raises:
        NotFound: There is none, or it was never shown: drafts are for organizers alone.
    """
    query = select(BoardRow).where(
        BoardRow.phase_id == phase_id, BoardRow.number == number, was_shown()
    )
    row = session.scalars(query).first()
    if row is None:
        raise NotFound("board", f"{phase_id}/{number}")
    return row


def list_boards(session: Session, phase_id: str) -> list[BoardRow]:
    """Return all boards of a phase, newest first."""
    query = select(BoardRow).where(BoardRow.phase_id == phase_id)
    return list(session.scalars(query.order_by(BoardRow.number.desc())))


def _latest(session: Session, claim: BoardClaim) -> BoardRow | None:
    return latest_board(session, claim.phase_id, claim.protocol_digest, claim.split_revision)


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


def _linked(submission: Submission, row: ScoreSheetRow) -> LinkedRecord:
    return LinkedRecord(
        submission_id=submission.id,
        method=submission.method,
        file_digest=submission.file_digest,
        measurement_key=row.measurement_key,
    )


def _entry(
    submission: Submission, team: Team, row: ScoreSheetRow, linked: LinkedRecord | None
) -> EntryRecord:
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
        linked=linked,
    )
