"""From an answer of the server that is not a success to the error that says so."""

from datetime import UTC, datetime, timedelta
from typing import NoReturn

from pydantic import ValidationError

from exceptiondrive.errors import (
    ExceptionDriveError,
    InvalidArgumentError,
    InvalidFileError,
    NetworkError,
    NotAllowedError,
    NotFoundError,
    NotSignedInError,
    QuotaError,
    ServerError,
)
from exceptiondrive.http import httpx
from exceptiondrive_schemas.problems import Problem, ProblemCode

_ADVICE = {
    ProblemCode.NOT_SIGNED_IN: "Run: exceptiondrive login (or set EXCEPTIONDRIVE_TOKEN).",
    ProblemCode.NOT_ALLOWED: "Your token may not do this; `exceptiondrive whoami` shows its scopes.",
    ProblemCode.PHASE_CLOSED: "Run: exceptiondrive phases, to see which are open.",
    ProblemCode.UPLOAD_TOO_LARGE: "Compress the file with gzip; both forms are taken.",
    ProblemCode.TOO_MANY_REQUESTS: "Wait a little and run the same command again.",
    ProblemCode.STORE_UNAVAILABLE: "Wait a little and run the same command again.",
}
_KINDS: dict[ProblemCode, type[ExceptionDriveError]] = {
    ProblemCode.NOT_SIGNED_IN: NotSignedInError,
    ProblemCode.NOT_ALLOWED: NotAllowedError,
    ProblemCode.PHASE_CLOSED: NotAllowedError,
    ProblemCode.CONFLICT: NotAllowedError,
    ProblemCode.NOT_FOUND: NotFoundError,
    ProblemCode.TOO_MANY_REQUESTS: NetworkError,
    ProblemCode.STORE_UNAVAILABLE: ServerError,
    ProblemCode.INTERNAL: ServerError,
}
_QUOTA_CODES = (ProblemCode.QUOTA_EXCEEDED, ProblemCode.REJECTED_CAP_EXCEEDED)


def raise_problem(response: "httpx.Response") -> NoReturn:
    """Raise the error that this answer stands for."""
    try:
        problem = Problem.read(response.content)
    except ValidationError:
        raise _unknown_answer(response) from None
    raise error_of(problem, retry_after_s(response))


def error_of(problem: Problem, wait_s: float | None = None) -> ExceptionDriveError:
    """Return the error for a problem document.

    Args:
        problem: What the server said.
        wait_s: Seconds of its Retry-After header.
    """
    if problem.report is not None and problem.report.faults:
        return InvalidFileError(problem.report, problem.detail)
    if problem.code in _QUOTA_CODES:
        wait_s = problem.retry_after_s if problem.retry_after_s is not None else wait_s
        return QuotaError(problem.code.value, problem.detail, _reset(wait_s))
    advice = _ADVICE.get(problem.code, "")
    is_ours = problem.code is ProblemCode.INTERNAL
    if is_ours and problem.request_id and problem.request_id not in problem.detail:
        advice = f"Tell the organizers this request id: {problem.request_id}."
    kind = _KINDS.get(problem.code)
    if kind is None:
        sentence = " ".join([problem.detail, *(f"{k}: {v}" for k, v in problem.fields.items())])
        return InvalidArgumentError(problem.code.value, sentence, advice, problem.fields)
    return kind(problem.code.value, problem.detail, advice)


def retry_after_s(response: "httpx.Response") -> float | None:
    """Return the seconds of a Retry-After header, or None."""
    value = response.headers.get("retry-after", "")
    return float(value) if value.isascii() and value.isdigit() else None


def _reset(wait_s: float | None) -> datetime | None:
    """Return the time in `wait_s` seconds, to the nearest minute."""
    if wait_s is None:
        return None
    moment = datetime.now(UTC) + timedelta(seconds=wait_s + 30)
    return moment.replace(second=0, microsecond=0)


def _unknown_answer(response: "httpx.Response") -> ExceptionDriveError:
    """Return the error for an answer in another form, such as that of a proxy on the way."""
    answered = f"{response.url.copy_with(query=None)} answered {response.status_code}"
    match response.status_code:
        case 413:
            code = ProblemCode.UPLOAD_TOO_LARGE
            return InvalidArgumentError(
                code.value, f"{answered}: a proxy on the way takes no file so large.", _ADVICE[code]
            )
        case 429:
            code = ProblemCode.TOO_MANY_REQUESTS
            return NetworkError(
                code.value, f"{answered}: a proxy on the way wants fewer requests.", _ADVICE[code]
            )
        case 502 | 503 | 504:
            return ServerError(
                ProblemCode.STORE_UNAVAILABLE.value,
                f"{answered}: no server behind this address answers right now.",
                "Wait a little and run the same command again; a file that is sent twice counts "
                "once.",
            )
    return ServerError(
        "unexpected_answer",
        f"{answered}, and not in the form of an ExceptionDrive server.",
        "Check the address of the server, and that this client is as new as the server.",
    )
