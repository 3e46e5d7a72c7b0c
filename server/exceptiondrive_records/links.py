"""Links between two submissions of a team: an entry and its counterpart without reminder."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.tables import Phase, Submission
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.submission import SubmissionStatus

_WITHOUT_A_SCORE = (
    SubmissionStatus.WITHDRAWN,
    SubmissionStatus.REJECTED,
    SubmissionStatus.FAILED,
)


def checked_counterpart(
    session: Session, team_id: int, phase: Phase, linked_to: str | None
) -> str | None:
    """Return the id of the submission to link to, once it is certain that it may be linked.

    Raises:
        InvalidRecord: The challenge links nothing, or the counterpart is of another phase.
        NotFound: The team has no such submission.
        Conflict: The counterpart has no score and will not have one.
    """
    if linked_to is None:
        return None
    counterpart = CHALLENGES[ChallengeId(phase.challenge)].counterpart
    if counterpart is None:
        raise InvalidRecord(
            f"Submissions of the {phase.challenge} challenge are not linked; leave linked_to out."
        )
    found = session.scalars(
        select(Submission).where(Submission.id == linked_to, Submission.team_id == team_id)
    ).first()
    if found is None:
        raise NotFound("submission of your team", linked_to)
    if found.phase_id != phase.id:
        raise InvalidRecord(
            f"The submission {linked_to!r} is of the phase {found.phase_id!r}; link one of "
            f"{phase.id!r}: {counterpart}."
        )
    if found.status in _WITHOUT_A_SCORE:
        raise Conflict(f"The submission {linked_to!r} was {found.status}; link one with a score.")
    return found.id


def require_same_link(first: Submission, linked_to: str | None) -> None:
    """Refuse the same bytes with another link: a record is never changed behind its team's back.

    Raises:
        Conflict: The first submission of the bytes has another link, or none.
    """
    if linked_to in (None, first.linked_to):
        return
    link = "without a link" if first.linked_to is None else f"linked to {first.linked_to!r}"
    raise Conflict(
        f"The same bytes were submitted as {first.id!r}, {link}. To link them anew, withdraw that "
        "submission and submit again."
    )
