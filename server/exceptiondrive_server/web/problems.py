"""Every error as an RFC 9457 problem: one vocabulary, one form, without echoing the request."""

import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from sqlalchemy.exc import DataError, DBAPIError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.exceptions import HTTPException
from starlette.routing import Match

from exceptiondrive_records.db.database import is_conflict, is_forbidden, reason_of
from exceptiondrive_records.db.errors import (
    ConcurrentQuotaExceeded,
    InvalidRecord,
    QuotaExceeded,
    RecordsError,
    RejectedCapExceeded,
    StoreError,
    TooManyAttempts,
)
from exceptiondrive_records.operations.logs import places
from exceptiondrive_schemas.api.problems import PROBLEM_MEDIA_TYPE, Problem, ProblemCode
from exceptiondrive_schemas.api.submission import Quota
from exceptiondrive_schemas.base import NO_OBJECT, fault_words
from exceptiondrive_server.web.etag import PROXY_KEEPS
from exceptiondrive_server.web.middleware import HEADERS, is_stream
from exceptiondrive_server.web.problem_vocabulary import CODE_OF_STATUS, PROBLEMS, ApiProblem
from exceptiondrive_server.web.responses import problem_page

_log = structlog.get_logger("exceptiondrive.server")

MAX_FIELDS = 20
_PLAIN_NAME = re.compile("[a-z][a-z_]{0,39}")
"""Of a field that we do not know: no name of this form is markup, a digest or a token."""
TOO_LARGE = "The request is larger than the server takes; gzip the file, or see the phase's limit."
RETRY_AFTER_S = 5


QUOTA_HEADERS = {
    "headers": {
        f"RateLimit-{name}": {"description": words, "schema": {"type": "integer", "minimum": 0}}
        for name, words in (
            (
                "Limit",
                "Submissions that the team may hand in to the phase each day; or in all, where that leaves fewer.",
            ),
            ("Remaining", "How many of them are left."),
            (
                "Reset",
                "Seconds until the count of the day begins anew; left out where the limit is that of all.",
            ),
        )
    }
}
"""In OpenAPI, of an answer about one phase to a team; nobody else has a quota."""


def problem_responses(*codes: ProblemCode) -> dict[int | str, dict[str, Any]]:
    """Describe in OpenAPI which problems a route may answer with."""
    by_status: dict[int | str, list[ProblemCode]] = {}
    for code in (*codes, ProblemCode.BAD_REQUEST, ProblemCode.STORE_UNAVAILABLE):
        by_status.setdefault(PROBLEMS[code].status, []).append(code)
    return {
        status: {
            "description": "; ".join(
                f"`{code.value}`: {PROBLEMS[code].title}" for code in of_status
            ),
            "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status, of_status in by_status.items()
    }


def problem_response(request: Request, problem: ApiProblem) -> Response:
    """Return the answer that states a problem."""
    status = PROBLEMS[problem.code].status
    if wants_page(request):
        fields = (f"{name}: {words}." for name, words in problem.fields.items())
        detail = " ".join([problem.detail, *fields])
        answer = problem_page(request, problem.code, detail)
        if problem.retry_after_s is not None:
            answer.headers["Retry-After"] = str(problem.retry_after_s)
        return answer
    document = Problem(
        type=f"/problems/{problem.code.value}",
        title=PROBLEMS[problem.code].title,
        status=status,
        code=problem.code,
        detail=problem.detail,
        instance=request.url.path[:200],
        request_id=getattr(request.state, "request_id", None),
        retry_after_s=problem.retry_after_s,
        resets_at=problem.resets_at,
        fields=problem.fields,
    )
    replaces = PROXY_KEEPS if problem.code is ProblemCode.NOT_FOUND else {}
    headers = {**replaces, "Cache-Control": "no-store", **problem.headers}
    if problem.retry_after_s is not None:
        headers["Retry-After"] = str(problem.retry_after_s)
    if status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = 'Bearer realm="exceptiondrive"'
    body = document.model_dump_json(exclude_none=True)
    return Response(body, status_code=status, headers=headers, media_type=PROBLEM_MEDIA_TYPE)


def wants_page(request: Request) -> bool:
    """Whether a browser asks for a page, and not a program for the API."""
    is_api = request.url.path.startswith(("/api/", "/healthz", "/readyz", "/metrics"))
    return not is_api and "text/html" in request.headers.get("accept", "")


def install_problem_handlers(app: FastAPI) -> None:
    """Answer every error of the application with a problem."""
    app.add_exception_handler(ApiProblem, _api_problem)
    app.add_exception_handler(RecordsError, _refusal)
    app.add_exception_handler(RequestValidationError, _refusal)
    app.add_exception_handler(HTTPException, _http_exception)
    app.add_exception_handler(SQLAlchemyError, _database_error)
    app.add_exception_handler(DataError, _answer_unstorable)
    app.add_exception_handler(UnicodeEncodeError, _answer_unstorable)
    app.add_exception_handler(Exception, _answer_unexpected)


async def _api_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, ApiProblem)
    return problem_response(request, error)


