"""A worker in the test's own process: certain jobs and boards, at once."""

from tests.support.work import claim_board_of

from exceptiondrive_records.work.tables import Job
from exceptiondrive_worker.boards.run import build_board
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.scoring_run import score_next


def score_submission(context: WorkerContext, job_id: str) -> bool:
    """Score this very job; whether it was free."""
    with context.database.read() as session:
        job = session.get(Job, job_id)
    return (
        job is not None and job.lane is not None and score_next(context, job.lane, Job.id == job_id)
    )


def build_board_of(
    context: WorkerContext, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> None:
    """Build this very board if it is wanted, whatever its pace."""
    with context.database.write() as session:
        request = claim_board_of(session, phase_id, protocol_digest, split_revision)
    if request is not None:
        build_board(context, request)
