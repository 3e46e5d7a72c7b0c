"""Errors of the system of record, each with a stable code and a sentence for the reader."""

# ruff: noqa: N818 - these names say what happened

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.printable import counted


class RecordsError(Exception):
    """A request that the records refuse; `str()` is a sentence for its sender."""

    code: ProblemCode = ProblemCode.BAD_REQUEST


class InvalidRecord(RecordsError):
    """A value is invalid; `fields` names the invalid parts of the request."""

    code = ProblemCode.BAD_REQUEST

    def __init__(self, detail: str, fields: Mapping[str, str] | None = None) -> None:
        self.fields = dict(fields or {})
        super().__init__(detail)


class NotListed(InvalidRecord):
    """The page requested begins after an item that is not in the list."""

    def __init__(self) -> None:
        super().__init__(
            "The list has no such place: begin with its first page.",
            {"after": "must be taken from the page before"},
        )


class NotFound(RecordsError):
    """It does not exist, or the sender may not see it; the sentence is the same."""

    code = ProblemCode.NOT_FOUND

    def __init__(self, kind: str, name: str, until: str = "") -> None:
        super().__init__(f"There is no {kind}{f' {name!r}' if name else ''}{until}.")


class Conflict(RecordsError):
    """The request conflicts with the present records."""

    code = ProblemCode.CONFLICT


class NotConfirmed(RecordsError):
    """The upload would replace an entry of the team, and the request does not confirm that."""

    code = ProblemCode.NOT_CONFIRMED


class NotAllowed(RecordsError):
    """The sender may not do this."""

    code = ProblemCode.NOT_ALLOWED


class TooManyAttempts(RecordsError):
    """Sign-in or registration was tried too often."""

    code = ProblemCode.TOO_MANY_REQUESTS

    def __init__(self, resets_at: datetime, now: datetime) -> None:
        self.resets_at = resets_at
        minutes = max(1, math.ceil((resets_at - now).total_seconds() / 60))
        super().__init__(f"Too many attempts; try again in {counted(minutes, 'minute')}.")


class PhaseClosed(RecordsError):
    """The phase takes no submissions now."""

    code = ProblemCode.PHASE_CLOSED

    def __init__(self, title: str, because: str) -> None:
        super().__init__(f"The phase {title!r} takes no submissions now: it {because}.")


class QuotaExceeded(RecordsError):
    """The team has no submissions left; `resets_at` is None if the total quota is used up."""

    code = ProblemCode.QUOTA_EXCEEDED

    def __init__(self, limit: int, *, resets_at: datetime | None) -> None:
        self.limit = limit
        self.resets_at = resets_at
        if resets_at is None:
            text = f"Your team has used its {counted(limit, 'submission')} of this phase."
        else:
            text = (
                f"Your team has used its {counted(limit, 'submission')} of today; "
                f"the next day begins at {resets_at:%Y-%m-%d %H:%M} UTC."
            )
        super().__init__(text)


class RejectedCapExceeded(RecordsError):
    """Too many files of the team were rejected, or failed, today."""

    code = ProblemCode.REJECTED_CAP_EXCEEDED

    def __init__(self, limit: int, *, resets_at: datetime) -> None:
        self.limit = limit
        self.resets_at = resets_at
        super().__init__(
            f"{limit} files of your team brought no score today, which is the limit; faulty ones count, and "
            f"sound ones that could not be scored. The next day begins at {resets_at:%Y-%m-%d %H:%M} UTC. A submission says "
            "what is wrong with its file; `exceptiondrive check FILE --phase PHASE` says it before you submit."
        )


class ConcurrentQuotaExceeded(RecordsError):
    """Too many submissions of the team still wait; the next scored one frees a place."""

    code = ProblemCode.TOO_MANY_REQUESTS

    def __init__(self, limit: int) -> None:
        noun = "submission waits" if limit == 1 else "submissions wait"
        super().__init__(
            f"{limit} {noun} for a score, and a team may have no more waiting in this phase. "
            "Try again when one of them is scored; nothing was counted."
        )


class StoreError(RecordsError):
    """The file store cannot give or take a file."""

    code = ProblemCode.STORE_UNAVAILABLE

    @property
    def reason(self) -> str:
        """The error of the system or the store, for operators only: it may name a path."""
        return str(self.__cause__ or self).partition("\n")[0][:300]


class UploadTooLarge(RecordsError):
    """The upload exceeds the size limit."""

    code = ProblemCode.UPLOAD_TOO_LARGE

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(f"The file is larger than {limit_bytes} bytes.")


# Results of a check of the records.


@dataclass(frozen=True, order=True)
class Violation:
    """A violated invariant: which rule, by what, and how."""

    rule: str
    subject: str
    text: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.subject}: {self.text}"


class UploadEmpty(RecordsError):
    """The file is empty."""

    code = ProblemCode.UPLOAD_EMPTY

    def __init__(self) -> None:
        super().__init__("The file holds nothing; choose another one.")
