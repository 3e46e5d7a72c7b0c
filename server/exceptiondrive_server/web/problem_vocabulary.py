"""The vocabulary of problems: status and title of each code, and the exception that states one."""

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType

from exceptiondrive_schemas.problems import ProblemCode

STATUS_OF: Mapping[ProblemCode, int] = MappingProxyType(
    {
        ProblemCode.BAD_REQUEST: 400,
        ProblemCode.NOT_SIGNED_IN: 401,
        ProblemCode.NOT_ALLOWED: 403,
        ProblemCode.NOT_FOUND: 404,
        ProblemCode.METHOD_NOT_ALLOWED: 405,
        ProblemCode.CONFLICT: 409,
        ProblemCode.PHASE_CLOSED: 403,
        ProblemCode.UPLOAD_TOO_LARGE: 413,
        ProblemCode.UPLOAD_EMPTY: 400,
        ProblemCode.UNSUPPORTED_MEDIA_TYPE: 415,
        ProblemCode.QUOTA_EXCEEDED: 429,
        ProblemCode.REJECTED_CAP_EXCEEDED: 429,
        ProblemCode.FILE_INVALID: 422,
        ProblemCode.TOO_MANY_REQUESTS: 429,
        ProblemCode.STORE_UNAVAILABLE: 503,
        ProblemCode.INTERNAL: 500,
    }
)
TITLE_OF: Mapping[ProblemCode, str] = MappingProxyType(
    {
        ProblemCode.BAD_REQUEST: "The request cannot be understood",
        ProblemCode.NOT_SIGNED_IN: "A valid token is needed",
        ProblemCode.NOT_ALLOWED: "Not allowed",
        ProblemCode.NOT_FOUND: "Not found",
        ProblemCode.METHOD_NOT_ALLOWED: "This address does not take that method",
        ProblemCode.CONFLICT: "The request contradicts what is recorded",
        ProblemCode.PHASE_CLOSED: "The phase takes no submissions now",
        ProblemCode.UPLOAD_TOO_LARGE: "The upload is too large",
        ProblemCode.UPLOAD_EMPTY: "The upload is empty",
        ProblemCode.UNSUPPORTED_MEDIA_TYPE: "This media type is not taken",
        ProblemCode.QUOTA_EXCEEDED: "The quota is used up",
        ProblemCode.REJECTED_CAP_EXCEEDED: "Too many rejected files today",
        ProblemCode.FILE_INVALID: "The file is not valid",
        ProblemCode.TOO_MANY_REQUESTS: "Too many requests",
        ProblemCode.STORE_UNAVAILABLE: "The service cannot do this right now",
        ProblemCode.INTERNAL: "We made an error",
    }
)
CODE_OF_STATUS: Mapping[int, ProblemCode] = MappingProxyType(
    {
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
)


class ApiProblem(Exception):  # noqa: N818 - named as RFC 9457 names it
    """A request that is answered with a problem."""

    def __init__(
        self,
        code: ProblemCode,
        detail: str,
        *,
        retry_after_s: int | None = None,
        resets_at: datetime | None = None,
        fields: Mapping[str, str] | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.retry_after_s = retry_after_s
        self.resets_at = resets_at
        self.fields = dict(fields or {})
        self.headers = dict(headers or {})
