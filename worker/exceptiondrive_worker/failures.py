"""The job boundary: every error becomes a stable code, and nothing withheld gets out.

The worker's own log gets the type of the error and its traceback locations, never its message,
which may quote a value. Only messages of an unavailable or refusing database are logged.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import structlog
from billiard.exceptions import SoftTimeLimitExceeded
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from exceptiondrive_records.db.database import is_forbidden, reason_of
from exceptiondrive_records.db.errors import NotFound, StoreError
from exceptiondrive_records.operations.logs import places
from exceptiondrive_records.submissions.file_store import FileDamaged, FileUnreadable
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.floors import FloorHeldError, SplitDayFullError

_log = structlog.get_logger("exceptiondrive.worker")


class FailureCode(StrEnum):
    """Why we could not score. Codes are stable."""

    INTERNAL = "internal_error"
    TIME_LIMIT = "time_limit"
    OUT_OF_MEMORY = "out_of_memory"
    UPLOAD_DAMAGED = "upload_damaged"
    UPLOAD_MISSING = "upload_missing"
    UPLOAD_UNREADABLE = "upload_unreadable"
    STORE_UNAVAILABLE = "store_unavailable"
    RECORDS_UNAVAILABLE = "records_unavailable"
    SPLIT_REFUSED = "split_refused"
    SPLIT_FLOOR = "split_floor"
    SPLIT_DAY_FULL = "split_day_full"


@dataclass(frozen=True)
class Failure:
    """A code, a sentence for the team, and whether a retry may help."""

    code: FailureCode
    message: str
    may_retry: bool = True
    is_outage: bool = False
    """Whether something that every job needs was unavailable; this does not count as an attempt."""


INTERNAL = Failure(FailureCode.INTERNAL, "Scoring failed on our side; the organizers can see it.")
_RECORDS_AWAY = Failure(
    FailureCode.RECORDS_UNAVAILABLE, "The records did not answer.", is_outage=True
)
_FAILURES: dict[type[BaseException], Failure] = {
    SoftTimeLimitExceeded: Failure(FailureCode.TIME_LIMIT, "Scoring took longer than it may."),
    MemoryError: Failure(FailureCode.OUT_OF_MEMORY, "Scoring took more memory than it may."),
    FileDamaged: Failure(
        FailureCode.UPLOAD_DAMAGED,
        "The stored upload no longer has the bytes that you sent; the organizers can see it.",
        may_retry=False,
    ),
    FileUnreadable: Failure(FailureCode.UPLOAD_UNREADABLE, "The stored upload could not be read."),
    StoreError: Failure(
        FailureCode.STORE_UNAVAILABLE, "The store of uploads did not answer.", is_outage=True
    ),
    NotFound: Failure(FailureCode.UPLOAD_MISSING, "The stored upload could not be found."),
    SplitRefusedError: Failure(
        FailureCode.SPLIT_REFUSED,
        "The split cannot be scored under this protocol; the organizers can see why.",
        may_retry=False,
    ),
    SplitDayFullError: Failure(
        FailureCode.SPLIT_DAY_FULL,
        "As many submissions as the withheld split allows were scored within a day; the "
        "organizers can have this one scored later.",
        may_retry=False,
    ),
    FloorHeldError: Failure(
        FailureCode.SPLIT_FLOOR,
        "The phase asks for more of its withheld split than the split's floors allow; the "
        "organizers can see what.",
        may_retry=False,
    ),
}
"""By type of error; the first match wins."""


def failure_of(error: BaseException) -> Failure:
    """Return what an error means for the submission."""
    if isinstance(error, OperationalError | InterfaceError | PoolTimeout):
        return INTERNAL if is_forbidden(error) else _RECORDS_AWAY
    return next(
        (failure for kind, failure in _FAILURES.items() if isinstance(error, kind)), INTERNAL
    )


def run_job(job: str, do: Callable[[], object], on_failure: Callable[[Failure], None]) -> bool:
    """Run a job and let no error out of it: log its type and place, and pass its meaning on.

    Returns:
        Whether further jobs may succeed: False if something that all of them need was unavailable.
    """
    try:
        do()
    except Exception as error:  # noqa: BLE001 - the one job boundary
        failure = failure_of(error)
        _log.error(
            "job failed",
            job=job,
            code=failure.code.value,
            error=f"{type(error).__module__}.{type(error).__qualname__}",
            places=places(error),
            **reason_of(error),
        )
        on_failure(failure)
        return not failure.is_outage
    return True
