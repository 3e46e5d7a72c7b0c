"""Disqualify a team or one of its submissions, and reinstate it.

No board is altered: a new one leaves the entries out, old ones keep what they showed. While a board
is frozen, readers see this only at the reveal.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_reason, checked_text
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.phases import find_phase, require_known_to
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team

MAX_NOTE = 500


def disqualify_team(
    session: Session,
    slug: str,
    *,
    reason: str,
    actor: str,
    public_note: str | None = None,
    phase_id: str | None = None,
) -> Disqualification:
    """Take a team off the boards of one or all phases; it cannot submit until it is reinstated.

    Raises:
        NotFound: No such team or phase.
        InvalidRecord: A text cannot be stored.
        Conflict: It is disqualified there already, waits for approval, or was merged; or the phase
            is hidden, and the team does not know of it.
    """
    team = find_team(session, slug, lock=True)
    if team.pending_since is not None:
        raise Conflict("The team waits for approval: refuse its registration instead.")
    if team.merged_into_id is not None:
        into = session.get_one(Team, team.merged_into_id).slug
        raise Conflict(
            f"It was merged into the team {into}, with all that it sent: disqualify that one, or an entry."
        )
    if phase_id is not None:
        require_known_to(session, team.id, find_phase(session, phase_id))
    row = Disqualification(team_id=team.id, phase_id=phase_id)
    return _disqualify(session, team, row, reason, public_note, actor)


def disqualify_submission(
    session: Session, submission_id: str, *, reason: str, actor: str, public_note: str | None = None
) -> Disqualification:
    """Take one submission off the boards; its team may not submit the same bytes again.

    Raises:
        NotFound: No such submission.
        InvalidRecord: A text cannot be stored.
        Conflict: It is disqualified already, or its team was merged into another one meanwhile.
    """
    submission = find_submission(session, submission_id)
    team = _locked_team_of(session, submission)
    row = Disqualification(
        team_id=team.id, phase_id=submission.phase_id, submission_id=submission.id
    )
    return _disqualify(session, team, row, reason, public_note, actor)


def _disqualify(
    session: Session,
    team: Team,
    row: Disqualification,
    reason: str,
    public_note: str | None,
    actor: str,
) -> Disqualification:
    same = exists().where(
        Disqualification.team_id == team.id,
        Disqualification.reinstated_at.is_(None),
        Disqualification.phase_id.is_not_distinct_from(row.phase_id),
        Disqualification.submission_id.is_not_distinct_from(row.submission_id),
    )
    if session.scalar(select(same)):
        raise Conflict("It is disqualified already.")
    row.reason = checked_reason(reason)
    note = checked_text("public note", public_note or "", max_length=MAX_NOTE, may_be_empty=True)
    row.public_note = note or None
    row.disqualified_at = database_now(session)
    session.add(row)
    frozen = "a frozen board goes on showing it until it is revealed"
    words = [f"The next boards leave it out; earlier ones keep what they showed, and {frozen}."]
    if row.submission_id is None:
        words.append("Your team submits nothing there until it is reinstated.")
    else:
        words.append("The same bytes are not taken again.")
    detail = {"reason": row.reason, "public_note": row.public_note}
    _publish(session, team, row, "disqualified", detail, words, actor)
    return row


def reinstate(
    session: Session, disqualification_id: int, *, reason: str, actor: str
) -> Disqualification:
    """End a disqualification: the next boards list the entries again, unless another one applies.

    Raises:
        NotFound: There is none.
        InvalidRecord: The reason cannot be stored.
        Conflict: It has ended already, or its team was merged into another one meanwhile.
    """
    row = find_disqualification(session, disqualification_id)
    team = _locked_team_of(session, row)
    if row.reinstated_at is not None:
        raise Conflict(f"It was reinstated at {row.reinstated_at:%Y-%m-%d %H:%M} UTC.")
    row.reinstated_at = database_now(session)
    detail = {"reason": checked_reason(reason)}
    words = ["What was scored stands on the next board, unless another disqualification lasts."]
    _publish(session, team, row, "reinstated", detail, words, actor)
    return row


def _locked_team_of(session: Session, row: Submission | Disqualification) -> Team:
    """Lock the team of a row, then the row, which must still belong to it; return the team."""
    team = hold_team(session, row.team_id)
    session.refresh(row, with_for_update={"key_share": True})
    if row.team_id != team.id:
        raise Conflict(f"The team {team.slug} was merged into another one meanwhile: try again.")
    return team


def _publish(
    session: Session,
    team: Team,
    row: Disqualification,
    done: Literal["disqualified", "reinstated"],
    detail: Mapping[str, Any],
    words: Sequence[str],
    actor: str,
) -> None:
    """Request new boards, write the audit line, and notify the team."""
    session.flush()
    want_boards_of_team(session, team.id, row.phase_id)
    detail = {**detail, "disqualification": row.id}
    where = "all phases"
    if row.phase_id is not None:
        detail["phase"] = row.phase_id
        where = find_phase(session, row.phase_id).title
    if row.submission_id is None:
        audit(session, actor, f"team {done}", team.slug, detail)
        name, address = f"Your team {team.name}", "/my"
    else:
        audit(session, actor, f"submission {done}", row.submission_id, detail)
        method = find_submission(session, row.submission_id).method
        name, address = f"Your entry {method}", f"/submissions/{row.submission_id}"
    tell_team(
        session,
        team,
        done,
        f"{name} is {done} in {where}",
        (f"Reason: {detail['reason']}", *words),
        address=address,
        phase=row.phase_id or "",
    )


def find_disqualification(session: Session, disqualification_id: int) -> Disqualification:
    """Return a disqualification.

    Raises:
        NotFound: There is none.
    """
    return find_row(session, Disqualification, "disqualification", disqualification_id)


def disqualification_of(session: Session, submission_id: str) -> Disqualification | None:
    """Return the present disqualification of one submission, ignoring its team's; None if none."""
    lasting = Disqualification.reinstated_at.is_(None)
    query = select(Disqualification).where(Disqualification.submission_id == submission_id, lasting)
    return session.scalars(query).first()


def list_disqualifications(
    session: Session, *, team_id: int | None = None
) -> list[Disqualification]:
    """Return disqualifications, including ended ones, newest first."""
    query = select(Disqualification).order_by(Disqualification.id.desc())
    if team_id is not None:
        query = query.where(Disqualification.team_id == team_id)
    return list(session.scalars(query))


def want_boards_of_team(
    session: Session, team_id: int, phase_id: str | None = None, *, with_archived: bool = True
) -> None:
    """Request new boards of a phase, or of all phases, if the team submitted there."""
    query = select(Phase).where(
        exists().where(Submission.phase_id == Phase.id, Submission.team_id == team_id)
    )
    if phase_id is not None:
        query = query.where(Phase.id == phase_id)
    if not with_archived:
        query = query.where(Phase.visibility != "archived")
    for phase in session.scalars(query.order_by(Phase.id)):
        renew_boards(session, phase)
