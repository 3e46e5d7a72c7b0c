"""Which sheets of a run could not be made, why as far as workers said, and what to do."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.rescoring.keys import ScoringKey
from exceptiondrive_records.rescoring.pairs import failed_pairs
from exceptiondrive_records.tables import AuditLine, Submission
from exceptiondrive_records.tables_rescoring import RescoringRun

_NAMED = 5
_ENDINGS = ("scoring failed", "submission rejected")


def failed_words(session: Session, run: RescoringRun, key: ScoringKey, count: int) -> str:
    """Return the sentence on failed pairs: it names the submissions and their codes."""
    query = failed_pairs(run.phase_id, key).order_by(Submission.received_at, Submission.id)
    named = [_named(session, found.id) for found in session.scalars(query.limit(_NAMED))]
    more = [f"{count - len(named):,} more"] if count > len(named) else []
    sheets = "1 sheet" if count == 1 else f"{count:,} sheets"
    return (
        f"{sheets} could not be made: of {', '.join([*named, *more])}. Resume the run to try "
        "again. What cannot be helped has to be withdrawn (`exceptiondrive withdraw ID`), or the "
        "run cancelled."
    )


def _named(session: Session, submission_id: str) -> str:
    """`ID (code)`: what the newest line about it says."""
    query = (
        select(AuditLine)
        .where(AuditLine.subject == submission_id, AuditLine.action.in_(_ENDINGS))
        .order_by(AuditLine.id.desc())
        .limit(1)
    )
    line = session.scalars(query).first()
    if line is None:
        return submission_id
    return f"{submission_id} ({line.detail.get('code', 'file rejected')})"
