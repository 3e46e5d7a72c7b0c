"""Keeps a worker from scoring while another one has a newer scorer."""

from sqlalchemy.orm import Session

from exceptiondrive_records.work.heartbeats import newer_scorer
from exceptiondrive_scoring import SCORER_VERSION


class OlderScorerError(Exception):
    """A worker with a newer scorer is already running."""

    def __init__(self, newer: str) -> None:
        super().__init__(
            f"this worker's scorer is version {SCORER_VERSION}, and version {newer} works already: "
            "upgrade this worker. To go back on purpose, stop the newer workers first."
        )


def refuse_if_older(session: Session) -> None:
    """Refuse to start a worker, or a job, whose scores would come from an older scorer.

    Raises:
        OlderScorerError: A newer scorer is in the list of workers.
    """
    newer = newer_scorer(session, SCORER_VERSION)
    if newer is not None:
        raise OlderScorerError(newer)
