"""Signed-in browsers: cookies, and forms that no other site can send.

A cookie never speaks for anybody on the API: only these functions read it, for pages alone.
"""

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.responses import Response
from starlette.datastructures import FormData

from exceptiondrive_records.accounts.sessions import LIFETIME
from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.accounts.oidc import LOOPBACK
from exceptiondrive_server.accounts.session_reading import (
    cookie_of,
    is_https,
    principal_of_session,
    session_secret,
)
from exceptiondrive_server.submissions.upload_form import FORM_TOKEN
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.responses import ORGANIZER_COOKIE, SESSION_COOKIES
from exceptiondrive_server.web.services import services_of

VISITOR_COOKIES = ("__Host-visitor", "visitor")
"""Before anybody has signed in: what the sign-in form is bound to."""
MAX_FIELDS = 40
_FORGED = "The form did not come from this site, or is too old. Open the page again and send it."


@dataclass(frozen=True)
class SignedIn:
    """Who signed in, with a token or through the provider, and the secret of the session."""

    principal: Principal
    secret: str

    @property
    def form_token(self) -> str:
        """What every form of the session carries."""
        return form_token(self.secret)


class SignInNeeded(Exception):  # noqa: N818 - named for what it asks
    """A page is for teams; the browser is led to the sign-in page and back."""


class TeamNeeded(Exception):  # noqa: N818 - named for what it asks
    """A page is for members of a team; the browser is led to where one is joined or chosen."""


def signed_in_or_none(request: Request, services: ServicesOf) -> SignedIn | None:
    """Return who signed in with this browser, if anybody."""
    secret = session_secret(request)
    if not secret:
        return None
    with services.database.read() as session:
        principal = principal_of_session(session, secret)
    return None if principal is None else SignedIn(principal, secret)


MaybeSignedIn = Annotated[SignedIn | None, Depends(signed_in_or_none)]


def signed_in(found: MaybeSignedIn) -> SignedIn:
    """Return who signed in.

    Raises:
        SignInNeeded: Nobody did, or the session has ended.
    """
    if found is None:
        raise SignInNeeded
    return found


Browser = Annotated[SignedIn, Depends(signed_in)]


async def posted_form(request: Request, browser: Browser) -> FormData:
    """Return the small form that a signed-in browser sent.

    Raises:
        ApiProblem: It comes from another site, or without the token of this session.
    """
    require_same_origin(request)
    form = await request.form(max_files=0, max_fields=MAX_FIELDS)
    require_form_token(browser.secret, str(form.get(FORM_TOKEN, "")))
    return form


PostedForm = Annotated[FormData, Depends(posted_form)]


def require_scope(browser: SignedIn, scope: Scope) -> None:
    """Refuse what the token of the session may not do."""
    who = browser.principal
    if scope in who.scopes:
        return
    if who.person_id is not None and who.team_id is None and scope is not Scope.ORGANIZE:
        raise TeamNeeded
    detail = f"You signed in with a token that lacks the scope {scope.value!r}."
    if who.person_id is not None:
        detail = "This is for organizers."
    raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)


def form_token(secret: str) -> str:
    """Return the token that binds a form to the secret of a cookie."""
    return hmac.new(secret.encode(), b"form", hashlib.sha256).hexdigest()


def require_form_token(secret: str, given: str) -> None:
    """Refuse a form that was not made for the holder of this secret."""
    if not hmac.compare_digest(form_token(secret).encode(), given.encode("utf-8", "replace")):
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


def set_session_cookie(request: Request, response: Response, secret: str) -> None:
    """Hand the session to the browser, in place of the visitor's cookie."""
    _set(request, response, SESSION_COOKIES, secret, int(LIFETIME.total_seconds()))
    forget_cookies(response, VISITOR_COOKIES)


def note_organizer(request: Request, response: Response, *, is_organizer: bool) -> None:
    """Let pages show the link to the organizers' pages, or no longer; no right depends on it."""
    if not is_organizer:
        response.delete_cookie(ORGANIZER_COOKIE, path="/", httponly=True, samesite="lax")
        return
    age_s = int(LIFETIME.total_seconds())
    names = (ORGANIZER_COOKIE, ORGANIZER_COOKIE)
    _set(request, response, names, "yes", age_s)


def visitor_secret(request: Request) -> str:
    """Return the secret of a visitor who has not signed in; a new one if there is none."""
    return cookie_of(request, VISITOR_COOKIES) or secrets.token_urlsafe(24)


def set_visitor_cookie(request: Request, response: Response, secret: str) -> None:
    """Let the visitor keep the secret as long as the browser runs."""
    _set(request, response, VISITOR_COOKIES, secret, None)


def forget_cookies(response: Response, names: tuple[str, str] = SESSION_COOKIES) -> None:
    """Take the cookies back."""
    response.delete_cookie(names[0], path="/", secure=True, httponly=True, samesite="lax")
    response.delete_cookie(names[1], path="/", httponly=True, samesite="lax")


def _set(
    request: Request, response: Response, names: tuple[str, str], value: str, max_age_s: int | None
) -> None:
    """`__Host-` binds a cookie to this host and to https; browsers refuse it elsewhere."""
    secure = is_https(request)
    response.set_cookie(
        names[0] if secure else names[1],
        value,
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
