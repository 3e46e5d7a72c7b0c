"""Phases: dated stages of a challenge, each with its own split, protocol and limits."""

from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.board_requests import want_board
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, NotFound
from exceptiondrive_records.identifiers import checked_slug
from exceptiondrive_records.phase_life import new_salt, phase_now
from exceptiondrive_records.phase_rules import check_phase
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.quotas import quota_of
from exceptiondrive_records.splits import find_split, live_revision, whole_split
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.phase_settings import NewPhase, PhaseSettings
from exceptiondrive_schemas.submission import PhaseView


def create_phase(session: Session, new: NewPhase, *, actor: str) -> Phase:
    """Create a phase, and ask for its first, empty board.

    Args:
        session: Of a write transaction.
        new: What it is made of, and its settings.
        actor: Who creates it.

    Raises:
        InvalidRecord: A text cannot be used, or two settings contradict each other.
        Conflict: The id is taken.
        NotFound: Split or protocol is unknown.
    """
    checked_slug("phase", new.id)
    if session.get(Phase, new.id) is not None:
        raise Conflict(f"There is a phase {new.id!r} already.")
    split = find_split(session, new.split, new.split_revision)
    phase = Phase(
        id=new.id,
        challenge=new.challenge.value,
        split_name=split.name,
        split_revision=live_revision(session, split.name, split.revision, new.policy.live_part),
        protocol_digest=find_protocol(session, new.protocol).digest,
        current_board_id=None,
        created_at=database_now(session),
        pseudonym_salt=new_salt() if new.policy.anonymous else None,
        **{name: getattr(new, name) for name in PhaseSettings.model_fields},
    )
    check_phase(phase)
    session.add(phase)
    session.flush()
    want_board(session, phase.id, phase.protocol_digest)
    detail = {
        "challenge": phase.challenge,
        "split": split.name,
        "protocol": phase.protocol_digest,
    }
    audit(session, actor, "phase created", phase.id, detail)
    return phase


def find_phase(session: Session, phase_id: str) -> Phase:
    """Return a phase.

    Raises:
        NotFound: There is none with this id.
    """
    phase = session.get(Phase, phase_id)
    if phase is None:
        raise NotFound("phase", phase_id)
    return phase


def lock_phase(session: Session, phase_id: str) -> Phase:
    """Return a phase whose row is locked.

    Whoever needs the row of a board request too locks that one later: else two could wait for each
    other. Rows that refer to the phase may be written meanwhile (`FOR NO KEY UPDATE`): an upload, a
    score and its request for a board wait for nobody here.

    Raises:
        NotFound: There is none.
    """
    weak = {"key_share": True}
    phase = session.get(Phase, phase_id, with_for_update=weak, populate_existing=True)
    if phase is None:
        raise NotFound("phase", phase_id)
    return phase


def list_phases(session: Session, challenge: str | None = None) -> list[Phase]:
    """Return phases in the order in which they were created; of one challenge if given."""
    query = select(Phase).order_by(Phase.created_at, Phase.id)
    if challenge is not None:
        query = query.where(Phase.challenge == challenge)
    return list(session.scalars(query))


def is_open(phase: Phase, now: datetime) -> bool:
    """Whether the phase takes submissions: from `opens_at` until just before `closes_at`."""
    has_opened = phase.opens_at is None or phase.opens_at <= now
    return has_opened and (phase.closes_at is None or now < phase.closes_at)


def phase_view(
    session: Session, phase: Phase, *, max_upload_bytes: int, team_id: int | None = None
) -> PhaseView:
    """Return the phase as the API shows it, with the quota of a team if given."""
    whole = whole_split(session, phase.split_name, phase.split_revision)
    return PhaseView(
        id=phase.id,
        challenge=phase.challenge,
        split=phase.split_name,
        split_revision=phase.split_revision,
        split_is_public=whole.public_file_digest is not None,
        n_samples=whole.n_samples,
        protocol=find_protocol(session, phase.protocol_digest).version,
        protocol_digest=phase.protocol_digest,
        is_open=is_open(phase, database_now(session)),
        max_upload_bytes=max_upload_bytes,
        now=phase_now(session, phase),
        quota=None if team_id is None else quota_of(session, team_id, phase),
        **settings_of(phase),
    )


def settings_of(phase: Phase) -> dict[str, Any]:
    """Return the settings of a phase as they stand, by name."""
    return {name: getattr(phase, name) for name in PhaseSettings.model_fields}
