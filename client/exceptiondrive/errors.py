"""What can go wrong for a participant; every error has a code, a sentence and an exit code.

ExceptionDriveError
├── InvalidArgumentError      exit 2   the request itself is wrong
│   ├── InvalidFileError      exit 2   the file cannot be scored; carries the `CheckReport`
│   ├── RecorderError         exit 2   what a planner gave cannot be recorded; a ValueError too
│   └── NotFoundError         exit 2   no such phase, submission, split or protocol
├── QuotaError                exit 3   enough submitted for now; knows when the count resets
├── NotAllowedError           exit 4   phase closed, the token may not do this, or the records forbid it
│   └── NotSignedInError      exit 4   no token, or one that the server does not accept
├── NetworkError              exit 5   the server cannot be reached, or asks to come back later
│   └── ServerError           exit 5   the server answered with a fault of its own
├── ScoringFailedError        exit 6   the submission will get no score, and not for its file
└── WaitTimeoutError          exit 7   not scored yet; the submission itself is safe
"""

from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from exceptiondrive_schemas.api.submission import SubmissionView
    from exceptiondrive_schemas.faults import CheckReport


class ExceptionDriveError(Exception):
    """Base of all errors of this package.

    Attributes:
        code: A stable word for scripts.
        sentence: What is wrong.
        advice: What to do next; may be empty.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, code: str, sentence: str, advice: str = "") -> None:
        self.code = code
        self.sentence = sentence
        self.advice = advice
        super().__init__(f"{sentence} {advice}".strip())

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it cross from one process to another, as of a pool: kinds differ in what makes them."""
        return _unpickled, (type(self), *self.args), self.__dict__

    def document(self) -> dict[str, Any]:
        """Return the error as `--json` prints it."""
        return {
            "code": self.code,
            "message": self.sentence,
            "advice": self.advice,
            "exit_code": self.exit_code,
        }


def _unpickled(kind: type[ExceptionDriveError], *args: str) -> ExceptionDriveError:
    """Return an error whose attributes are set by who unpickles it."""
    return kind.__new__(kind, *args)


class InvalidArgumentError(ExceptionDriveError):
    """The request is wrong: an argument, a field, a file."""

    exit_code = 2

    def __init__(
        self, code: str, sentence: str, advice: str = "", fields: dict[str, str] | None = None
    ) -> None:
        self.fields = dict(fields or {})
        super().__init__(code, sentence, advice)

    def document(self) -> dict[str, Any]:
        """Return the error with the fields that are wrong."""
        return {**super().document(), "fields": self.fields}


def extra_missing(sentence: str, extra: str, otherwise: str = "") -> InvalidArgumentError:
    """Return what is said where a library is not installed that an extra of the client brings."""
    advice = f'Run: pip install "exceptiondrive[{extra}]"{otherwise}'
    return InvalidArgumentError("extra_missing", sentence, advice)


def reason_of(error: Exception) -> str:
    """Return why JSON cannot be read or written, where Python would speak of its own recursion too."""
    return "nested too deeply" if isinstance(error, RecursionError) else str(error)


IT_IS_SAFE = "It is safe and will be scored; look with: exceptiondrive status {}"
"""What is said of a submission that is no longer waited for."""
SUBMIT_AGAIN = "Correct the faults in the list and submit again; nothing was counted."


class InvalidFileError(InvalidArgumentError):
    """The file cannot be scored; `report` lists every fault."""

    def __init__(
        self,
        report: "CheckReport",
        sentence: str = "",
        advice: str = "Correct the faults in the list.",
    ) -> None:
        self.report = report
        kinds = ", ".join(f"{group.code} ({group.count})" for group in report.faults)
        super().__init__("file_invalid", sentence or f"The file cannot be scored: {kinds}.", advice)

    def __str__(self) -> str:
        """Return what a traceback shows: below the sentences a line for each kind of fault."""
        lines = [f"- {group.code} ({group.count}): {group.message}" for group in self.report.faults]
        return "\n".join([super().__str__(), *lines])

    def document(self) -> dict[str, Any]:
        """Return the error with the whole report."""
        return {**super().document(), "report": self.report.model_dump(mode="json")}


class NotFoundError(InvalidArgumentError):
    """The server knows nothing of this name."""


class RecorderError(InvalidArgumentError, ValueError):
    """A sample, or the whole recording, cannot become a valid file; the message says why."""

    def __init__(self, sentence: str) -> None:
        super().__init__("wrong_recording", sentence)


class QuotaError(ExceptionDriveError):
    """Enough submitted for now."""

    exit_code = 3

    def __init__(self, code: str, sentence: str, resets_at: datetime | None) -> None:
        self.resets_at = resets_at
        advice = "" if resets_at is None else f"The count resets at {utc_text(resets_at)}."
        super().__init__(code, sentence, advice)

    def document(self) -> dict[str, Any]:
        """Return the error with the time of the reset."""
        resets_at = None if self.resets_at is None else self.resets_at.isoformat()
        return {**super().document(), "resets_at": resets_at}


class NotAllowedError(ExceptionDriveError):
    """The phase is closed, or the token may not do this."""

    exit_code = 4


class NotSignedInError(NotAllowedError):
    """No token, or one that the server does not accept."""


class NetworkError(ExceptionDriveError):
    """The server cannot be reached, or asks to come back later."""

    exit_code = 5


class ServerError(NetworkError):
    """The server answered with a fault of its own."""


class _SubmissionError(ExceptionDriveError):
    """Something about one submission, whose last known state it carries."""

    def __init__(self, code: str, sentence: str, advice: str, submission: "SubmissionView") -> None:
        self.submission = submission
        super().__init__(code, sentence, advice)

    def document(self) -> dict[str, Any]:
        """Return the error with the submission."""
        return {**super().document(), "submission": self.submission.model_dump(mode="json")}


class ScoringFailedError(_SubmissionError):
    """The submission will get no score, and not for its file."""

    exit_code = 6


class WaitTimeoutError(_SubmissionError):
    """Not scored within the time given; the submission itself is safe."""

    exit_code = 7


def utc_text(moment: datetime | str) -> str:
    """Return a time, of JSON too, as people read it: `2026-11-21 00:00 UTC`."""
    if isinstance(moment, str):
        moment = datetime.fromisoformat(moment.removesuffix("Z"))
        moment = moment.replace(tzinfo=moment.tzinfo or timezone.utc)
    return f"{moment.astimezone(timezone.utc):%Y-%m-%d %H:%M} UTC"
