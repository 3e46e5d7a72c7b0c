"""No worker scores beside one whose scorer is newer."""

from sqlalchemy.orm import Session

from exceptiondrive_records.work.heartbeats import newer_scorer
from exceptiondrive_scoring import SCORER_VERSION


class OlderScorerError(Exception):
    """A newer scorer works already."""

    def __init__(self, newer: str) -> None:
        super().__init__(
            f"this worker's scorer is version {SCORER_VERSION}, and version {newer} works already: "
            "upgrade this worker. To go back on purpose, stop the newer workers first."
        )


def refuse_if_older(session: Session) -> None:
    """Let no worker begin whose scores would be of an older scorer; each job asks again.

    Raises:
        OlderScorerError: A newer scorer is on the list of workers.
    """
    newer = newer_scorer(session, SCORER_VERSION)
    if newer is not None:
        raise OlderScorerError(newer)
