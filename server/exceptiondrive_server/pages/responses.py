"""HTML answers: headers, ETag and 304, problems as pages."""

from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse, Response

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.etag import conditional
from exceptiondrive_server.pages.problem_help import PROBLEM_HELP, steps_in_browser
from exceptiondrive_server.pages.site import site_of
from exceptiondrive_server.pages.templating import render
from exceptiondrive_server.security_headers import HEADERS

SECURITY_HEADERS = {**HEADERS, "Referrer-Policy": "strict-origin-when-cross-origin"}
PROXY_KEEPS_S = 5
"""How long the proxy may show a public page to everybody; no browser sees this header."""
_STATUS = {ProblemCode.NOT_FOUND: 404, ProblemCode.CONFLICT: 409, ProblemCode.BAD_REQUEST: 400}


def private_page(
    request: Request, template: str, current: str, *, status: int = 200, **values: Any
) -> Response:
    """Fill a template for one team's eyes; nothing between us and the browser may keep it."""
    site = site_of(request, current)
    headers = {**SECURITY_HEADERS, "Cache-Control": "no-store"}
    return HTMLResponse(render(template, site=site, **values), status_code=status, headers=headers)


def page(
    request: Request, template: str, current: str, *, status: int = 200, **values: Any
) -> Response:
    """Fill a template and answer; an unchanged page is answered by 304.

    What a signed-in browser gets is its own: no cache that others share may keep it. Everybody else's
    page is the same for all, and our proxy shows it for some seconds (deploy/nginx.conf).
    """
    site = site_of(request, current)
    body = render(template, site=site, **values).encode()
    kept = "private, no-cache" if site.has_session else "no-cache"
    is_public = status == 200 and not site.has_session
    by_proxy = {"X-Accel-Expires": str(PROXY_KEEPS_S)} if is_public else {}
    # nginx before 1.23 obeys the first of two headers that say how long
    headers = {**by_proxy, **SECURITY_HEADERS, "Cache-Control": kept, "Vary": "Cookie"}
    if status != 200:
        return HTMLResponse(body, status_code=status, headers=headers)
    return conditional(request, body, "text/html", headers=headers)


def problem_page(request: Request, status: int, code: ProblemCode, detail: str) -> Response:
    """Answer a browser with a problem as a page, in the same words as the API."""
    return page(
        request,
        "problem_now.html",
        "",
        status=status,
        code=code,
        detail=detail,
        help=PROBLEM_HELP[code],
        steps=steps_in_browser(code),
    )


def refused(request: Request, error: RecordsError) -> Response:
    """Answer a browser with what the records refused."""
    return problem_page(request, _STATUS.get(error.code, 400), error.code, str(error))
