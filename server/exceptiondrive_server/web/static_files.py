"""The site's styles, scripts, fonts and icons, each named by its content hash and cached forever.

Styles are small source files by subject, served as one. Styles and scripts are served without
comments and indentation.
"""

import hashlib
import re
from functools import cache
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

STATIC = Path(__file__).parent / "static"
STYLE = "site.css"
"""The one style sheet; it is no file of the folder."""
STYLES = (
    "theme", "base", "parts", "board", "board-small", "charts", "pages", "entry", "player", "guide",
    "team", "phase", "organize",
)  # fmt: skip
"""Its sources, in the order in which their rules count."""


@cache
def asset(name: str) -> str:
    """Return the address of a static file; it changes whenever the content does."""
    content = _generated_file(name) or (STATIC / name).read_bytes()
    return f"/static/{name}?v={hashlib.sha256(content).hexdigest()[:10]}"


def _generated_file(name: str) -> bytes | None:
    """What is served in place of a file; None of one that is served as it is."""
    if name == STYLE:
        return style_sheet().encode()
    return script(name).encode() if name.endswith(".js") and (STATIC / name).is_file() else None


@cache
def script(name: str) -> str:
    """Return a script without indents and lines of comment; each statement keeps its line."""
    return re.sub(r"(?m)^\s*(//.*\n)?\s*", "", (STATIC / name).read_text("utf-8"))


@cache
def style_sheet() -> str:
    """Return all sources as one, without comments and line ends.

    Fonts stand under the addresses that pages preload.
    """
    joined = "".join((STATIC / f"{name}.css").read_text("utf-8") for name in STYLES)
    joined = re.sub(r"/\*.*?\*/|\n\s*|(?<=;)\s+", "", joined, flags=re.DOTALL).replace(";}", "}")
    return re.sub(r"url\((fonts/[^)]+)\)", lambda found: f"url({asset(found[1])})", joined)


class _NamedByContent(StaticFiles):
    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a file, and say how long it may be kept."""
        made = _generated_file(path)
        if made is not None:
            kind = "text/css" if path == STYLE else "text/javascript"
            answer = Response(made, media_type=kind)
        else:
            answer = await super().get_response(path, scope)
        named = asset(path).partition("?")[2].encode()
        # A page from before an upgrade names another content.
        is_named_by_content = scope.get("query_string", b"") == named
        lasting = "public, max-age=31536000, immutable"
        answer.headers["Cache-Control"] = lasting if is_named_by_content else "no-cache"
        answer.headers["X-Content-Type-Options"] = "nosniff"
        return answer


def mount_static(app: FastAPI) -> None:
    """Serve all of it under `/static`."""
    app.mount("/static", _NamedByContent(directory=STATIC), name="static")
