"""HTML answers: the frame of a page, headers, ETag and 304, problems, the theme."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_server.web.browser_session import MAX_BACK, Holder, SignedIn, holder_of
from exceptiondrive_server.web.compression import takes_gzip
from exceptiondrive_server.web.etag import PROXY_KEEPS, conditional
from exceptiondrive_server.web.kept_pages import KeptPage
from exceptiondrive_server.web.middleware import HEADERS
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS
from exceptiondrive_server.web.services import services_of
from exceptiondrive_server.web.templating import render

router = APIRouter(include_in_schema=False)
Theme = Literal["auto", "light", "dark"]
Values = Mapping[str, Any]
"""What fills a template."""
THEMES: tuple[Theme, ...] = ("auto", "light", "dark")
THEME_COOKIE = "theme"
YEAR_S = 365 * 24 * 3600
SECURITY_HEADERS = {**HEADERS, "Referrer-Policy": "strict-origin"}
"""No address of a page is told: some hold a secret, and the proxy logs what is told beside an error.
Without any referrer, browsers put no `Origin` on forms."""
PUBLIC_PROBLEM = {**SECURITY_HEADERS, "Cache-Control": "no-cache", "Vary": "Cookie"}
PUBLIC_PAGE = {**PROXY_KEEPS, **PUBLIC_PROBLEM}


@dataclass(frozen=True)
class Site:
    """The frame around a page."""

    theme: Theme
    path: str
    current: str
    has_session: bool = False
    """Whether the browser sent a session, valid or not: only words depend on it."""
    origin: str = ""
    """What people type before the path, for the addresses that other sites follow."""
    is_organizer: bool = False
    """Whether it once signed in as an organizer: only a link depends on it, never a right."""
    links: SiteLinks = field(default_factory=SiteLinks)
    delay: str = ""
    """Why scoring is delayed; empty while it keeps up."""
    preparing: str = ""
    """What is being made before there is anything to see; empty where nothing is."""


def theme_of(text: str | None) -> Theme:
    """Return the theme that a cookie names, or the system's."""
    return next((theme for theme in THEMES if theme == text), "auto")


def origin_of(request: Request) -> str:
    """Return the address of this site: as the operator set it, else as the request names it."""
    public_url = services_of(request).settings.public_url
    return (public_url or str(request.base_url)).rstrip("/")


def frame_of(request: Request) -> tuple[Theme, str, str]:
    """Return theme, path and origin: of a visitor's request, all that the frame of a page takes."""
    query = request.url.query
    here = request.url.path + (f"?{query}" if query else "")
    return theme_of(request.cookies.get(THEME_COOKIE)), here, origin_of(request)


def site_of(request: Request, current: str) -> Site:
    """Return the frame of a page."""
    theme, here, origin = frame_of(request)
    holder = holder_of(request)
    links, delay, preparing = services_of(request).site_state.now()
    return Site(
        theme,
        here,
        current,
        has_session=holder is not Holder.VISITOR,
        origin=origin,
        is_organizer=holder is Holder.ORGANIZER,
        links=links,
        delay=delay,
        preparing=preparing,
    )


def safe_back(path: str) -> str:
    """Return a path of this site to go back to; anything else leads to the board."""
    is_local = path.startswith("/") and not path.startswith(("//", "/\\"))
    is_plain = path.isascii() and path.isprintable() and "\\" not in path
    return path if is_local and is_plain and len(path) <= MAX_BACK else "/"


def private_page(
    request: Request,
    template: str,
    current: str,
    *,
    status: int = 200,
    refusal: RecordsError | None = None,
    **values: Any,
) -> Response:
    """Fill a template for one team's eyes; nothing between us and the browser may keep it.

    After a refusal the status is the one that the API gives to it, and the template says it in
    words.
    """
    site = site_of(request, current)
    if refusal is not None:
        status = PROBLEMS[refusal.code].status
    words = None if refusal is None else str(refusal)
    body = render(template, site=site, refusal=words, **values)
    headers = {**SECURITY_HEADERS, "Cache-Control": "no-store"}
    return HTMLResponse(body, status_code=status, headers=headers)


def my_page(browser: SignedIn, template: str, **values: Any) -> Response:
    """Fill a template of a team's own pages; its forms carry the token of the session."""
    return private_page(
        browser.request,
        template,
        "my",
        who=browser.principal,
        form_token=browser.form_token,
        **values,
    )


def page(
    request: Request, template: str, current: str, *, status: int = 200, **values: Any
) -> Response:
    """Fill a template and answer; an unchanged page is answered by 304.

    What a signed-in browser gets is its own: no cache that others share may keep it. Everybody else's
    page is the same for all, and our proxy shows it for some seconds (deploy/nginx.conf).
    """
    site = site_of(request, current)
    body = render(template, site=site, **values).encode()
    if site.has_session or "q" in request.query_params:
        headers = {**SECURITY_HEADERS, "Cache-Control": "private, no-cache", "Vary": "Cookie"}
    else:
        headers = PUBLIC_PAGE if status in (200, 404) else PUBLIC_PROBLEM
    if status != 200:
        return HTMLResponse(body, status_code=status, headers=headers)
    return conditional(request, body, "text/html", headers=headers)


def public_page(
    request: Request, template: str, current: str, read: Callable[[Session], Values]
) -> Response:
    """Answer with a page that is read from the records; what visitors see is kept for a second.

    `read` returns what fills the template.
    """
    services = services_of(request)
    is_search = "q" in request.query_params  # free text: kept, it would push out all other pages
    if is_search or holder_of(request) is not Holder.VISITOR:
        with services.database.read() as session:
            values = read(session)
        return page(request, template, current, **values)

    def make() -> str:
        with services.database.read() as session:
            values = read(session)
        return render(template, site=site_of(request, current), **values)

    return _kept_page(request, services.kept_pages.current(frame_of(request), make))


def _kept_page(request: Request, kept: KeptPage) -> Response:
    """Answer a visitor with a page that is kept, compressed where the browser takes that."""
    if not takes_gzip(request.headers.get("accept-encoding", "")):
        return conditional(request, kept.html, "text/html", etag=kept.etag, headers=PUBLIC_PAGE)
    packed = {**PUBLIC_PAGE, "Content-Encoding": "gzip", "Vary": "Cookie, Accept-Encoding"}
    return conditional(request, kept.gzipped, "text/html", etag=kept.etag, headers=packed)


def problem_page(request: Request, code: ProblemCode, detail: str) -> Response:
    """Answer a browser with a problem as a page, in the same words as the API."""
    problem = PROBLEMS[code]
    return page(
        request,
        "web/problem_now.html",
        "",
        status=problem.status,
        code=code,
        detail=detail,
        problem=problem,
        steps=problem.in_browser or problem.steps,
    )


@router.post("/theme")
def choose_theme(
    request: Request, choice: Annotated[str, Form()] = "auto", back: Annotated[str, Form()] = "/"
) -> Response:
    """Keep the choice for a year, and go back."""
    answer = RedirectResponse(safe_back(back), status_code=303)
    answer.set_cookie(
        THEME_COOKIE,
        theme_of(choice),
        max_age=YEAR_S,
        samesite="lax",
        secure=request.url.scheme == "https",
    )
    return answer
