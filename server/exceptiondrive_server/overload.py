"""Sheds uploads beyond what one process can take at once, so that pages stay quick.

Who is sent away is told when to come again; nothing was taken, so nothing is lost.
"""

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.body_limit import UPLOAD_PATHS
from exceptiondrive_server.problem_vocabulary import ApiProblem
from exceptiondrive_server.problems import (
    problem_response,
)

RETRY_AFTER_S = 5


class Overload:
    """Answers 503 with `Retry-After` while `at_once` uploads are under way in this process."""

    def __init__(self, app: ASGIApp, at_once: int) -> None:
        self.app = app
        self.at_once = at_once
        self._under_way = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if not _is_upload(scope):
            await self.app(scope, receive, send)
            return
        if self._under_way >= self.at_once:
            detail = "Many files arrive right now. Nothing was taken; send it again shortly."
            problem = ApiProblem(ProblemCode.STORE_UNAVAILABLE, detail, retry_after_s=RETRY_AFTER_S)
            response = problem_response(Request(scope), problem)
            response.headers["Connection"] = "close"
            await response(scope, receive, send)
            return
        self._under_way += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._under_way -= 1


def _is_upload(scope: Scope) -> bool:
    is_post = scope["type"] == "http" and scope["method"] == "POST"
    return is_post and str(scope["path"]) in UPLOAD_PATHS
