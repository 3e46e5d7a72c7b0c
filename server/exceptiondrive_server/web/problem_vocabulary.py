"""The vocabulary of problems: meaning and advice of each code, and the exception to raise."""

from collections.abc import Mapping
from datetime import datetime
from typing import NamedTuple

from exceptiondrive_schemas.api.problems import ProblemCode


class ProblemKind(NamedTuple):
    """What is said of every problem of one code."""

    status: int
    """Of HTTP; 0 where the client alone says it."""
    title: str
    happened: str
    steps: tuple[str, ...]
    """What to do."""
    exit_code: int
    """What the client ends with."""
    in_browser: tuple[str, ...] = ()
    """What a reader of pages can do, who has no client in hand; else the same steps."""


PROBLEMS: Mapping[ProblemCode, ProblemKind] = {
    ProblemCode.BAD_REQUEST: ProblemKind(
        400,
        "The request cannot be understood",
        "A part of the request is missing or has a value that is not allowed. `detail` says it; where the form "
        "of the request is at fault, `fields` names each field with a sentence.",
        ("Correct what the answer names.", "Send the request again."),
        2,
        in_browser=("Go back, correct what the sentence above names, send it again.",),
    ),
    ProblemCode.NOT_SIGNED_IN: ProblemKind(
        401,
        "A valid token is needed",
        "The request carried no token, or one that is unknown, expired or revoked. The answer "
        "is the same for all of these.",
        (
            (
                "Run `exceptiondrive login` and paste the token that an organizer gave you, or set "
                "EXCEPTIONDRIVE_TOKEN."
            ),
            "If the token is old, ask an organizer for a new one.",
        ),
        4,
        in_browser=("Sign in again: a session ends after twelve hours.",),
    ),
    ProblemCode.NOT_ALLOWED: ProblemKind(
        403,
        "Not allowed",
        "The token is valid, but it was issued for something else: teams cannot act as "
        "organizers, and reading tokens cannot submit.",
        ("Use a token with the right scope; `exceptiondrive whoami` shows which you have.",),
        4,
        in_browser=(
            "If you sent a form, go back and send it again: your browser may still hold what you typed.",
            "If you followed a link, sign in as somebody who may see it.",
        ),
    ),
    ProblemCode.NOT_FOUND: ProblemKind(
        404,
        "Not found",
        "No such thing exists, or it is not yours to see: submissions of other teams look "
        "exactly like ones that never existed.",
        ("Check the address or the id.", "Start again from the leaderboard."),
        2,
        in_browser=(
            "Check the address.",
            "If it belongs to a team, sign in as a member of it; if you are in several, choose that one.",
            "Otherwise start again from the leaderboard.",
        ),
    ),
    ProblemCode.METHOD_NOT_ALLOWED: ProblemKind(
        405,
        "This address does not take that method",
        "The address exists, but not for this HTTP method. The `Allow` header lists the ones "
        "that work.",
        ("Use one of the methods in `Allow`.",),
        2,
        in_browser=("Start again from the leaderboard and follow its links.",),
    ),
    ProblemCode.CONFLICT: ProblemKind(
        409,
        "The request conflicts with what is recorded",
        "Something with this name exists with other content, or the state has moved on since "
        "you looked. Protocols, boards and split revisions never change once they are used.",
        ("Look at the present state again.", "Choose another name or version."),
        4,
        in_browser=("Open the page again: it shows the present state.",),
    ),
    ProblemCode.NOT_CONFIRMED: ProblemKind(
        409,
        "This has to be confirmed",
        "The request would replace an entry of the team on the board. Nothing was changed.",
        (
            "If that is intended, send it again with `--replace`; in the API, with `replace` as true.",
        ),
        2,
        in_browser=("Go back, and confirm there that it may replace the entry.",),
    ),
    ProblemCode.PHASE_CLOSED: ProblemKind(
        403,
        "The phase takes no submissions now",
        "The phase has not opened yet or has closed. Its board stays readable.",
        ("See the dates with `exceptiondrive phases`.", "Submit to a phase that is open."),
        4,
    ),
    ProblemCode.UPLOAD_TOO_LARGE: ProblemKind(
        413,
        "The upload is too large",
        "The file is larger than this server accepts. A file for 3,181 samples with four "
        "decimals needs about 400 kB when compressed.",
        ("Compress the file with gzip.", "Write no more than four decimals."),
        2,
    ),
    ProblemCode.UPLOAD_EMPTY: ProblemKind(
        400,
        "The upload is empty",
        "The request carried a file without any bytes.",
        ("Check that your program finished writing the file.", "Submit it again."),
        2,
        in_browser=("Check that the file was written to its end, then send it again.",),
    ),
    ProblemCode.UNSUPPORTED_MEDIA_TYPE: ProblemKind(
        415,
        "This media type is not accepted",
        "Submissions travel as multipart/form-data; other requests travel as JSON.",
        (
            "Use `exceptiondrive submit`, or send the form as the API description shows it.",
            "Send JSON with the header `Content-Type: application/json`.",
        ),
        2,
        in_browser=("Send the file with the form on the submit page.",),
    ),
    ProblemCode.QUOTA_EXCEEDED: ProblemKind(
        429,
        "The quota is used up",
        "Your team has made all submissions that this phase allows for now. Rejected and "
        "failed submissions never count, and neither do the same bytes sent again, unless that submission was "
        "withdrawn.",
        (
            "A day's quota renews at 00:00 UTC, `Retry-After` seconds from now; that of a whole phase does not.",
            "Until then, score locally on the development split: `exceptiondrive evaluate`.",
        ),
        3,
    ),
    ProblemCode.REJECTED_CAP_EXCEEDED: ProblemKind(
        429,
        "Too many files without a score today",
        "Rejected files cost no quota, nor do those that could not be scored, but their number per "
        "day is capped.",
        (
            (
                "If files were rejected: `exceptiondrive check FILE --phase PHASE` finds "
                "the same faults on your own machine. Files that could not be scored may be sent again unchanged."
            ),
            "Submit again after 00:00 UTC.",
        ),
        3,
    ),
    ProblemCode.FILE_INVALID: ProblemKind(
        0,
        "The file is not valid",
        "The file breaks the format, as the client says of a file that it checks or waits for. The server takes "
        "such a file with 202, and the submission becomes `rejected`: its `report` lists every fault at once, "
        "with code, place, sample, what was expected and what was there. No quota is spent.",
        (
            "Run `exceptiondrive check FILE` and correct what it lists.",
            "The codes are explained below, each with an example.",
        ),
        2,
    ),
    ProblemCode.TOO_MANY_REQUESTS: ProblemKind(
        429,
        "Too many requests",
        "Too much came at once or in a short time, from your address, your team or with your token.",
        ("Wait for the seconds in `Retry-After`, then go on more slowly.",),
        5,
        in_browser=("Wait as long as the sentence above says, then try again.",),
    ),
    ProblemCode.STORE_UNAVAILABLE: ProblemKind(
        503,
        "The service cannot do this right now",
        "The database or the file store did not answer, or more files arrive at once than the server takes. "
        "Nothing was accepted, and nothing that was accepted before is lost.",
        ("Try again after the seconds in `Retry-After`; the client does so by itself.",),
        5,
        in_browser=("Load the page again in a few seconds.",),
    ),
    ProblemCode.INTERNAL: ProblemKind(
        500,
        "We made an error",
        "The server met an error of its own. Operators find it in the logs by the request id.",
        ("Try again later.", "If it persists, tell an organizer the `request_id`."),
        5,
        in_browser=(
            "Load the page again in a minute.",
            "If it persists, tell an organizer the request id above.",
        ),
    ),
}
CODE_OF_STATUS: Mapping[int, ProblemCode] = {
    400: ProblemCode.BAD_REQUEST,
    401: ProblemCode.NOT_SIGNED_IN,
    403: ProblemCode.NOT_ALLOWED,
    404: ProblemCode.NOT_FOUND,
    405: ProblemCode.METHOD_NOT_ALLOWED,
    409: ProblemCode.CONFLICT,
    413: ProblemCode.UPLOAD_TOO_LARGE,
    415: ProblemCode.UNSUPPORTED_MEDIA_TYPE,
    429: ProblemCode.TOO_MANY_REQUESTS,
    503: ProblemCode.STORE_UNAVAILABLE,
}


class ApiProblem(Exception):  # noqa: N818 - named as RFC 9457 names it
    """A request that is answered with a problem."""

    def __init__(
        self,
        code: ProblemCode,
        detail: str,
        *,
        retry_after_s: int | None = None,
        fields: Mapping[str, str] | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.retry_after_s = retry_after_s
        self.resets_at: datetime | None = None
        self.fields = dict(fields or {})
        self.headers = dict(headers or {})
