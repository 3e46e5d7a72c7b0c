"""Who signed in with a browser, as its cookie says; asks for nothing, refuses nothing."""

from fastapi import Request
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.sessions import find_page_session, find_person_session
from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_server.web.responses import SESSION_COOKIES
from exceptiondrive_server.web.services import services_of


def is_https(request: Request) -> bool:
    """Whether the browser speaks https to us, or to the proxy before us."""
    public_url = services_of(request).settings.public_url
    return public_url.startswith("https://") or request.url.scheme == "https"


def cookie_of(request: Request, names: tuple[str, str]) -> str:
    """On https only the name counts that another host or plain http cannot set."""
    return request.cookies.get(names[0] if is_https(request) else names[1], "")


def session_secret(request: Request) -> str:
    """Return the secret of the session that a browser shows; empty if none."""
    return cookie_of(request, SESSION_COOKIES)


def principal_of_session(session: Session, secret: str) -> Principal | None:
    """Return who signed in and got this secret; None when the session has ended."""
    if not secret:
        return None
    return find_page_session(session, secret) or find_person_session(session, secret)
