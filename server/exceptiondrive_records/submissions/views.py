"""Submissions as their team sees them: with place in the queue, sheet and rank."""

from collections.abc import Sequence
from statistics import median

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import entries_on, entry_ids
from exceptiondrive_records.boards.ranking import replaced_by
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.entries.selection import rule_of
from exceptiondrive_records.phases.disqualified import disqualified_since
from exceptiondrive_records.phases.policy import (
    frozen_since,
    is_anonymous,
    is_late,
    is_split_revealed,
    pseudonym_of_team,
    score_kept_back_since,
    shown_sheet,
)
from exceptiondrive_records.phases.quotas import WAITING
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.board_requests import is_board_wanted
from exceptiondrive_records.work.fair_share import jobs_ahead
from exceptiondrive_records.work.heartbeats import LiveWorkers, live_workers
from exceptiondrive_records.work.profiles import is_profile_coming
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import (
    Failure,
    QueuePlace,
    SubmissionStatus,
    SubmissionView,
)
from exceptiondrive_schemas.board import Links
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import MethodFacts
from exceptiondrive_schemas.score_sheet import ScoreSheet

_RECENT = 20
_RECENT_RUNS = (
    select(Job.leased_at, Job.finished_at)
    .where(Job.lane == Lane.LIVE, Job.state == WorkState.DONE, Job.finished_at.is_not(None))
    .order_by(Job.finished_at.desc())
    .limit(_RECENT)
)
_FIRST_JOB = select(Job).where(Job.submission_id == bindparam("submission"), Job.is_first)


def view(
    session: Session,
    submission: Submission,
    *,
    is_duplicate: bool = False,
    heartbeat_ttl_s: float = 15.0,
) -> SubmissionView:
    """Return a submission as its team sees it.

    Args:
        session: To read with.
        submission: The submission.
        is_duplicate: Whether these bytes came a second time.
        heartbeat_ttl_s: How old the last sign of life of a worker may be.
    """
    team = session.get_one(Team, submission.team_id)
    phase = session.get_one(Phase, submission.phase_id)
    is_scored = submission.status is SubmissionStatus.SCORED
    can_be_confirmed = submission.can_be_confirmed(database_now(session))
    hidden_since = score_kept_back_since(session, phase, submission)
    shows_sheet = is_scored and hidden_since is None
    shown = entries_on(session, phase.current_board_id).get(submission.id) if is_scored else None
    replaced = replaced_by(session, submission)
    disqualified_at = disqualified_since(session, submission)
    run_rule, is_chosen = rule_of(session, submission)
    is_published = not phase.policy.entries_private or submission.published_at is not None
    return SubmissionView(
        id=submission.id,
        phase=phase.id,
        challenge=phase.challenge,
        team=team.name,
        method=submission.method,
        description=submission.description,
        links=Links(paper=submission.paper_url, code=submission.code_url),
        facts=submission.facts or MethodFacts(),
        edited_at=submission.edited_at,
        linked_to=submission.linked_to,
        file_digest=submission.file_digest,
        size_bytes=submission.size_bytes,
        status=submission.status,
        received_at=submission.received_at,
        status_at=submission.status_at,
        queue=queue_place(session, submission, heartbeat_ttl_s=heartbeat_ttl_s),
        report=submission.report,
        failure=_failure(submission),
        sheet=published_sheet(session, submission, phase) if shows_sheet else None,
        rank=shown.rank if shown else None,
        rank_interval=shown.rank_interval if shown else None,
        intervals=shown.intervals if shown else {},
        unranked_because=shown.unranked_because if shown else None,
        awaits_board=is_scored
        and shown is None
        and replaced is None
        and is_published
        and disqualified_at is None
        and _is_board_coming(session, phase, submission),
        awaits_profile=is_scored
        and submission.report is None
        and is_profile_coming(session, submission.id),
        is_duplicate=is_duplicate,
        confirm_until=submission.confirm_until if can_be_confirmed else None,
        confirmed_as=submission.confirmed_as,
        is_late=is_late(phase, submission),
        replaced_by=replaced,
        is_chosen=is_chosen,
        run_rule=run_rule,
        is_published=is_published,
        score_kept_back_since=hidden_since,
        disqualified_at=disqualified_at,
        known_as=pseudonym_of_team(phase, team.id)
        if is_anonymous(phase) and not team.is_reference
        else None,
    )


def views(session: Session, submissions: Sequence[Submission]) -> tuple[SubmissionView, ...]:
    """Return several submissions as their team sees them."""
    return tuple(view(session, each) for each in submissions)


def _is_board_coming(session: Session, phase: Phase, submission: Submission) -> bool:
    """Whether the board is being built that will show what came in time."""
    if is_late(phase, submission) or frozen_since(phase, database_now(session)) is not None:
        return False
    key = key_of_phase(phase)
    return is_board_wanted(session, phase.id, key.protocol_digest, key.split_revision)


def queue_place(
    session: Session, submission: Submission, *, heartbeat_ttl_s: float = 15.0
) -> QueuePlace | None:
    """Return how many live jobs come before it in fair order now, and how long that may take.

    None when it has ended.
    """
    if submission.status not in WAITING:
        return None
    job = session.scalars(_FIRST_JOB, {"submission": submission.id}).first()
    if job is None or job.state.is_final:
        return None
    position = 0 if job.state is WorkState.LEASED else jobs_ahead(session, job)
    alive = live_workers(session, Lane.LIVE, ttl_s=heartbeat_ttl_s)
    return QueuePlace(
        position=position,
        expected_wait_s=_expected_wait_s(session, position, alive),
        attempts=job.attempts,
        workers_alive=alive.workers,
    )


def published_sheet(session: Session, submission: Submission, phase: Phase) -> ScoreSheet | None:
    """Return the sheet under the protocol and split revision that the phase shows, as it may be.

    After a reveal of the split that is the final entry's alone: else a team would learn which of
    its entries is the best on the private part.
    """
    board_id = phase.current_board_id
    if is_split_revealed(session, phase) and (
        board_id is None or submission.id not in entry_ids(session, board_id)
    ):
        return None
    key = (submission.id, phase.protocol_digest, phase.split_revision)
    row = session.get(ScoreSheetRow, key)
    return None if row is None else shown_sheet(phase, row, database_now(session))


def recent_scoring_s(session: Session) -> float | None:
    """Return the median duration of the last live scoring runs, measured by the database's clock."""
    durations_s = [
        (finished_at - leased_at).total_seconds()
        for leased_at, finished_at in session.execute(_RECENT_RUNS)
        if leased_at is not None and finished_at is not None
    ]
    return median(durations_s) if durations_s else None


def _expected_wait_s(session: Session, position: int, alive: LiveWorkers) -> float | None:
    """Until a slot is free: `position` jobs come first, and the slots work side by side."""
    scoring_s = recent_scoring_s(session)
    if scoring_s is None or alive.slots == 0:
        return None
    return round(max(0, position - alive.slots + 1) * scoring_s / alive.slots, 1)


def _failure(submission: Submission) -> Failure | None:
    if submission.failure_code is None:
        return None
    return Failure(code=submission.failure_code, message=submission.failure_message or "")
