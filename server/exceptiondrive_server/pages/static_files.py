"""Static files: cached for ever where the address names the content, revalidated otherwise."""

from fastapi import FastAPI
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from exceptiondrive_server.pages.templating import STATIC


class CachedStaticFiles(StaticFiles):
    """Static files with `Cache-Control`."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a file, and say how long it may be kept."""
        answer = await super().get_response(path, scope)
        is_named_by_content = b"v=" in scope.get("query_string", b"")
        lasting = "public, max-age=31536000, immutable"
        answer.headers["Cache-Control"] = lasting if is_named_by_content else "no-cache"
        answer.headers["X-Content-Type-Options"] = "nosniff"
        return answer


def mount_static(app: FastAPI) -> None:
    """Serve the site's own style, script, fonts and icon under `/static`."""
    app.mount("/static", CachedStaticFiles(directory=STATIC), name="static")
