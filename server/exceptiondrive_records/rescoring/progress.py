"""Measure the progress of a run: missing and failed sheets, and its rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, Select, exists, func, not_, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import (
    entry_ids,
    is_draft,
    last_flip_at,
    latest_board,
)
from exceptiondrive_records.boards.standings import entry_ids_for_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.scoring_keys import ScoringKey, is_of_key, shadow_key
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.board_requests import board_begun_at, is_board_wanted, want_board
from exceptiondrive_records.work.tables import OPEN_STATES, Job, WorkState
from exceptiondrive_schemas.api.rescoring import Progress, RunState
from exceptiondrive_schemas.api.submission import WAITING, SubmissionStatus

_RATE_WINDOW = timedelta(seconds=30)
_LEAST_S = 1.0
"""Minimum time for the rate: the first sheets, within milliseconds, would give too high a rate."""


@dataclass(frozen=True)
class Counts:
    """Counts of a phase's scored submissions under one key."""

    total: int
    done: int
    failed: int

    @property
    def missing(self) -> int:
        """The number of missing sheets, including failed ones."""
        return self.total - self.done


def count_sheets(session: Session, phase_id: str, key: ScoringKey) -> Counts:
    """Count the scored submissions of a phase, those with a sheet of a key, and those that failed."""
    done = _count(session, _scored_submissions(phase_id).where(_has_sheet(key)))
    failed = _count(session, failed_sheets(phase_id, key))
    return Counts(count_scored(session, phase_id), done, failed)


def count_scored(session: Session, phase_id: str) -> int:
    """Return how many submissions of a phase are scored: an update computes that many sheets."""
    return _count(session, _scored_submissions(phase_id))


def _count(session: Session, query: Select[Any]) -> int:
    return session.scalar(query.with_only_columns(func.count())) or 0


def scored_left_out(phase_id: str, key: ScoringKey, limit: int) -> Select[Submission]:
    """Select the first scored ones of `left_out`."""
    is_scored = Submission.status == SubmissionStatus.SCORED
    return left_out(phase_id, key).where(is_scored).limit(limit)


def left_out(phase_id: str, key: ScoringKey) -> Select[Submission]:
    """Select scored or waiting submissions that have neither sheet nor job under a key."""
    return (
        select(Submission)
        .where(
            Submission.phase_id == phase_id,
            Submission.status.in_((*WAITING, SubmissionStatus.SCORED)),
        )
        .where(not_(_has_sheet(key)), not_(_jobs_of(key).exists()))
        .order_by(Submission.received_at, Submission.id)
    )


def failed_sheets(phase_id: str, key: ScoringKey) -> Select[Submission]:
    """Select scored submissions whose job has ended without a sheet."""
    ended = _jobs_of(key).where(Job.state.not_in(OPEN_STATES)).exists()
    return _scored_submissions(phase_id).where(not_(_has_sheet(key)), ended)


def jobs_in(phase_id: str, key: ScoringKey, states: Sequence[WorkState]) -> Select[str]:
    """Select the ids of the jobs of a phase under a key that are in one of these states."""
    return (
        select(Job.id)
        .join(Submission, Submission.id == Job.submission_id)
        .where(Submission.phase_id == phase_id, is_of_key(Job, key), Job.state.in_(states))
    )


def count_jobs(
    session: Session, phase_id: str, key: ScoringKey, states: Sequence[WorkState]
) -> int:
    """Return how many jobs of a phase under a key are in one of these states."""
    return _count(session, jobs_in(phase_id, key, states))


def progress_of(session: Session, run: RescoringRun) -> Progress:
    """Return done, total and failed, and while scoring the measured rate and remaining time.

    No remaining time is given once all sheets have started: the last may wait for a lost lease.
    """
    if run.ended_with is not None:
        return run.ended_with
    key = shadow_key(run)
    counts = count_sheets(session, run.phase_id, key)
    rate = _sheets_per_s(session, run, key) if run.state is RunState.SCORING else None
    waiting = counts.missing - counts.failed
    begun = count_jobs(session, run.phase_id, key, [WorkState.LEASED]) if rate else 0
    return Progress(
        done=counts.done,
        total=counts.total,
        failed=counts.failed,
        sheets_per_s=None if rate is None else round(rate, 2),
        remaining_s=round(waiting / rate, 1) if rate and waiting > begun else None,
    )


def _sheets_per_s(session: Session, run: RescoringRun, key: ScoringKey) -> float | None:
    """Return sheets per second over the last half minute, or since scoring resumed."""
    if run.resumed_at is None:
        return None
    now = database_now(session)
    since: datetime = max(run.resumed_at, now - _RATE_WINDOW)
    query = (
        select(func.count())
        .select_from(ScoreSheetRow)
        .join(Submission, Submission.id == ScoreSheetRow.submission_id)
        .where(
            Submission.phase_id == run.phase_id,
            is_of_key(ScoreSheetRow, key),
            ScoreSheetRow.created_at >= since,
        )
    )
    made = session.scalar(query) or 0
    elapsed_s = max((now - since).total_seconds(), _LEAST_S)
    return made / elapsed_s if made else None


def _scored_submissions(phase_id: str) -> Select[Submission]:
    return select(Submission).where(
        Submission.phase_id == phase_id, Submission.status == SubmissionStatus.SCORED
    )


def _has_sheet(key: ScoringKey) -> ColumnElement[bool]:
    return exists().where(
        ScoreSheetRow.submission_id == Submission.id, is_of_key(ScoreSheetRow, key)
    )


def _jobs_of(key: ScoringKey) -> Select[str]:
    return select(Job.id).where(Job.submission_id == Submission.id, is_of_key(Job, key))


# Whether the board that is not shown yet agrees with the present sheets.


def fresh_board(session: Session, phase_id: str, key: ScoringKey) -> BoardRow | None:
    """Return the newest board under a key if it lists exactly the entries that are due now.

    A draft also has former ranks: it is not fresh if the shown board changed after its build began.
    """
    if is_board_wanted(session, phase_id, *key):
        return None
    row = latest_board(session, phase_id, key)
    if row is None or entry_ids(session, row.id) != entry_ids_for_board(session, phase_id, key):
        return None
    flipped_at, begun_at = last_flip_at(session, phase_id), board_begun_at(session, phase_id, *key)
    is_behind = flipped_at is not None and begun_at is not None and begun_at < flipped_at
    return None if is_behind and is_draft(session, row) else row


def want_fresh_board(session: Session, phase_id: str, key: ScoringKey) -> None:
    """Request the board under a key, unless it is fresh or already requested."""
    if is_board_wanted(session, phase_id, *key):
        return
    if fresh_board(session, phase_id, key) is None:
        want_board(session, phase_id, *key)
