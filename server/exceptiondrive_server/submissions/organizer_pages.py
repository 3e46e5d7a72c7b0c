"""Submissions of all teams: filter, look, try again. No route shows a value of a sample."""

from collections.abc import Mapping
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.phases.phases import find_phase, list_phases
from exceptiondrive_records.protocols.protocols import list_protocols
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.submissions import find_submission, list_submissions
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams
from exceptiondrive_records.work.jobs import jobs_of
from exceptiondrive_schemas.submission import SubmissionStatus
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.submissions.view import status_of, steps_of
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_page,
    take_step,
)

router = APIRouter(prefix="/organize", include_in_schema=False)
SHOWN = 50
HISTORY = 200
SHOWN_PAIRS = 100
"""Pairs on the page, the most alike; the command lists them all."""
SHOWN_OF_A_TEAM = 10
SubmissionId = Annotated[str, Path(max_length=64)]
Choice = Annotated[str, Query(max_length=64)]


@router.get("/submissions")
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
    known = SubmissionStatus(status) if status in list(SubmissionStatus) else None
    with services.database.read() as session:
        found = list_submissions(
            session,
            team_id=find_team(session, team).id if team else None,
            phase_id=phase or None,
            status=known,
            after=after,
            limit=SHOWN + 1,
        )
        teams = {one.id: one for one in list_teams(session)}
        phases = list_phases(session, with_hidden=True)
    chosen = {"team": team, "phase": phase, "status": known or ""}
    older = {**chosen, "after": found[SHOWN - 1].id} if len(found) > SHOWN else {}
    return organizer_page(
        request,
        browser,
        "submissions/organizer_submissions.html",
        "submissions",
        found=found[:SHOWN],
        teams=teams,
        phases=phases,
        statuses=list(SubmissionStatus),
        chosen=chosen,
        older=urlencode({key: value for key, value in older.items() if value}),
    )


@router.get("/submissions/{submission_id}")
def show_submission(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Show where a submission stands, and everything that ever happened to it."""
    with services.database.read() as session:
        submission = find_submission(session, submission_id)
        seen = view(session, submission)
        team = session.get_one(Team, submission.team_id)
        lines = history(session, submission.id, limit=HISTORY)
        jobs = jobs_of(session, submission.id)
        versions = {one.digest: one.version for one in list_protocols(session)}
    return organizer_page(
        request,
        browser,
        "submissions/organizer_submission.html",
        "submissions",
        one=seen,
        team=team,
        now=status_of(seen),
        steps=steps_of(seen),
        n_faults=sum(group.count for group in (seen.report.faults if seen.report else ())),
        lines=lines,
        jobs=jobs,
        versions=versions,
    )


@router.get("/submissions/{submission_id}/retry")
def show_retry(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Ask whether a failed submission shall be tried again."""
    with services.database.read() as session:
        step = _retry(find_submission(session, submission_id))
    return step_page(request, browser, step)


@router.post("/submissions/{submission_id}/retry")
def post_retry(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    submission_id: SubmissionId,
) -> Response:
    """Queue a failed submission again."""

    def take(session: Session, values: Mapping[str, str]) -> None:
        actor = browser.principal.actor
        retry_submission(session, submission_id, actor=actor, reason=values["reason"])

    with services.database.read() as session:
        step = _retry(find_submission(session, submission_id))
    return take_step(request, services, browser, step, form, take, "submission_retried")


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


@router.get("/similar/{phase_id}")
def show_similar(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    phase_id: Annotated[str, Path(max_length=64)],
) -> Response:
    """Show teams whose submissions are alike, and those that probe: reasons to ask, not proof."""
    with services.database.read() as session:
        title = find_phase(session, phase_id).title
        report = similarity_report(session, phase_id)
    return organizer_page(
        request,
        browser,
        "submissions/organizer_similar.html",
        "phases",
        title=title,
        report=report,
        pairs=report.pairs[:SHOWN_PAIRS],
        most_of_a_team=SHOWN_OF_A_TEAM,
    )
