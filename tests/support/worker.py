"""A worker in the test's own process: its places, splits and uploads, and what it does when asked."""

from pathlib import Path
from typing import Any

from sqlalchemy import select
from tests.support.floors import leave_open
from tests.support.records import next_moment
from tests.support.work import claim_board_of, is_job

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.submissions import Accepted, accept
from exceptiondrive_records.teams.teams import create_team, find_team, list_teams
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Job, WorkState
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.boards.run import build_board
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.scoring_run import score_next
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.admin import register_all_splits
from exceptiondrive_worker.splits.store import SplitStore


def worker_settings(folder: Path, database_url: str, **changes: Any) -> WorkerSettings:
    """Settings of a worker whose every place is in a folder, and whom no broker wakes."""
    usual: dict[str, Any] = {
        "database_url": database_url,
        "broker_url": f"redis+socket://{folder}/nobody.sock",
        "file_store_url": (folder / "uploads").as_uri(),
        "splits_dir": folder / "splits",
        "private_dir": folder / "private",
    }
    return WorkerSettings(**usual | changes)


def add_split(
    database: Database,
    splits_dir: Path,
    split: Split,
    file_name: str = "split.json",
    words: str = "",
) -> str:
    """Put a split file where workers look, register it, and return its revision."""
    folder = splits_dir / split.name
    leave_open(folder)
    (folder / file_name).write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    registered = register_all_splits(database, SplitStore(splits_dir), packaged_protocol(), words)
    revisions = {each.manifest.name: each.manifest.revision for each in registered}
    return revisions[split.name]


def submit(
    database: Database,
    files: FileStore,
    data: bytes,
    *,
    method: str,
    team: str = "alpha",
    phase_id: str = "dev",
    **more: Any,
) -> Accepted:
    """Accept an upload as the server does; a team that is not there is made."""
    digest, size = files.put_stream([data], limit_bytes=2**24)
    next_moment(database)
    with database.write() as session:
        if team not in [known.slug for known in list_teams(session)]:
            is_reference = team.startswith("reference")
            create_team(session, team, team.title(), is_reference=is_reference, actor="test")
        return accept(
            session,
            team_id=find_team(session, team).id,
            phase_id=phase_id,
            method=method,
            file_digest=digest,
            size_bytes=size,
            **more,
        )


def due_jobs(database: Database) -> list[str]:
    """Ids of the jobs that may be scored now, fresh submissions first."""
    query = select(Job).where(Job.state == WorkState.QUEUED).order_by(Job.lane, Job.created_at)
    with database.read() as session:
        return [job.id for job in session.scalars(query)]


def score_submission(context: WorkerContext, job_id: str) -> bool:
    """Score this very job; whether it was free."""
    with context.database.read() as session:
        job = session.get(Job, job_id)
    return (
        job is not None and job.lane is not None and score_next(context, job.lane, is_job(job_id))
    )


def build_board_of(
    context: WorkerContext, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> None:
    """Build this very board if it is wanted, whatever its pace."""
    with context.database.write() as session:
        request = claim_board_of(session, phase_id, protocol_digest, split_revision)
    if request is not None:
        build_board(context, request)


def build_wanted_boards(context: WorkerContext) -> bool:
    """Build every board that is wanted, whatever its pace; whether there was one."""
    wanted = select(BoardRequest).where(BoardRequest.state.in_(OPEN_STATES))
    with context.database.read() as session:
        keys = [
            (row.phase_id, row.protocol_digest, row.split_revision)
            for row in session.scalars(wanted)
        ]
    for key in keys:
        build_board_of(context, *key)
    return bool(keys)
