"""Which scorer may score: two versions must never make sheets of one board.

Whoever finds a newer scorer among the workers refuses to work. Workers that stop in good order leave
the list, so that an organizer can go back to an older release on purpose.
"""

import structlog
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.work.heartbeats import newer_scorer
from exceptiondrive_scoring import SCORER_VERSION

_log = structlog.get_logger("exceptiondrive.worker")


class OlderScorerError(Exception):
    """A newer scorer works already."""

    def __init__(self, newer: str) -> None:
        super().__init__(
            f"this worker's scorer is version {SCORER_VERSION}, and version {newer} works already: "
            "upgrade this worker. To go back on purpose, stop the newer workers first."
        )


def refuse_if_older(database: Database) -> None:
    """Let no worker begin whose scores would be of an older scorer; each job asks again.

    A database that is away refuses nobody: no job can begin without it.

    Raises:
        OlderScorerError: A newer scorer is on the list of workers.
    """
    try:
        with database.read() as session:
            newer = newer_scorer(session, SCORER_VERSION)
    except SQLAlchemyError:
        return
    if newer is not None:
        raise OlderScorerError(newer)


def may_work(database: Database) -> bool:
    """Whether no newer scorer has joined since this worker began; the log says so otherwise."""
    try:
        refuse_if_older(database)
    except OlderScorerError as error:
        _log.error("scorer version mismatch: the job is left to newer workers", reason=str(error))
        return False
    return True
