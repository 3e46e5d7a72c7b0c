"""Help for every problem code: what happened, and what to do. Shown at `/problems/<code>`."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.web.problem_vocabulary import STATUS_OF, TITLE_OF


@dataclass(frozen=True)
class Help:
    """Help for one code. `exit_code` is what the client ends with."""

    status: int
    title: str
    happened: str
    steps: tuple[str, ...]
    exit_code: int


def _help(code: ProblemCode, happened: str, steps: tuple[str, ...], exit_code: int) -> Help:
    return Help(STATUS_OF[code], TITLE_OF[code], happened, steps, exit_code)


PROBLEM_HELP: Mapping[ProblemCode, Help] = MappingProxyType(
    {
        ProblemCode.BAD_REQUEST: _help(
            ProblemCode.BAD_REQUEST,
            "A field of the request is missing or has a value that is not allowed. The answer "
            "names each field with a sentence under `fields`.",
            ("Correct the fields that the answer names.", "Send the request again."),
            2,
        ),
        ProblemCode.NOT_SIGNED_IN: _help(
            ProblemCode.NOT_SIGNED_IN,
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
        ProblemCode.NOT_ALLOWED: _help(
            ProblemCode.NOT_ALLOWED,
            "The token is valid, but it was issued for something else: teams cannot act as "
            "organizers, and reading tokens cannot submit.",
            ("Use a token with the right scope; `exceptiondrive login` shows which you have.",),
            4,
        ),
        ProblemCode.NOT_FOUND: _help(
            ProblemCode.NOT_FOUND,
            "No such thing exists, or it is not yours to see: submissions of other teams look "
            "exactly like ones that never existed.",
            ("Check the address or the id.", "Start again from the leaderboard."),
            2,
        ),
        ProblemCode.METHOD_NOT_ALLOWED: _help(
            ProblemCode.METHOD_NOT_ALLOWED,
            "The address exists, but not for this HTTP method. The `Allow` header lists the ones "
            "that work.",
            ("Use one of the methods in `Allow`.",),
            2,
        ),
        ProblemCode.CONFLICT: _help(
            ProblemCode.CONFLICT,
            "Something with this name exists with other content, or the state has moved on since "
            "you looked. Protocols, boards and split revisions never change once they are used.",
            ("Look at the present state again.", "Choose another name or version."),
            2,
        ),
        ProblemCode.PHASE_CLOSED: _help(
            ProblemCode.PHASE_CLOSED,
            "The phase has not opened yet or has closed. Its board stays readable.",
            ("See the dates with `exceptiondrive phases`.", "Submit to a phase that is open."),
            4,
        ),
        ProblemCode.UPLOAD_TOO_LARGE: _help(
            ProblemCode.UPLOAD_TOO_LARGE,
            "The file is larger than this server accepts. A file for 3,181 samples with four "
            "decimals needs about 400 kB when compressed.",
            ("Compress the file with gzip.", "Write no more than four decimals."),
            2,
        ),
        ProblemCode.UPLOAD_EMPTY: _help(
            ProblemCode.UPLOAD_EMPTY,
            "The request carried a file without any bytes.",
            ("Check that your program finished writing the file.", "Submit it again."),
            2,
        ),
        ProblemCode.UNSUPPORTED_MEDIA_TYPE: _help(
            ProblemCode.UNSUPPORTED_MEDIA_TYPE,
            "Submissions travel as multipart/form-data; other requests travel as JSON.",
            ("Use `exceptiondrive submit`, or send the form as the API description shows it.",),
            2,
        ),
        ProblemCode.QUOTA_EXCEEDED: _help(
            ProblemCode.QUOTA_EXCEEDED,
            "Your team has made all submissions that this phase allows for now. Rejected and "
            "failed submissions never count, and neither do the same bytes sent again.",
            (
                "Wait until the time in `Retry-After`; quotas renew at 00:00 UTC.",
                "Until then, score locally on the development split: `exceptiondrive evaluate`.",
            ),
            3,
        ),
        ProblemCode.REJECTED_CAP_EXCEEDED: _help(
            ProblemCode.REJECTED_CAP_EXCEEDED,
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
        ProblemCode.FILE_INVALID: _help(
            ProblemCode.FILE_INVALID,
            "The file breaks the format. The answer lists every fault at once under `report`: "
            "code, place, sample, what was expected and what was there. No quota was spent.",
            (
                "Run `exceptiondrive check FILE` and correct what it lists.",
                "The codes are explained below, each with an example.",
            ),
            2,
        ),
        ProblemCode.TOO_MANY_REQUESTS: _help(
            ProblemCode.TOO_MANY_REQUESTS,
            "This address was asked too often in a short time.",
            ("Wait for the seconds in `Retry-After`, then go on more slowly.",),
            5,
        ),
        ProblemCode.STORE_UNAVAILABLE: _help(
            ProblemCode.STORE_UNAVAILABLE,
            "The database or the file store did not answer. Nothing was accepted, and nothing that "
            "was accepted before is lost.",
            ("Try again after the seconds in `Retry-After`; the client does so by itself.",),
            5,
        ),
        ProblemCode.INTERNAL: _help(
            ProblemCode.INTERNAL,
            "The server met an error of its own. Organizers see it under the request id.",
            ("Try again later.", "If it stays, tell an organizer the `request_id`."),
            5,
        ),
    }
)
_IN_BROWSER: Mapping[ProblemCode, tuple[str, ...]] = MappingProxyType(
    {
        ProblemCode.BAD_REQUEST: (
            "Go back, correct what the sentence above names, send it again.",
        ),
        ProblemCode.NOT_SIGNED_IN: ("Sign in again: a session ends after twelve hours.",),
        ProblemCode.NOT_ALLOWED: (
            "If you sent a form, open its page again and send it anew.",
            "If you followed a link, sign in as somebody who may see it.",
        ),
        ProblemCode.NOT_FOUND: (
            "Check the address.",
            "If it belongs to your team, sign in first.",
            "Otherwise start again from the leaderboard.",
        ),
        ProblemCode.METHOD_NOT_ALLOWED: ("Start again from the leaderboard and follow its links.",),
        ProblemCode.CONFLICT: ("Open the page again: it shows how things stand now.",),
        ProblemCode.UPLOAD_EMPTY: (
            "Check that the file was written to its end, then send it again.",
        ),
        ProblemCode.UNSUPPORTED_MEDIA_TYPE: ("Send the file with the form on the submit page.",),
        ProblemCode.TOO_MANY_REQUESTS: (
            "Wait as long as the sentence above says, then try again.",
        ),
        ProblemCode.STORE_UNAVAILABLE: ("Load the page again in a few seconds.",),
        ProblemCode.INTERNAL: (
            "Load the page again in a minute.",
            "If it stays, tell an organizer the request id above.",
        ),
    }
)
"""What to do at a page: no client is in the reader's hands there. Other codes say the same to both."""


def steps_in_browser(code: ProblemCode) -> tuple[str, ...]:
    """Return what a reader of pages can do about a problem."""
    return _IN_BROWSER.get(code, PROBLEM_HELP[code].steps)
