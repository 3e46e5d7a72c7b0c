"""Phases: dated stages of a challenge, each with its own split, protocol and limits."""

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.board_requests import want_board
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.identifiers import checked_slug, checked_text
from exceptiondrive_records.phase_life import new_salt, phase_now
from exceptiondrive_records.phase_rules import check_phase
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.quotas import quota_of
from exceptiondrive_records.splits import find_split, live_revision, whole_split
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.phase_settings import PhasePolicy
from exceptiondrive_schemas.submission import PhaseView


def create_phase(
    session: Session,
    phase_id: str,
    *,
    challenge: str,
    title: str,
    description: str = "",
    split_name: str,
    split_revision: str | None = None,
    protocol: str,
    opens_at: datetime | None = None,
    closes_at: datetime | None = None,
    quota_per_day: int = 3,
    quota_total: int | None = None,
    quota_concurrent: int | None = None,
    rejected_per_day: int = 20,
    shows_reported: bool = False,
    life: PhasePolicy = PhasePolicy(),  # noqa: B008 - immutable
    actor: str,
) -> Phase:
    """Create a phase, and ask for its first, empty board.

    Args:
        session: Of a write transaction.
        phase_id: Stands in addresses.
        challenge: `planning` or `strategy`.
        title: Shown to readers.
        description: Shown to readers.
        split_name: A registered split.
        split_revision: By default the one registered last.
        protocol: Version or digest.
        opens_at: None: open since ever.
        closes_at: None: open for ever.
        quota_per_day: Submissions of a team per UTC day.
        quota_total: None: no limit.
        quota_concurrent: Submissions of a team that may wait for a score at once; None: no limit.
        rejected_per_day: Files of a team that may be wrong per UTC day.
        shows_reported: Whether the board shows the paper's rows beside the scored entries.
        life: What is shown when, and to whom.
        actor: Who creates it.

    Raises:
        InvalidRecord: A value cannot be used.
        Conflict: The id is taken.
        NotFound: Split or protocol is unknown.
    """
    checked_slug("phase", phase_id)
    if challenge not in [str(known) for known in CHALLENGES]:
        raise InvalidRecord(f"Unknown challenge {challenge!r}; known: {', '.join(CHALLENGES)}.")
    if session.get(Phase, phase_id) is not None:
        raise Conflict(f"There is a phase {phase_id!r} already.")
    split = find_split(session, split_name, split_revision)
    phase = Phase(
        id=phase_id,
        challenge=challenge,
        title=checked_text("title", title, max_length=120),
        description=checked_text(
            "description", description, max_length=4000, may_be_empty=True, may_have_lines=True
        ),
        split_name=split.name,
        split_revision=live_revision(session, split.name, split.revision, life.live_part),
        protocol_digest=find_protocol(session, protocol).digest,
        opens_at=opens_at,
        closes_at=closes_at,
        quota_per_day=quota_per_day,
        quota_total=quota_total,
        quota_concurrent=quota_concurrent,
        rejected_per_day=rejected_per_day,
        current_board_id=None,
        shows_reported=shows_reported,
        created_at=database_now(session),
        policy=life,
        pseudonym_salt=new_salt() if life.anonymous else None,
    )
    check_phase(phase)
    session.add(phase)
    session.flush()
    want_board(session, phase.id, phase.protocol_digest)
    detail = {"challenge": challenge, "split": split.name, "protocol": phase.protocol_digest}
    audit(session, actor, "phase created", phase_id, detail)
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
        title=phase.title,
        description=phase.description,
        split=phase.split_name,
        split_revision=phase.split_revision,
        split_is_public=whole.public_file_digest is not None,
        n_samples=whole.n_samples,
        protocol=find_protocol(session, phase.protocol_digest).version,
        protocol_digest=phase.protocol_digest,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        is_open=is_open(phase, database_now(session)),
        quota_per_day=phase.quota_per_day,
        quota_total=phase.quota_total,
        quota_concurrent=phase.quota_concurrent,
        max_upload_bytes=max_upload_bytes,
        policy=phase.life,
        now=phase_now(session, phase),
        quota=None if team_id is None else quota_of(session, team_id, phase),
    )
