"""Browser sessions: one cookie, and forms protected against cross-site requests.

The cookie holds the kind of its holder and a random secret. The API never accepts it: only these
functions read it, for pages.
"""

import hashlib
import hmac
import secrets
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated
from urllib.parse import urlencode, urlsplit

from fastapi import Depends, FastAPI, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session
from starlette.datastructures import FormData
from starlette.routing import Match

from exceptiondrive_records.accounts.sessions import LIFETIME, find_session
from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.auth import ServicesOf, sees_hidden
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.services import Services, services_of
from exceptiondrive_server.web.settings import LOOPBACK

COOKIES = ("__Host-session", "session")
"""Secure, on https; plain, on this machine alone."""


class Holder(StrEnum):
    """The kind of holder of a cookie. It decides which links pages show, but grants no rights."""

    VISITOR = "v"
    """Nobody signed in; the secret is what the sign-in form is bound to."""
    TEAM = "t"
    """Or a person without a team yet."""
    ORGANIZER = "o"


FORM_TOKEN = "form_token"
"""What every form carries against forgery."""
MAX_FIELDS = 100
MAX_BACK = 2000
"""Longest address that the sign-in page leads back to."""
_FORGED = (
    "The form did not come from this site, is older than your session, or was opened while you acted "
    "for another team. Open its page again and send it."
)


@dataclass(frozen=True)
class SignedIn:
    """Who signed in, with a token or through the provider, the secret of the session, and the request."""

    principal: Principal
    secret: str
    request: Request = field(compare=False, repr=False)

    @property
    def services(self) -> Services:
        """The services of the application that is asked."""
        return services_of(self.request)

    @property
    def form_token(self) -> str:
        """What every form of the session carries while it acts for one team, or for none."""
        return form_token(self.secret, self.principal.team_id)


class SignInNeeded(Exception):  # noqa: N818 - named for what it asks
    """A page is for teams; the browser is led to the sign-in page and back."""


class Elsewhere(Exception):  # noqa: N818 - no error: it says where to
    """Raised to redirect a browser to another page."""

    def __init__(self, address: str, status: int = 303) -> None:
        self.address = address
        self.status = status


def holder_of(request: Request) -> Holder:
    """Return whom the cookie of a browser is for, by its own word."""
    return _cookie(request)[0]


def principal_of_browser(session: Session, request: Request) -> Principal | None:
    """Return who signed in with this browser, if anybody."""
    secret = _session_secret(request)
    return find_session(session, secret) if secret else None


def browser_sees_hidden(session: Session, request: Request) -> bool:
    """Whether whoever signed in with this browser may see hidden phases and drafts."""
    return sees_hidden(principal_of_browser(session, request))


def signed_in_or_none(request: Request, services: ServicesOf) -> SignedIn | None:
    """Return who signed in with this browser, if anybody."""
    secret = _session_secret(request)
    if not secret:
        return None
    with services.database.read() as session:
        principal = find_session(session, secret)
    return None if principal is None else SignedIn(principal, secret, request)


MaybeSignedIn = Annotated[SignedIn | None, Depends(signed_in_or_none)]


async def signed_in(found: MaybeSignedIn) -> SignedIn:
    """Return who signed in.

    Raises:
        SignInNeeded: Nobody did, or the session has ended.
    """
    if found is None:
        raise SignInNeeded
    return found


Browser = Annotated[SignedIn, Depends(signed_in)]


async def posted_form(browser: Browser) -> FormData:
    """Return the small form that a signed-in browser sent.

    Raises:
        ApiProblem: It comes from another site, or without the token of this session.
        SignInNeeded: The session ended, or its rights changed, while the form came: that may take a while.
    """
    require_same_origin(browser.request)
    form = await browser.request.form(max_files=0, max_fields=MAX_FIELDS)
    require_form_token(browser.form_token, str(form.get(FORM_TOKEN, "")))
    if await run_in_threadpool(signed_in_or_none, browser.request, browser.services) != browser:
        raise SignInNeeded
    return form


PostedForm = Annotated[FormData, Depends(posted_form)]


def require_scope(browser: SignedIn, *scopes: Scope) -> None:
    """Refuse what the token of the session may not do: it takes any of the scopes.

    Who acts for no team is led to where one is joined or chosen.
    """
    who = browser.principal
    if not who.scopes.isdisjoint(scopes):
        return
    if who.person_id is not None and who.team_id is None:
        raise Elsewhere("/my/team")
    detail = f"You signed in with a token that lacks the scope {scopes[0].value!r}."
    raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)


def form_token(secret: str, team_id: int | None = None) -> str:
    """Return the token that binds a form to the secret of a cookie, and to a team."""
    return hmac.new(secret.encode(), f"form {team_id}".encode(), hashlib.sha256).hexdigest()


