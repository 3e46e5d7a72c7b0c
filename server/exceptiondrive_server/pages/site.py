"""Theme and frame: what a request says about how pages should look."""

from exceptiondrive_server.pages.page_parts import THEMES, Site, Theme

THEME_COOKIE = "theme"
SESSION_COOKIES = ("__Host-session", "session")
"""Secure, on https; plain, on this machine alone."""
ORGANIZER_COOKIE = "organizer"
"""Shows the link to the organizers' pages; it opens nothing."""
YEAR_S = 365 * 24 * 3600


def theme_of(text: str | None) -> Theme:
    """Return the theme that a cookie names, or the system's."""
    return next((theme for theme in THEMES if theme == text), "auto")


def site_of(cookies: dict[str, str], path: str, query: str, current: str) -> Site:
    """Return the frame of a page."""
    here = path + (f"?{query}" if query else "")
    has_session = any(name in cookies for name in SESSION_COOKIES)
    is_organizer = has_session and cookies.get(ORGANIZER_COOKIE) == "yes"
    return Site(theme_of(cookies.get(THEME_COOKIE)), here, current, has_session, is_organizer)


def safe_back(path: str) -> str:
    """Return a path of this site to go back to; anything else leads to the board."""
    is_local = path.startswith("/") and not path.startswith(("//", "/\\"))
    is_plain = path.isascii() and path.isprintable() and "\\" not in path
    return path if is_local and is_plain and len(path) <= 2000 else "/"
