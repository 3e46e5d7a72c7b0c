"""Every error as an RFC 9457 problem: one vocabulary, one form, nothing of the request echoed."""

from collections.abc import Mapping
from datetime import UTC, datetime
from http import HTTPStatus
from types import MappingProxyType
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from starlette.exceptions import HTTPException

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_schemas.problems import PROBLEM_MEDIA_TYPE, Problem, ProblemCode
from exceptiondrive_server import pages

_log = structlog.get_logger("exceptiondrive.server")

MAX_FIELDS = 20
RETRY_AFTER_S = 5
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
_CODE_OF_STATUS = {
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
        self.fields = dict(fields or {})
        self.headers = dict(headers or {})


def problem_responses(*codes: ProblemCode) -> dict[int | str, dict[str, Any]]:
    """Describe in OpenAPI which problems a route may answer with."""
    by_status: dict[int | str, list[ProblemCode]] = {}
    for code in (*codes, ProblemCode.BAD_REQUEST, ProblemCode.STORE_UNAVAILABLE):
        by_status.setdefault(STATUS_OF[code], []).append(code)
    return {
        status: {
            "description": "; ".join(f"`{code.value}`: {TITLE_OF[code]}" for code in of_status),
            "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status, of_status in by_status.items()
    }


def problem_response(request: Request, problem: ApiProblem) -> Response:
    """Return the answer that states a problem."""
    status = STATUS_OF[problem.code]
    if _wants_page(request):
        return pages.problem_page(request, status, problem.code, problem.detail)
    document = Problem(
        type=f"/problems/{problem.code.value}",
        title=TITLE_OF[problem.code],
        status=status,
        code=problem.code,
        detail=problem.detail,
        instance=request.url.path[:200],
        request_id=getattr(request.state, "request_id", None),
        retry_after_s=problem.retry_after_s,
        fields=problem.fields,
    )
    headers = dict(problem.headers)
    if problem.retry_after_s is not None:
        headers["Retry-After"] = str(problem.retry_after_s)
    if status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = 'Bearer realm="exceptiondrive"'
    body = document.model_dump_json(exclude_none=True)
    return Response(body, status_code=status, headers=headers, media_type=PROBLEM_MEDIA_TYPE)


def _wants_page(request: Request) -> bool:
    """Whether a browser asks for a page, and not a program for the API."""
    is_api = request.url.path.startswith(("/api/", "/healthz", "/readyz", "/metrics"))
    return not is_api and "text/html" in request.headers.get("accept", "")


def install_problem_handlers(app: FastAPI) -> None:
    """Answer every error of the application with a problem."""
    app.add_exception_handler(ApiProblem, _api_problem)
    app.add_exception_handler(RecordsError, _records_error)
    app.add_exception_handler(RequestValidationError, _invalid_request)
    app.add_exception_handler(HTTPException, _http_exception)
    app.add_exception_handler(SQLAlchemyError, _database_error)
    app.add_exception_handler(Exception, _unexpected)


async def _api_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, ApiProblem)
    return problem_response(request, error)


async def _records_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, RecordsError)
    resets_at: datetime | None = getattr(error, "resets_at", None)
    wait_s = RETRY_AFTER_S if error.code is ProblemCode.STORE_UNAVAILABLE else None
    if resets_at is not None:
        wait_s = max(1, round((resets_at - datetime.now(UTC)).total_seconds()))
    return problem_response(request, ApiProblem(error.code, str(error), retry_after_s=wait_s))


async def _invalid_request(request: Request, error: Exception) -> Response:
    """Name the wrong fields and say why; never repeat what was sent."""
    assert isinstance(error, RequestValidationError)
    fields: dict[str, str] = {}
    for item in error.errors()[:MAX_FIELDS]:
        where = [str(part) for part in item["loc"] if part not in ("body", "query", "path")]
        fields[".".join(where)[:100] or "body"] = str(item["msg"])[:200]
    names = ", ".join(fields)
    detail = f"These parts of the request are missing or wrong: {names}."
    return problem_response(request, ApiProblem(ProblemCode.BAD_REQUEST, detail, fields=fields))


async def _http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = _CODE_OF_STATUS.get(error.status_code, ProblemCode.BAD_REQUEST)
    details = {
        ProblemCode.NOT_FOUND: "There is nothing at this address.",
        ProblemCode.METHOD_NOT_ALLOWED: f"This address does not take {request.method}.",
        ProblemCode.UPLOAD_TOO_LARGE: "The request is larger than the server takes; "
        "gzip the file, or see the limit of the phase.",
    }
    detail = details.get(code, "The request cannot be read.")
    headers = {key: value for key, value in (error.headers or {}).items() if key == "Allow"}
    return problem_response(request, ApiProblem(code, detail, headers=headers))


async def _database_error(request: Request, error: Exception) -> Response:
    is_outage = isinstance(error, DBAPIError)
    _log.error("database error", kind=type(error).__name__, is_outage=is_outage)
    if not is_outage:
        return problem_response(request, _internal(request))
    detail = "The records cannot be reached right now. Nothing was changed; try again shortly."
    problem = ApiProblem(ProblemCode.STORE_UNAVAILABLE, detail, retry_after_s=RETRY_AFTER_S)
    return problem_response(request, problem)


async def _unexpected(request: Request, error: Exception) -> Response:
    return problem_response(request, _internal(request))


def _internal(request: Request) -> ApiProblem:
    request_id = getattr(request.state, "request_id", "unknown")
    detail = f"Something went wrong on our side; tell the organizers the request id {request_id}."
    return ApiProblem(ProblemCode.INTERNAL, detail)
