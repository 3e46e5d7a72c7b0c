"""The terms of a phase: which version is in force, and whether a team accepted it."""

import hashlib
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, NotAllowed
from exceptiondrive_records.participation.tables import TermsAcceptance
from exceptiondrive_records.phases.tables import Phase

_LETTERS = 12


def terms_version(phase: Phase) -> str | None:
    """Return the version of the terms that a team has to accept; None if it need not."""
    text = phase.page.terms.strip()
    if not phase.policy.terms_required or not text:
        return None
    return hashlib.sha256(text.encode()).hexdigest()[:_LETTERS]


def terms_accepted_at(session: Session, team_id: int, phase: Phase) -> datetime | None:
    """Return when a team accepted the present terms; None if it did not, or need not."""
    version = terms_version(phase)
    if version is None:
        return None
    row = session.get(TermsAcceptance, (team_id, phase.id, version))
    return None if row is None else row.accepted_at


def accept_terms(
    session: Session, team_id: int, phase: Phase, version: str, *, actor: str
) -> TermsAcceptance:
    """Record that a team accepts the terms that it read. Idempotent.

    Raises:
        Conflict: The terms have changed, or need not be accepted.
    """
    current = terms_version(phase)
    if current is None:
        raise Conflict("This phase has no terms to accept.")
    if version != current:
        raise Conflict(f"The terms stand in version {current} now: read that, and accept it.")
    hold_team(session, team_id)
    row = session.get(TermsAcceptance, (team_id, phase.id, version))
    if row is None:
        row = TermsAcceptance(
            team_id=team_id,
            phase_id=phase.id,
            version=version,
            accepted_at=database_now(session),
            actor=actor,
        )
        session.add(row)
        audit(session, actor, "terms accepted", phase.id, {"team_id": team_id, "version": version})
    return row


def acceptances_of(session: Session, team_id: int) -> list[TermsAcceptance]:
    """Return the terms that a team accepted, newest first."""
    query = select(TermsAcceptance).where(TermsAcceptance.team_id == team_id)
    return list(session.scalars(query.order_by(TermsAcceptance.accepted_at.desc())))


def require_terms(session: Session, team_id: int, phase: Phase) -> None:
    """Refuse an upload of a team that has not accepted the present terms.

    Raises:
        NotAllowed: It has not.
    """
    version = terms_version(phase)
    if version is not None and terms_accepted_at(session, team_id, phase) is None:
        raise NotAllowed(
            f"Accept the terms of the phase first (version {version}): on /my/terms/{phase.id}, or by "
            f"exceptiondrive terms --phase {phase.id} --accept {version}."
        )
