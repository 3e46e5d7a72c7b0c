"""Problem codes: one vocabulary for server answers and client errors (RFC 9457)."""

from datetime import datetime

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import StrEnum

PROBLEM_MEDIA_TYPE = "application/problem+json"


class ProblemCode(StrEnum):
    """Why a request was not carried out. Each has a help page at `/problems/<code>`."""

    BAD_REQUEST = "bad_request"
    NOT_SIGNED_IN = "not_signed_in"
    NOT_ALLOWED = "not_allowed"
    NOT_FOUND = "not_found"
    METHOD_NOT_ALLOWED = "method_not_allowed"
    CONFLICT = "conflict"
    NOT_CONFIRMED = "not_confirmed"
    PHASE_CLOSED = "phase_closed"
    UPLOAD_TOO_LARGE = "upload_too_large"
    UPLOAD_EMPTY = "upload_empty"
    UNSUPPORTED_MEDIA_TYPE = "unsupported_media_type"
    QUOTA_EXCEEDED = "quota_exceeded"
    REJECTED_CAP_EXCEEDED = "rejected_cap_exceeded"
    FILE_INVALID = "file_invalid"
    """The client's own: the server takes such a file, and `SubmissionView.report` lists its faults."""
    TOO_MANY_REQUESTS = "too_many_requests"
    STORE_UNAVAILABLE = "store_unavailable"
    INTERNAL = "internal"


class Problem(Document):
    """An RFC 9457 problem document."""

    type: str
    """Address of the help page, below that of the server."""
    title: str
    """The same for every problem of this code."""
    status: int
    code: ProblemCode
    """To branch on."""
    detail: str
    """What is wrong, in a sentence for people."""
    instance: str | None = None
    """Path of the request."""
    request_id: str | None = None
    """To report it by; the header `X-Request-ID` says the same."""
    retry_after_s: int | None = None
    """Seconds to wait before another try, as `Retry-After`; left out where waiting does not
    help."""
    resets_at: datetime | None = None
    """When a spent quota begins anew."""
    fields: dict[str, str] = {}
    """Request fields that are wrong, each with a sentence."""
