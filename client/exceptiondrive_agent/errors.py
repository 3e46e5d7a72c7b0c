"""What stops a run, and why a single sample has no answer."""

from enum import StrEnum

from exceptiondrive.errors import InvalidArgumentError, NetworkError, NotAllowedError


class AgentError(InvalidArgumentError):
    """The run cannot start or go on as it was asked for; exit 2."""

    def __init__(self, sentence: str, advice: str = "") -> None:
        super().__init__("agent_run_invalid", sentence, advice)


class EndpointRefusesError(NotAllowedError):
    """The endpoint refuses every sample: the key, or the account; exit 4."""

    def __init__(self, sentence: str, advice: str = "") -> None:
        super().__init__("endpoint_refuses", sentence, advice)


class EndpointGoneError(NetworkError):
    """Samples could not be asked; exit 5."""

    def __init__(self, sentence: str) -> None:
        advice = "Answers so far are kept; run the same command to go on."
        super().__init__("endpoint_gone", sentence, advice)


class Reason(StrEnum):
    """Why a sample has no answer. Codes are stable: they stand in the journal."""

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

    @property
    def is_unreachable(self) -> bool:
        """Whether the endpoint never answered, so that asking again may help."""
        return self in _UNREACHABLE

    @property
    def is_from_endpoint(self) -> bool:
        """Whether the endpoint, not the model's answer or the images, is at fault."""
        return self.is_unreachable or self in (Reason.REQUEST_REFUSED, Reason.BAD_RESPONSE)


_UNREACHABLE = frozenset(
    {Reason.RATE_LIMITED, Reason.SERVER_ERROR, Reason.TIMEOUT, Reason.CONNECTION}
)


class NoAnswerError(Exception):
    """One sample has no answer: the reason, a sentence, and the raw answer where there was one."""

    def __init__(self, reason: Reason, detail: str, raw: str | None = None) -> None:
        self.reason = reason
        self.detail = detail
        self.raw = raw
        super().__init__(f"{reason}: {detail}")
