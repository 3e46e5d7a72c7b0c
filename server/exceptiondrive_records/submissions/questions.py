"""Ask a team for confirmation before an upload that replaces one of its entries counts."""

from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.policy import is_late
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import submission_page
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import views
from exceptiondrive_schemas.api.own_entries import replaced_entry, to_confirm
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView

MAX_LOOKED_AT = 200
"""Maximum number of a team's newest scored submissions among which the replaced one is sought."""


def entry_replaced_by(session: Session, submission: Submission) -> SubmissionView | None:
    """Return the entry of its team that an upload would replace now."""
    phase = session.get_one(Phase, submission.phase_id)
    scored, _ = submission_page(
        session,
        team_id=submission.team_id,
        phase_id=phase.id,
        status=SubmissionStatus.SCORED,
        limit=MAX_LOOKED_AT,
    )
    own = views(session, [each for each in scored if each.id != submission.id])
    is_open = not is_late(phase, submission)
    return replaced_entry(own, submission.method, phase.policy, is_open=is_open)


def is_asked_anew(session: Session, asked: Submission) -> bool:
    """Update an upload's question if it now replaces another entry; return whether it did."""
    hold_team(session, asked.team_id)
    session.refresh(asked)
    report = asked.report
    if report is None or not asked.can_be_confirmed(database_now(session)):
        return False
    replaced = entry_replaced_by(session, asked)
    if replaced is None or any(replaced.id in question for question in report.to_confirm):
        return False
    questions = tuple(to_confirm(report.unranked_because, replaced).values())
    asked.report = report.model_copy(update={"to_confirm": questions})
    return True
