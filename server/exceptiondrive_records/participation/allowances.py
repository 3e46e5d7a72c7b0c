"""Grant, change or revoke a later deadline or another quota for one team in a phase."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any, TypedDict, Unpack

from sqlalchemy import ColumnElement, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.allowances import allowance_of, is_revealed
from exceptiondrive_records.phases.phases import lock_phase, require_known_to
from exceptiondrive_records.phases.policy import own_deadline
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.api.submission import SubmissionStatus

_SAID = {
    "closes_at": "deadline is",
    "quota_per_day": "submissions a day are",
    "quota_total": "submissions in all are",
}


class Limits(TypedDict, total=False):
    """Limits that a team may be granted; None means the phase's own limit."""

    closes_at: datetime | None
    quota_per_day: int | None
    quota_total: int | None


def set_allowance(
    session: Session,
    slug: str,
    phase_id: str,
    *,
    reason: str,
    actor: str,
    **limits: Unpack[Limits],
) -> Allowance | None:
    """Set a team's limits in a phase; limits that are not given stay.

    A later deadline also applies to earlier uploads of the team: those within it are not late. If
    the same deadline is given again and is no longer later than the phase's, it is dropped.

    Returns:
        The allowance; None if the team has the same limits as all again.

    Raises:
        NotFound: No such team or phase.
        InvalidRecord: The deadline is not later than the phase's, or the reason cannot be stored.
        Conflict: Kept-back scores were revealed already; submissions in time would become late; the
            team is gone; or the phase is hidden, and the team does not know of it.
    """
    phase = lock_phase(session, phase_id)
    team = find_team(session, slug, lock=True)
    team.require_there()
    row = allowance_of(session, team.id, phase.id)
    closes_at = limits.get("closes_at")
    if closes_at is not None and own_deadline(phase, closes_at) is None:
        if row is not None and closes_at == row.closes_at:
            limits["closes_at"] = closes_at = None
        elif phase.closes_at is None:
            raise InvalidRecord("The phase has no deadline: no team needs a later one.")
        else:
            raise InvalidRecord("A team's own deadline must be later than that of the phase.")
    if closes_at is not None and is_revealed(session, phase):
        raise Conflict(
            "What was hidden has been revealed: no later deadline can be given any more."
        )
    before = {name: getattr(row, name, None) for name in _SAID}
    after = {**before, **limits}
    if after == before:
        return row
    if row is None:
        require_known_to(session, team.id, phase)
    if all(value is None for value in after.values()):
        if row is not None:
            session.delete(row)
        row = None
    else:
        given = {**after, "reason": checked_reason(reason), "granted_at": database_now(session)}
        row = session.merge(Allowance(team_id=team.id, phase_id=phase.id, **given))
    if "closes_at" in limits:
        own = (Submission.team_id == team.id, Submission.phase_id == phase.id)
        _require_in_time(session, own_deadline(phase, closes_at) or phase.closes_at, *own)
        session.execute(update(Submission).where(*own).values(granted_until=closes_at))
    renew_boards(session, phase)
    was, granted = _allowance_words(phase, before), _allowance_words(phase, after)
    detail = {"phase": phase.id, "reason": checked_reason(reason), "was": was, "is": granted}
    audit(session, actor, "allowance changed", team.slug, detail)
    ended = [
        f"{said} as for all teams again"
        for name, said in _SAID.items()
        if after[name] is None and before[name] is not None
    ]
    words = [f"Your {line}." for line in (*granted, *ended)]
    sentences = (f"Reason: {reason.strip()}", *words)
    title = f"What your team may submit to {phase.title} is changed"
    tell_team(session, team, "allowance", title, sentences, phase=phase.id)
    return row


def _require_in_time(session: Session, until: datetime | None, *own: ColumnElement[bool]) -> None:
    """Refuse a deadline before uploads of the team within its present one, except faulty files.

    Raises:
        Conflict: A submission in time would become late.
    """
    if until is None:
        return
    arrived_at = func.coalesce(Submission.arrived_at, Submission.received_at)
    is_lost = (arrived_at >= until, arrived_at < Submission.granted_until)
    is_asked = Submission.confirm_until.is_not(None)
    may_count = (Submission.status != SubmissionStatus.REJECTED) | is_asked
    last = session.scalar(select(func.max(arrived_at)).where(*own, *is_lost, may_count))
    if last is not None:
        raise Conflict(
            f"The team sent a file at {last:%Y-%m-%d %H:%M:%S} UTC: what was accepted in time would "
            "become late. Set a later time, or leave the deadline as it is."
        )


def list_allowances(session: Session, team_id: int) -> list[Allowance]:
    """Return the allowances of a team, by phase."""
    query = select(Allowance).where(Allowance.team_id == team_id)
    return list(session.scalars(query.order_by(Allowance.phase_id)))


def _allowance_words(phase: Phase, limits: Mapping[str, Any]) -> list[str]:
    until = own_deadline(phase, limits["closes_at"])
    said = {**limits, "closes_at": until and f"{until:%Y-%m-%d %H:%M} UTC"}
    return [f"{_SAID[name]} {value}" for name, value in said.items() if value is not None]
