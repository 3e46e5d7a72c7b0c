"""What pages read from the records, in one short transaction each."""

from datetime import UTC, date, datetime, time

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards import (
    board_at,
    current_board,
    find_board,
    late_board,
    latest_public_board,
    parsed_board,
    public_protocols,
    was_shown,
)
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.drawings import protocol_drawing
from exceptiondrive_records.errors import InvalidRecord, NotFound
from exceptiondrive_records.phase_life import phase_now, takes_late_entries
from exceptiondrive_records.phases import is_open, list_phases
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.tables import BoardFlip, BoardRow, Phase, ProtocolRow, SplitRow
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.datetimes import in_utc, with_zone_sign
from exceptiondrive_schemas.protocol import Protocol, packaged_protocol
from exceptiondrive_server.pages.board_changes import BoardBefore
from exceptiondrive_server.pages.board_page import BoardReading
from exceptiondrive_server.pages.board_query import BoardQuery
from exceptiondrive_server.pages.feed import BoardNote, History
from exceptiondrive_server.pages.page_parts import PhaseLink


def read_board(session: Session, query: BoardQuery) -> BoardReading:
    """Read the board that a query asks for.

    Raises:
        NotFound: The phase, protocol or board does not exist.
    """
    phases = list_phases(session)
    phase = _phase(phases, query.phase)
    links = tuple(phase_link(session, each, each is phase) for each in phases)
    if phase is None:
        protocol = latest_protocol(session)
        return BoardReading((), None, None, protocol, (), protocol.version, True)
    row = _board_row(session, phase, query)
    board = parsed_board(row) if row else None
    current = find_protocol(session, phase.protocol_digest)
    protocol = find_protocol(session, board.protocol.digest) if board else current
    return BoardReading(
        phases=links,
        phase=next(link for link in links if link.is_current),
        board=board,
        protocol=protocol,
        protocol_versions=_protocol_versions(session, phase.id),
        current_protocol=current.version,
        is_current=row is None or row.id in (phase.current_board_id, phase.late_board_id),
        now=phase_now(session, phase),
        has_late_view=phase.late_board_id is not None,
        drawing=protocol_drawing(session, protocol),
        before=_board_before(session, row) if row else None,
    )


def read_phases(
    session: Session, wanted: str | None
) -> tuple[tuple[PhaseLink, ...], PhaseLink | None]:
    """Read all phases, and the one asked for.

    Raises:
        NotFound: The phase does not exist.
    """
    phases = list_phases(session)
    phase = _phase(phases, wanted)
    links = tuple(phase_link(session, each, each is phase) for each in phases)
    return links, next((link for link in links if link.is_current), None)


def phase_link(session: Session, phase: Phase, is_current: bool = False) -> PhaseLink:
    """Return what pages say of a phase."""
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    now = database_now(session)
    challenge = next(c for key, c in CHALLENGES.items() if key == phase.challenge)
    return PhaseLink(
        id=phase.id,
        title=phase.title,
        challenge=challenge,
        n_samples=split.n_samples,
        is_open=is_open(phase, now),
        is_ahead=phase.opens_at is not None and now < phase.opens_at,
        takes_late=takes_late_entries(phase, now),
        is_current=is_current,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        quota_per_day=phase.quota_per_day,
        split=phase.split_name,
        split_is_public=split.public_file_digest is not None,
        url=f"/?phase={phase.id}#board",
    )


def latest_protocol(session: Session) -> Protocol:
    """Return the protocol added last; before any was added, the packaged one."""
    query = select(ProtocolRow.digest).order_by(ProtocolRow.created_at.desc()).limit(1)
    digest = session.scalar(query)
    return find_protocol(session, digest) if digest else packaged_protocol()


def _phase(phases: list[Phase], phase_id: str | None) -> Phase | None:
    """The phase asked for, or the first one, in the registry's order of challenges."""
    if phase_id is not None:
        found = next((phase for phase in phases if phase.id == phase_id), None)
        if found is None:
            raise NotFound("phase", phase_id)
        return found
    order = {challenge_id.value: at for at, challenge_id in enumerate(CHALLENGES)}
    return min(phases, key=lambda phase: order[phase.challenge], default=None)


def _board_row(session: Session, phase: Phase, query: BoardQuery) -> BoardRow | None:
    if query.view == "late":
        row = late_board(session, phase.id)
        if row is None:
            raise NotFound("late view, since nothing came late, of the phase", phase.id)
        return row
    if query.board is not None:
        return find_board(session, phase.id, query.board)
    if query.protocol is not None:
        digest = find_protocol(session, query.protocol).digest
        row = latest_public_board(session, phase.id, digest)
        if row is None:
            raise NotFound("board of this phase under protocol", query.protocol)
        return row
    if query.as_of is not None:
        moment = parse_moment(query.as_of)
        if moment is None:
            raise InvalidRecord(
                "The date of the board must be a day such as 2026-11-21 or a time such as "
                "2026-11-21T12:00:00Z."
            )
        row = board_at(session, phase.id, moment)
        if row is None:
            raise NotFound("board of this phase as of", query.as_of)
        return row
    return current_board(session, phase.id)


def parse_moment(text: str) -> datetime | None:
    """Read a day (its end counts) or a moment with time zone (UTC if none); None if neither."""
    try:
        if len(text) == 10:
            return datetime.combine(date.fromisoformat(text), time.max, UTC)
        return in_utc(datetime.fromisoformat(with_zone_sign(text)))
    except (ValueError, OverflowError):
        return None


def _board_before(session: Session, row: BoardRow) -> BoardBefore | None:
    """The board that was shown until this one was first shown; None for the first."""
    first = (
        select(func.min(BoardFlip.id))
        .where(BoardFlip.phase_id == row.phase_id, BoardFlip.board_id == row.id)
        .scalar_subquery()
    )
    before = (
        select(func.max(BoardFlip.id))
        .where(BoardFlip.phase_id == row.phase_id, BoardFlip.id < first)
        .scalar_subquery()
    )
    query = (
        select(BoardRow.number, ProtocolRow.version, BoardRow.published_at)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .join(ProtocolRow, ProtocolRow.digest == BoardRow.protocol_digest)
        .where(BoardFlip.id == before)
    )
    found = session.execute(query).first()
    return None if found is None else BoardBefore(*found)


def _protocol_versions(session: Session, phase_id: str) -> tuple[str, ...]:
    """Versions under which this phase has a board, oldest first."""
    used = public_protocols(session, phase_id)
    query = select(ProtocolRow.version).where(ProtocolRow.digest.in_(used))
    return tuple(session.scalars(query.order_by(ProtocolRow.created_at)))


def read_history(session: Session, phase_id: str | None, limit: int = 30) -> History:
    """Read the newest boards of a phase, without their entries.

    Raises:
        NotFound: The phase does not exist, or there is none at all.
    """
    phase = _phase(list_phases(session), phase_id)
    if phase is None:
        raise NotFound("phase", "")
    query = (
        select(BoardRow.number, BoardRow.digest, ProtocolRow.version, BoardRow.published_at)
        .join(ProtocolRow, ProtocolRow.digest == BoardRow.protocol_digest)
        .where(BoardRow.phase_id == phase.id, was_shown())
        .order_by(BoardRow.number.desc())
        .limit(limit)
    )
    notes = tuple(BoardNote(*row) for row in session.execute(query))
    return History(phase.id, phase.title, notes)
