"""What tests with a real broker ask of the records."""

from collections.abc import Callable
from typing import Any

from sqlalchemy import func, select

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.split import Split

World = Any
QUICK = {
    "soft_time_limit_s": 4.0,
    "time_limit_s": 4.5,
    "lease_s": 5.0,
    "board_lease_s": 3.0,
    "reconcile_every_s": 0.2,
    "retry_backoff_s": 0.2,
    "heartbeat_every_s": 1.0,
    "max_attempts": 6,
}


def count_scored(world: World) -> int:
    with world.database.read() as session:
        query = select(func.count()).where(Submission.status == SubmissionStatus.SCORED)
        return int(session.scalar(query) or 0)


def count_leased(world: World) -> int:
    with world.database.read() as session:
        return int(session.scalar(select(func.count()).where(Job.state == WorkState.LEASED)) or 0)


def n_alive(world: World) -> int:
    with world.database.read() as session:
        return live_workers(session, Lane.LIVE)


def scored_lines(world: World) -> list[str]:
    with world.database.read() as session:
        query = select(AuditLine.subject).where(AuditLine.action == "submission scored")
        return list(session.scalars(query))


def assert_all_scored_once(world: World, submission_ids: list[str]) -> None:
    with world.database.read() as session:
        statuses = {row.id: row.status for row in session.scalars(select(Submission))}
        sheets = list(session.scalars(select(ScoreSheetRow.submission_id)))
    assert statuses == dict.fromkeys(submission_ids, SubmissionStatus.SCORED)
    assert sorted(sheets) == sorted(submission_ids)
    assert sorted(scored_lines(world)) == sorted(submission_ids), "one audit line for each"


def submit_many(
    world: World, split: Split, planning_file: Callable[..., bytes], n: int
) -> list[str]:
    return [
        world.submit(planning_file(split, edited_mps=1 + i / 10), method=f"m{i}")[0]
        for i in range(n)
    ]
