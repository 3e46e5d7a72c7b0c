"""Submissions of all teams: filter, look, try again. No route shows a value of a sample."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit_page
from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.phases import list_phases
from exceptiondrive_records.protocols import list_protocols
from exceptiondrive_records.retries import retry_submission
from exceptiondrive_records.submissions import find_submission, list_submissions
from exceptiondrive_records.tables import Submission, Team
from exceptiondrive_records.teams import find_team, list_teams
from exceptiondrive_records.tokens import names_of_actors
from exceptiondrive_records.views import view
from exceptiondrive_records.work.scoring_jobs import jobs_of
from exceptiondrive_schemas.submission import SubmissionStatus
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.browser_session import PostedForm
from exceptiondrive_server.organizer_pages.audit_view import history_lines
from exceptiondrive_server.organizer_pages.forms import REASON, read, typed
from exceptiondrive_server.organizer_pages.frame import OrganizerBrowser, go, organizer_page
from exceptiondrive_server.organizer_pages.steps import Step, step_page
from exceptiondrive_server.organizer_pages.submission_view import (
    SubmissionDetail,
    SubmissionFilter,
    submission_detail,
    submissions_view,
)

router = APIRouter(prefix="/organize/submissions", include_in_schema=False)
SHOWN = 50
HISTORY = 200
SubmissionId = Annotated[str, Path(max_length=64)]
Choice = Annotated[str, Query(max_length=64)]


@router.get("")
def show_submissions(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    team: Choice = "",
    phase: Choice = "",
    status: Choice = "",
    after: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """List submissions, newest first, narrowed to a team, a phase and a status."""
    known = status if status in list(SubmissionStatus) else ""
    chosen = SubmissionFilter(team, phase, known)
    with services.database.read() as session:
        content = submissions_view(
            list_submissions(
                session,
                team_id=find_team(session, team).id if team else None,
                phase_id=phase or None,
                status=SubmissionStatus(known) if known else None,
                after=after,
                limit=SHOWN + 1,
            ),
            teams={one.id: (one.slug, one.name) for one in list_teams(session)},
            phases=[(one.id, one.title) for one in list_phases(session)],
            chosen=chosen,
            shown=SHOWN,
        )
    return organizer_page(request, browser, "submissions.html", "submissions", page=content)


@router.get("/{submission_id}")
def show_submission(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Show where a submission stands, and everything that ever happened to it."""
    with services.database.read() as session:
        content = _detail(session, find_submission(session, submission_id))
    return organizer_page(request, browser, "submission.html", "submissions", page=content)


@router.get("/{submission_id}/retry")
def show_retry(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Ask whether a failed submission shall be tried again."""
    with services.database.read() as session:
        submission = find_submission(session, submission_id)
    return step_page(request, browser, _retry(submission))


@router.post("/{submission_id}/retry")
def post_retry(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    submission_id: SubmissionId,
) -> Response:
    """Queue a failed submission again."""
    with services.database.read() as session:
        submission = find_submission(session, submission_id)
    try:
        reason = read((REASON,), form)["reason"]
        with services.database.write() as session:
            retry_submission(session, submission_id, actor=browser.principal.actor, reason=reason)
    except RecordsError as refusal:
        return step_page(request, browser, _retry(submission), texts=typed(form), refusal=refusal)
    return go(f"/organize/submissions/{submission_id}", "submission_retried")


def _detail(session: Session, submission: Submission) -> SubmissionDetail:
    lines = audit_page(session, subject=submission.id, limit=HISTORY)
    names = names_of_actors(session, (line.actor for line in lines))
    return submission_detail(
        view(session, submission),
        team_slug=session.get_one(Team, submission.team_id).slug,
        history=history_lines(lines, names),
        jobs=jobs_of(session, submission.id),
        versions={one.digest: one.version for one in list_protocols(session)},
    )


def _retry(submission: Submission) -> Step:
    return Step(
        section="submissions",
        title=f"Try {submission.method} again",
        meaning="It is queued again with all its attempts, at its old place in time. "
        "No quota is touched.",
        button="Try again",
        back=f"/organize/submissions/{submission.id}",
        back_words="The submission",
        fields=(REASON,),
        facts=(("Failed with", f"{submission.failure_code}: {submission.failure_message}"),)
        if submission.failure_code
        else (),
        command=f'exceptiondrive organizer submissions retry {submission.id} --reason "…"',
    )