def require_form_token(wanted: str, given: str) -> None:
    """Refuse a form that was not made for who sends it."""
    if not hmac.compare_digest(wanted.encode(), given.encode("utf-8", "replace")):
        raise ApiProblem(ProblemCode.NOT_ALLOWED, _FORGED)


def require_same_origin(request: Request) -> None:
    """Refuse what another site sends: browsers put `Origin` on every POST."""
    if request.headers.get("origin") not in _own_origins(request):
        raise ApiProblem(ProblemCode.NOT_ALLOWED, _FORGED)


def require_private_channel(request: Request) -> None:
    """Refuse to take a token in the clear, except on this very machine."""
    if not is_https(request) and request.url.hostname not in LOOPBACK:
        detail = "Sign-in needs https: over http others on the way could read your token."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)


def form_secret(request: Request) -> str:
    """Return the secret of a browser, signed in or not; a new one if there is none."""
    return _cookie(request)[1] or secrets.token_urlsafe(32)


def keep_visitor(request: Request, response: Response, secret: str) -> None:
    """Let a browser that has no cookie yet keep its secret as long as it runs."""
    if not _cookie(request)[1]:
        _set_cookie(request, response, Holder.VISITOR, secret, None)


def keep_session(request: Request, response: Response, secret: str, *, is_organizer: bool) -> None:
    """Hand a session to the browser, in place of what it had."""
    holder = Holder.ORGANIZER if is_organizer else Holder.TEAM
    _set_cookie(request, response, holder, secret, int(LIFETIME.total_seconds()))


def forget_session(response: Response) -> None:
    """Take the cookies back."""
    response.delete_cookie(COOKIES[0], path="/", secure=True, httponly=True, samesite="lax")
    response.delete_cookie(COOKIES[1], path="/", httponly=True, samesite="lax")


def is_https(request: Request) -> bool:
    """Whether the browser speaks https to us, or to the proxy before us."""
    public_url = services_of(request).settings.public_url
    return public_url.startswith("https://") or request.url.scheme == "https"


def _session_secret(request: Request) -> str:
    holder, secret = _cookie(request)
    return "" if holder is Holder.VISITOR else secret


def _cookie(request: Request) -> tuple[Holder, str]:
    """Return what a cookie says; on https only the name counts that nobody else can set."""
    text = request.cookies.get(COOKIES[0] if is_https(request) else COOKIES[1], "")
    letter, _, secret = text.partition(".")
    return (Holder(letter), secret) if letter in list(Holder) else (Holder.VISITOR, "")


def _set_cookie(
    request: Request, response: Response, holder: Holder, secret: str, max_age_s: int | None
) -> None:
    """`__Host-` binds a cookie to this host and to https; browsers refuse it elsewhere."""
    secure = is_https(request)
    response.set_cookie(
        COOKIES[0] if secure else COOKIES[1],
        f"{holder}.{secret}",
        max_age=max_age_s,
        path="/",
        secure=secure,
        httponly=True,
        samesite="lax",
    )


def _own_origins(request: Request) -> set[str]:
    own = {f"{request.url.scheme}://{request.url.netloc}"}
    parts = urlsplit(services_of(request).settings.public_url)
    return own | {f"{parts.scheme}://{parts.netloc}"} if parts.netloc else own


def lead_browsers(app: FastAPI) -> None:
    """Lead a browser that is not signed in to the sign-in page, and from there back; others elsewhere."""
    app.add_exception_handler(SignInNeeded, _to_sign_in)
    app.add_exception_handler(Elsewhere, _redirect_elsewhere)


async def _to_sign_in(request: Request, error: Exception) -> Response:
    is_look = request.method in ("GET", "HEAD")
    back = _looked_at(request) if is_look else _page_of(request)
    query = urlencode({"back": back} if is_look else {"back": back, "unsaved": "true"})
    headers = {"Cache-Control": "no-store"}
    return RedirectResponse(f"/sign-in?{query}", status_code=303, headers=headers)


def _looked_at(request: Request) -> str:
    """Return the address that was asked for; without its query where that is longer than any of ours."""
    path, query = request.url.path, request.url.query
    return f"{path}?{query}" if query and len(path) + len(query) < MAX_BACK else path


def _page_of(request: Request) -> str:
    """Return the page of a form that was sent: its own address, or the nearest above that is one."""
    path = request.url.path
    while path:
        looked_at = {**request.scope, "method": "GET", "path": path}
        if any(route.matches(looked_at)[0] is Match.FULL for route in request.app.routes):
            return _looked_at(request) if path == request.url.path else path
        path = path.rpartition("/")[0]
    return "/my"


async def _redirect_elsewhere(request: Request, error: Exception) -> Response:
    assert isinstance(error, Elsewhere)
    return RedirectResponse(error.address, status_code=error.status)
