"""Help for every problem code: what happened, and what to do. Shown at `/problems/<code>`."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from exceptiondrive_schemas.problems import ProblemCode


@dataclass(frozen=True)
class Help:
    """Help for one code. `exit_code` is what the client ends with."""

    status: int
    title: str
    happened: str
    steps: tuple[str, ...]
    exit_code: int


PROBLEM_HELP: Mapping[ProblemCode, Help] = MappingProxyType(
    {
        ProblemCode.BAD_REQUEST: Help(
            400,
            "The request cannot be understood",
            "A field of the request is missing or has a value that is not allowed. The answer "
            "names each field with a sentence under `fields`.",
            ("Correct the fields that the answer names.", "Send the request again."),
            2,
        ),
        ProblemCode.NOT_SIGNED_IN: Help(
            401,
            "A token is needed",
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
        ),
        ProblemCode.NOT_ALLOWED: Help(
            403,
            "The token may not do this",
            "The token is valid, but it was issued for something else: teams cannot act as "
            "organizers, and reading tokens cannot submit.",
            ("Use a token with the right scope; `exceptiondrive login` shows which you have.",),
            4,
        ),
        ProblemCode.NOT_FOUND: Help(
            404,
            "There is nothing at this address",
            "No such thing exists, or it is not yours to see: submissions of other teams look "
            "exactly like ones that never existed.",
            ("Check the address or the id.", "Start again from the leaderboard."),
            2,
        ),
        ProblemCode.METHOD_NOT_ALLOWED: Help(
            405,
            "This address does not take that method",
            "The address exists, but not for this HTTP method. The `Allow` header lists the ones "
            "that work.",
            ("Use one of the methods in `Allow`.",),
            2,
        ),
        ProblemCode.CONFLICT: Help(
            409,
            "The request contradicts what is recorded",
            "Something with this name exists with other content, or the state has moved on since "
            "you looked. Protocols, boards and split revisions never change once they are used.",
            ("Look at the present state again.", "Choose another name or version."),
            2,
        ),
        ProblemCode.PHASE_CLOSED: Help(
            403,
            "The phase takes no submissions now",
            "The phase has not opened yet or has closed. Its board stays readable.",
            ("See the dates with `exceptiondrive phases`.", "Submit to a phase that is open."),
            4,
        ),
        ProblemCode.UPLOAD_TOO_LARGE: Help(
            413,
            "The upload is too large",
            "The file is larger than this server accepts. A file for 3,181 samples with four "
            "decimals needs about 400 kB when compressed.",
            ("Compress the file with gzip.", "Write no more than four decimals."),
            2,
        ),
        ProblemCode.UPLOAD_EMPTY: Help(
            400,
            "The upload is empty",
            "The request carried a file without any bytes.",
            ("Check that your program finished writing the file.", "Submit it again."),
            2,
        ),
        ProblemCode.UNSUPPORTED_MEDIA_TYPE: Help(
            415,
            "The request has the wrong form",
            "Submissions travel as multipart/form-data; other requests travel as JSON.",
            ("Use `exceptiondrive submit`, or send the form as the API description shows it.",),
            2,
        ),
        ProblemCode.QUOTA_EXCEEDED: Help(
            429,
            "The quota is used up",
            "Your team has made all submissions that this phase allows for now. Rejected and "
            "failed submissions never count, and neither do the same bytes sent again.",
            (
                "Wait until the time in `Retry-After`; quotas renew at 00:00 UTC.",
                "Until then, score locally on the development split: `exceptiondrive evaluate`.",
            ),
            3,
        ),
        ProblemCode.REJECTED_CAP_EXCEEDED: Help(
            429,
            "Too many files were rejected today",
            "Rejected files cost no quota, but their number per day is capped.",
            (
                (
                    "Check files on your own machine first: `exceptiondrive check FILE` finds the same "
                    "faults."
                ),
                "Submit again after 00:00 UTC.",
            ),
            3,
        ),
        ProblemCode.FILE_INVALID: Help(
            422,
            "The file is wrong",
            "The file breaks the format. The answer lists every fault at once under `report`: "
            "code, place, sample, what was expected and what was there. No quota was spent.",
            (
                "Run `exceptiondrive check FILE` and correct what it lists.",
                "The codes are explained below, each with an example.",
            ),
            2,
        ),
        ProblemCode.TOO_MANY_REQUESTS: Help(
            429,
            "Too many requests",
            "This address was asked too often in a short time.",
            ("Wait for the seconds in `Retry-After`, then go on more slowly.",),
            5,
        ),
        ProblemCode.STORE_UNAVAILABLE: Help(
            503,
            "A store cannot be reached",
            "The database or the file store did not answer. Nothing was accepted, and nothing that "
            "was accepted before is lost.",
            ("Try again after the seconds in `Retry-After`; the client does so by itself.",),
            5,
        ),
        ProblemCode.INTERNAL: Help(
            500,
            "Something went wrong on our side",
            "The server met an error of its own. Organizers see it under the request id.",
            ("Try again later.", "If it stays, tell an organizer the `request_id`."),
            5,
        ),
    }
)