async def _refusal(request: Request, error: Exception) -> Response:
    assert isinstance(error, RecordsError | RequestValidationError)
    problem = problem_of(error)
    is_called_json = "json" in request.headers.get("content-type", "")
    if problem.fields.get("body") == NO_OBJECT and not is_called_json:  # as curl's -d alone does
        detail = "Send the body as JSON, and with the header Content-Type: application/json."
        problem = ApiProblem(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)
    return problem_response(request, problem)


def problem_of(error: RecordsError | RequestValidationError) -> ApiProblem:
    """Return what was refused, by the records or by the form of a request, as a problem."""
    return _of_records(error) if isinstance(error, RecordsError) else _of_fields(error)


def _of_records(error: RecordsError) -> ApiProblem:
    fields = error.fields if isinstance(error, InvalidRecord) else None
    problem = ApiProblem(error.code, str(error), fields=fields)
    if isinstance(error, StoreError):
        _log.warning("file store unavailable", reason=error.reason)
    if error.code is ProblemCode.STORE_UNAVAILABLE or isinstance(error, ConcurrentQuotaExceeded):
        problem.retry_after_s = RETRY_AFTER_S
    if isinstance(error, TooManyAttempts | QuotaExceeded | RejectedCapExceeded):
        problem.resets_at = error.resets_at
        problem.retry_after_s = seconds_until(error.resets_at)
    if isinstance(error, QuotaExceeded):
        problem.headers = _rate_limit_headers(error.limit, 0, error.resets_at)
    return problem


def seconds_until(moment: datetime | None) -> int | None:
    """Return whole seconds from now, at least one; None for never."""
    if moment is None:
        return None
    return max(1, math.ceil((moment - datetime.now(UTC)).total_seconds()))


def quota_headers(quota: Quota) -> dict[str, str]:
    """Return what a team may still submit in a phase, as headers."""
    left = quota.remaining_today
    if quota.total is not None and quota.is_bound_in_all:
        return _rate_limit_headers(quota.total, left, None)
    return _rate_limit_headers(quota.per_day, left, quota.resets_at)


def _rate_limit_headers(limit: int, remaining: int, resets_at: datetime | None) -> dict[str, str]:
    headers = {"RateLimit-Limit": str(limit), "RateLimit-Remaining": str(remaining)}
    wait_s = seconds_until(resets_at)
    return headers if wait_s is None else {**headers, "RateLimit-Reset": str(wait_s)}


