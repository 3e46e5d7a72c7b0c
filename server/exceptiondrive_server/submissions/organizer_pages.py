"""Submissions of all teams: filter, look, try again. No route shows a value of a sample."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.phases.phases import find_phase, list_phases
from exceptiondrive_records.protocols.protocols import list_protocols
from exceptiondrive_records.submissions.retry import retry_submission
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.submissions import find_submission, list_submissions
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams
from exceptiondrive_records.work.jobs import jobs_of
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.submission import SubmissionStatus, SubmissionView
from exceptiondrive_server.accounts.browser_session import PostedForm
from exceptiondrive_server.audit.organizer_pages import HistoryLine, history_lines
from exceptiondrive_server.submissions.view import Status, status_of, steps_of
from exceptiondrive_server.submissions.view import Step as Step_of_submission_view
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON, read, typed
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    organizer_page,
    step_page,
)

# Submissions as organizers see them: a filtered list, and the history of each.


@dataclass(frozen=True)
class SubmissionFilter:
    """What the list is narrowed to; empty: everything."""

    team: str = ""
    phase: str = ""
    status: str = ""

    def query(self, **more: str) -> str:
        """Return the list's address with this filter."""
        kept = {key: value for key, value in {**vars(self), **more}.items() if value}
        return "/organize/submissions" + (f"?{urlencode(kept)}" if kept else "")


@dataclass(frozen=True)
class SubmissionLine:
    """One submission in the list."""

    id: str
    method: str
    team: str
    team_slug: str
    phase: str
    received_at: datetime
    status: str
    failure_code: str | None


@dataclass(frozen=True)
class SubmissionsPage:
    """Everything that `submissions.html` needs."""

    lines: tuple[SubmissionLine, ...]
    chosen: SubmissionFilter
    teams: tuple[tuple[str, str], ...]
    phases: tuple[tuple[str, str], ...]
    statuses: tuple[str, ...]
    older_url: str | None


@dataclass(frozen=True)
class JobLine:
    """One scoring run of a submission."""

    protocol: str
    lane: str
    state: str
    attempts: int
    created_at: datetime
    finished_at: datetime | None
    is_first: bool


@dataclass(frozen=True)
class SubmissionDetail:
    """Everything that `submission.html` of the organizers needs."""

    seen: SubmissionView
    team_slug: str
    status: Status
    steps: tuple[Step_of_submission_view, ...]
    n_faults: int
    history: tuple[HistoryLine, ...]
    jobs: tuple[JobLine, ...]
    can_retry: bool


def submissions_view(
    submissions: Sequence[Submission],
    *,
    teams: Mapping[int, tuple[str, str]],
    phases: Sequence[tuple[str, str]],
    chosen: SubmissionFilter,
    shown: int,
) -> SubmissionsPage:
    """Set the list; one submission more than `shown` means that there are older ones.

    Args:
        submissions: Newest first.
        teams: Slug and name of each team, by its number.
        phases: Id and title of each phase.
        chosen: What the list is narrowed to.
        shown: How many a page shows.
    """
    has_older = len(submissions) > shown
    return SubmissionsPage(
        lines=tuple(_line(one, *teams[one.team_id]) for one in submissions[:shown]),
        chosen=chosen,
        teams=tuple(sorted(teams.values())),
        phases=tuple(phases),
        statuses=tuple(status.value for status in SubmissionStatus),
        older_url=chosen.query(after=submissions[shown - 1].id) if has_older else None,
    )


def submission_detail(
    seen: SubmissionView,
    *,
    team_slug: str,
    history: Sequence[HistoryLine],
    jobs: Sequence[Job],
    versions: Mapping[str, str],
) -> SubmissionDetail:
    """Set the page of one submission; `versions` names protocols by their digest."""
    faults = seen.report.faults if seen.report else ()
    return SubmissionDetail(
        seen=seen,
        team_slug=team_slug,
        status=status_of(seen),
        steps=steps_of(seen),
        n_faults=sum(group.count for group in faults),
        history=tuple(history),
        jobs=tuple(_job(job, versions) for job in jobs),
        can_retry=seen.status is SubmissionStatus.FAILED,
    )


def _line(one: Submission, slug: str, name: str) -> SubmissionLine:
    return SubmissionLine(
        id=one.id,
        method=one.method,
        team=name,
        team_slug=slug,
        phase=one.phase_id,
        received_at=one.received_at,
        status=one.status.value,
        failure_code=one.failure_code,
    )


def _job(job: Job, versions: Mapping[str, str]) -> JobLine:
    return JobLine(
        protocol=versions[job.protocol_digest],
        lane=str(job.lane),
        state=job.state.value,
        attempts=job.attempts,
        created_at=job.created_at,
        finished_at=job.finished_at,
        is_first=job.is_first,
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
    return organizer_page(
        request, browser, "submissions/organizer_submissions.html", "submissions", page=content
    )


@router.get("/{submission_id}")
def show_submission(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Show where a submission stands, and everything that ever happened to it."""
    with services.database.read() as session:
        content = _detail(session, find_submission(session, submission_id))
    return organizer_page(
        request, browser, "submissions/organizer_submission.html", "submissions", page=content
    )


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


# Teams whose submissions are alike, and teams that probe: reasons to ask, not proof.


similar_router = APIRouter(prefix="/organize/similar", include_in_schema=False)
SHOWN_PAIRS = 100
"""Pairs on the page, the most alike; the command lists them all."""
SHOWN_OF_A_TEAM = 10


@similar_router.get("/{phase_id}")
def show_similar(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    phase_id: Annotated[str, Path(max_length=64)],
) -> Response:
    """Show the report of a phase."""
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
