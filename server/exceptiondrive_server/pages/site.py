"""Theme and frame: what a request says about how pages should look."""

from fastapi import Request

from exceptiondrive_server.pages.page_parts import THEMES, Site, Theme
from exceptiondrive_server.services import services_of

THEME_COOKIE = "theme"
SESSION_COOKIES = ("__Host-session", "session")
"""Secure, on https; plain, on this machine alone."""
ORGANIZER_COOKIE = "organizer"
"""Shows the link to the organizers' pages; it opens nothing."""
YEAR_S = 365 * 24 * 3600


def theme_of(text: str | None) -> Theme:
    """Return the theme that a cookie names, or the system's."""
    return next((theme for theme in THEMES if theme == text), "auto")


def origin_of(request: Request) -> str:
    """Return the address of this site: as the operator set it, else as the request names it."""
    public_url = services_of(request).settings.public_url
    return (public_url or str(request.base_url)).rstrip("/")


def site_of(request: Request, current: str) -> Site:
    """Return the frame of a page."""
    cookies, query = request.cookies, request.url.query
    here = request.url.path + (f"?{query}" if query else "")
    has_session = any(name in cookies for name in SESSION_COOKIES)
    is_organizer = has_session and cookies.get(ORGANIZER_COOKIE) == "yes"
    theme = theme_of(cookies.get(THEME_COOKIE))
    return Site(theme, here, current, has_session, origin_of(request), is_organizer)


def safe_back(path: str) -> str:
    """Return a path of this site to go back to; anything else leads to the board."""
    is_local = path.startswith("/") and not path.startswith(("//", "/\\"))
    is_plain = path.isascii() and path.isprintable() and "\\" not in path
    return path if is_local and is_plain and len(path) <= 2000 else "/"