def _of_fields(error: RequestValidationError) -> ApiProblem:
    """Name the wrong fields and say why; never repeat what was sent."""
    found = error.errors()
    fields = dict(_field(item) for item in found[:MAX_FIELDS])
    more = "" if len(found) <= MAX_FIELDS else f" (and {len(found) - MAX_FIELDS} more)"
    detail = f"These parts of the request are missing or wrong: {', '.join(fields)}{more}."
    return ApiProblem(ProblemCode.BAD_REQUEST, detail, fields=fields)


_PLACES = ("body", "query", "path", "header")


def _field(item: Mapping[str, Any]) -> tuple[str, str]:
    """Return name and fault of a field; of one that we do not know only a plain name is repeated."""
    place = [str(part) for part in item["loc"] if part not in _PLACES]
    if item["type"] == "extra_forbidden":
        name = place[-1] if place and _PLAIN_NAME.fullmatch(place[-1]) else "(unknown field)"
        return ".".join([*place[:-1], name]), "There is no such field; leave it out."
    if item["type"] == "json_invalid":
        return "body", "This is not JSON."
    return ".".join(place)[:100] or "body", fault_words(str(item["msg"]))[:200]


async def _http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = CODE_OF_STATUS.get(error.status_code, ProblemCode.BAD_REQUEST)
    details = {
        ProblemCode.NOT_FOUND: "There is nothing at this address.",
        ProblemCode.METHOD_NOT_ALLOWED: "This address does not take that method.",
        ProblemCode.UPLOAD_TOO_LARGE: TOO_LARGE,
    }
    words = "it is not of the form that its headers say, or has more parts than are taken."
    if "exceeded maximum size" in error.detail:  # of a part of a form, as Starlette says it
        words = "a field is too long, or a file came without a filename, which every file needs."
    detail = details.get(code, f"The body cannot be read: {words}")
    headers = {"Allow": ", ".join(_methods_at(request))} if error.status_code == 405 else {}
    return problem_response(request, ApiProblem(code, detail, headers=headers))


METHODS = ("DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT")


def _methods_at(request: Request) -> list[str]:
    """Return the methods of an address: those of all its routes, and HEAD where GET is answered."""
    methods = {
        method
        for method in METHODS
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    }
    has_head = "GET" in methods and not is_stream(request.url.path)
    return sorted(methods | ({"HEAD"} if has_head else set()))


async def _answer_unstorable(request: Request, error: Exception) -> Response:
    """A value that no column can hold, such as a NUL in a text or half of a surrogate pair."""
    detail = "The request holds a character or number that cannot be used."
    return problem_response(request, ApiProblem(ProblemCode.BAD_REQUEST, detail))


async def _database_error(request: Request, error: Exception) -> Response:
    if is_conflict(error):
        detail = "Somebody else did the same at this moment. Nothing was changed; look at it anew."
        return problem_response(request, ApiProblem(ProblemCode.CONFLICT, detail))
    is_outage = isinstance(error, DBAPIError | PoolTimeout) and not is_forbidden(error)
    _log.error("database error", kind=type(error).__name__, is_outage=is_outage, **reason_of(error))
    if not is_outage:
        return problem_response(request, _internal(request))
    detail = "The records cannot be reached right now. Nothing was changed; try again shortly."
    problem = ApiProblem(ProblemCode.STORE_UNAVAILABLE, detail, retry_after_s=RETRY_AFTER_S)
    return problem_response(request, problem)


async def _answer_unexpected(request: Request, error: Exception) -> Response:
    """Answer last of all, outside the middleware: so the headers are put here."""
    request_id = getattr(request.state, "request_id", "unknown")
    told = {"kind": type(error).__name__, "places": places(error)}
    _log.error("unexpected error", request_id=request_id, **told)
    response = problem_response(request, _internal(request))
    response.headers["X-Request-ID"] = request_id
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    return response


def _internal(request: Request) -> ApiProblem:
    request_id = getattr(request.state, "request_id", "unknown")
    detail = f"Something went wrong on our side; tell the organizers the request id {request_id}."
    return ApiProblem(ProblemCode.INTERNAL, detail)
