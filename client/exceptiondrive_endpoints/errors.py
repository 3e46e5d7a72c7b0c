"""What stops a run, and why a single question has no answer."""

from exceptiondrive_schemas.python310 import StrEnum

GO_ON = "Answers so far are kept; run the same command to go on."


class EndpointError(Exception):
    """No further question can be asked.

    Attributes:
        sentence: What is wrong.
        advice: What to do next; may be empty.
    """

    def __init__(self, sentence: str, advice: str = "") -> None:
        self.sentence = sentence
        self.advice = advice
        super().__init__(f"{sentence} {advice}".strip())


class EndpointRefusesError(EndpointError):
    """The endpoint refuses every question: the key, or the account."""


class EndpointGoneError(EndpointError):
    """The endpoint failed again and again."""


class JournalError(EndpointError):
    """The journal of answers cannot be read or written."""


class Reason(StrEnum):
    """Why a question has no answer. Codes are stable: they stand in journals and records."""

    NO_IMAGES = "no_images"
    WRONG_IMAGE_COUNT = "wrong_image_count"
    UNREADABLE_IMAGE = "unreadable_image"
    RATE_LIMITED = "rate_limited"
    SERVER_ERROR = "server_error"
    TIMEOUT = "timeout"
    CONNECTION = "connection"
    REQUEST_REFUSED = "request_refused"
    BAD_RESPONSE = "bad_response"
    REFUSAL = "refusal"
    FILTERED = "filtered"
    TRUNCATED = "truncated"
    EMPTY = "empty"
    NOT_JSON = "not_json"
    WRONG_SCHEMA = "wrong_schema"
    UNKNOWN_HAZARD_TYPE = "unknown_hazard_type"
    NO_PICTURE = "no_picture"
    WRONG_SIZE = "wrong_size"

    @property
    def is_unreachable(self) -> bool:
        """Whether the endpoint never answered, so that asking again may help."""
        return self in _UNREACHABLE

    @property
    def is_from_endpoint(self) -> bool:
        """Whether the endpoint, not the model's answer or the images, is at fault."""
        return self.is_unreachable or self in (Reason.REQUEST_REFUSED, Reason.BAD_RESPONSE)

    @property
    def is_from_model(self) -> bool:
        """Whether the model answered, and the answer cannot be used."""
        return not self.is_from_endpoint and self not in _ABOUT_IMAGES


_UNREACHABLE = frozenset(
    {Reason.RATE_LIMITED, Reason.SERVER_ERROR, Reason.TIMEOUT, Reason.CONNECTION}
)
_ABOUT_IMAGES = frozenset({Reason.NO_IMAGES, Reason.WRONG_IMAGE_COUNT, Reason.UNREADABLE_IMAGE})


class NoAnswerError(Exception):
    """One question has no answer: the reason, a sentence, and the raw answer where there was one."""

    def __init__(self, reason: Reason, detail: str, raw: str | None = None) -> None:
        self.reason = reason
        self.detail = detail
        self.raw = raw
        super().__init__(f"{reason}: {detail}")
