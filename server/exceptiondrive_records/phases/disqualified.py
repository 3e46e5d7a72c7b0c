"""Who is disqualified, as checked before an upload is accepted and whenever a board is built."""

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import and_, bindparam, exists, func, select
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.db.errors import NotAllowed
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.policy import (
    pseudonym_of_method,
    pseudonym_of_team,
    shows_pseudonyms,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.participation import DisqualificationNote
from exceptiondrive_schemas.api.submission import SubmissionStatus

_IS_OF_SUBMISSION = and_(
    Disqualification.team_id == Submission.team_id,
    Disqualification.reinstated_at.is_(None),
    Disqualification.phase_id.is_(None) | (Disqualification.phase_id == Submission.phase_id),
    Disqualification.submission_id.is_(None) | (Disqualification.submission_id == Submission.id),
)
"""Join condition: the submission, or its team in the phase, is disqualified."""
_SINCE = (
    select(Submission.id, func.min(Disqualification.disqualified_at))
    .join(Disqualification, _IS_OF_SUBMISSION)
    .where(Submission.id.in_(bindparam("submissions", expanding=True)))
    .group_by(Submission.id)
)
_IN_FORCE = and_(
    Disqualification.team_id == bindparam("team"),
    Disqualification.reinstated_at.is_(None),
    Disqualification.phase_id.is_(None) | (Disqualification.phase_id == bindparam("phase")),
)
_OF_TEAM = (
    select(Disqualification)
    .where(_IN_FORCE, Disqualification.submission_id.is_(None))
    .order_by(Disqualification.id)
    .limit(1)
)
_OF_UPLOAD = (
    select(Disqualification)
    .outerjoin(Submission, Submission.id == Disqualification.submission_id)
    .where(
        _IN_FORCE,
        Disqualification.submission_id.is_(None)
        | and_(
            Submission.team_id == bindparam("team"),
            Submission.phase_id == bindparam("phase"),
            Submission.file_digest == bindparam("file"),
        ),
    )
    .order_by(Disqualification.submission_id.is_not(None), Disqualification.id)
    .limit(1)
)
"""The disqualification of the whole team first, then that of these bytes."""


def disqualified_ids(session: Session, phase_id: str) -> frozenset[str]:
    """Return the submissions to a phase that no new board lists, as they are disqualified."""
    is_out = exists().where(_IS_OF_SUBMISSION)
    query = select(Submission.id).where(Submission.phase_id == phase_id, is_out)
    return frozenset(session.scalars(query))


def is_one_taken_back(session: Session, phase: Phase, submission_ids: set[str]) -> bool:
    """Whether one is withdrawn, private or disqualified now, so that no new board may list it."""
    is_out = exists().where(_IS_OF_SUBMISSION) | (Submission.status == SubmissionStatus.WITHDRAWN)
    if phase.policy.entries_private:
        is_out |= Submission.published_at.is_(None)
    query = select(Submission.id).where(Submission.phase_id == phase.id, is_out)
    return not submission_ids.isdisjoint(session.scalars(query))


def disqualified_since(session: Session, submissions: Sequence[Submission]) -> dict[str, datetime]:
    """Return since when submissions are disqualified, by id; others are left out."""
    found = session.execute(_SINCE, {"submissions": [each.id for each in submissions]})
    return {submission_id: since for submission_id, since in found}


def require_not_disqualified(
    session: Session, team_id: int, phase: Phase, file_digest: str
) -> None:
    """Refuse every upload of a disqualified team, and bytes that were disqualified in the phase.

    Raises:
        NotAllowed: The team, or this very file of it, is disqualified.
    """
    given = {"team": team_id, "phase": phase.id, "file": file_digest}
    found = session.scalars(_OF_UPLOAD, given).first()
    if found is None:
        return
    if found.submission_id is not None:
        raise NotAllowed(
            f"These bytes were disqualified as submission {found.submission_id!r}; the reason stands "
            "in your notices. Ask the organizers."
        )
    where = "in this phase" if found.phase_id else "here"
    raise NotAllowed(
        f"Your team is disqualified {where} since {found.disqualified_at:%Y-%m-%d}; the reason "
        "stands in your notices. Ask the organizers."
    )


def team_disqualified_since(session: Session, team_id: int, phase: Phase) -> datetime | None:
    """Return since when a phase refuses uploads of a team, as it is disqualified; None if not."""
    found = session.scalars(_OF_TEAM, {"team": team_id, "phase": phase.id}).first()
    return None if found is None else found.disqualified_at


def disqualification_notes(session: Session, phase: Phase) -> tuple[DisqualificationNote, ...]:
    """Return the public notes on disqualifications in a phase, newest first.

    They have the names that its board shows. If these are pseudonyms, notes on all phases are left
    out, as others show them under the name. Only the day is given, so that times link no two notes.
    """
    return tuple(note for _, note in _with_public_note(session, phase))


def notes_by_submission(session: Session, phase: Phase) -> dict[str, DisqualificationNote]:
    """Return the newest such note on each submission to a phase, or on its whole team."""
    noted = _with_public_note(session, phase)
    teams = {row.team_id for row, _ in noted}
    query = select(Submission.id, Submission.team_id)
    query = query.where(Submission.phase_id == phase.id, Submission.team_id.in_(teams))
    submissions = session.execute(query).all()
    return {
        submission_id: note
        for row, note in reversed(noted)
        for submission_id, team_id in submissions
        if row.team_id == team_id and row.submission_id in (None, submission_id)
    }


def _with_public_note(
    session: Session, phase: Phase
) -> list[tuple[Disqualification, DisqualificationNote]]:
    is_masked = shows_pseudonyms(session, phase)
    here = Disqualification.phase_id == phase.id
    other = aliased(Submission)  # any submission of the team to the phase
    query = (
        select(Disqualification, Team, Submission.method)
        .join(Team, Team.id == Disqualification.team_id)
        .outerjoin(Submission, Submission.id == Disqualification.submission_id)
        .where(
            Disqualification.public_note.is_not(None),
            Disqualification.reinstated_at.is_(None),
            here if is_masked else Disqualification.phase_id.is_(None) | here,
            Team.id.in_(select(other.team_id).where(other.phase_id == phase.id)),
        )
        .order_by(Disqualification.id.desc())
    )

    def told(row: Disqualification, team: Team, method: str | None) -> DisqualificationNote:
        masked = pseudonym_of_method(phase, team.id, method) if method and is_masked else method
        return DisqualificationNote(
            team=pseudonym_of_team(phase, team.id) if is_masked else team.name,
            method=masked,
            note=row.public_note or "",
            disqualified_at=row.disqualified_at.replace(hour=0, minute=0, second=0, microsecond=0),
        )

    return [(row, told(row, team, method)) for row, team, method in session.execute(query)]
