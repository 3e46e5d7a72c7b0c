"""The jobs that the broker may call by name: ids in, nothing out."""

from collections.abc import Callable

from celery import Celery

from exceptiondrive_schemas.jobs import JobName
from exceptiondrive_worker.board_run import build_board
from exceptiondrive_worker.doors import Doors
from exceptiondrive_worker.failures import Failure, job_boundary
from exceptiondrive_worker.scorer_version import may_work
from exceptiondrive_worker.scoring_run import answer_ring, ring_on
from exceptiondrive_worker.verify_run import verify_sheet


def register_jobs(app: Celery, doors: Callable[[], Doors]) -> None:
    """Give the app its jobs.

    Args:
        app: The worker's Celery app.
        doors: Returns the doors of the process that calls it.
    """

    @app.task(name=JobName.SCORE.value)
    def score(job_id: str) -> None:
        with job_boundary(job_id, _left_to_the_reconciler):
            if may_work(doors().database):
                answer_ring(doors(), job_id)

    @app.task(name=JobName.BUILD_BOARD.value)
    def board(phase_id: str, protocol_digest: str, split_revision: str | None = None) -> None:
        with job_boundary(f"board:{phase_id}", _left_to_the_reconciler):
            if may_work(doors().database):
                build_board(doors(), phase_id, protocol_digest, split_revision)
                ring_on(doors())

    @app.task(name=JobName.VERIFY.value)
    def verify(item_id: str) -> None:
        with job_boundary(item_id, _left_to_the_reconciler):
            if may_work(doors().database):
                verify_sheet(doors(), item_id)


def _left_to_the_reconciler(failure: Failure) -> None:
    """Nothing could be recorded: the lease runs out, and the reconciler rings again."""
