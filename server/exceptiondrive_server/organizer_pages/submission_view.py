"""Submissions as organizers see them: a filtered list, and the history of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from urllib.parse import urlencode

from exceptiondrive_records.tables import Submission
from exceptiondrive_records.work.tables_of_work import Job
from exceptiondrive_schemas.submission import SubmissionStatus, SubmissionView
from exceptiondrive_server.organizer_pages.audit_view import HistoryLine
from exceptiondrive_server.team_pages.status_words import Status, Step, status_of, steps_of


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
    steps: tuple[Step, ...]
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
