"""Pages for signed-in teams: sign-in, upload form, own submissions, own people, own tokens."""

from urllib.parse import urlencode

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_server.accounts.browser_session import SignInNeeded, TeamNeeded
from exceptiondrive_server.accounts.pages import router as _provider
from exceptiondrive_server.accounts.pages import router as _sign_in
from exceptiondrive_server.accounts.token_pages import router as _tokens
from exceptiondrive_server.submissions.pages import router as _submit
from exceptiondrive_server.teams.my_pages import router as _my
from exceptiondrive_server.teams.pages import router as _team

__all__ = ["lead_to_sign_in", "router"]

router = APIRouter(include_in_schema=False)
for _part in (_sign_in, _provider, _submit, _my, _team, _tokens):
    router.include_router(_part)


def lead_to_sign_in(app: FastAPI) -> None:
    """Lead a browser that is not signed in to the sign-in page, and from there back."""
    app.add_exception_handler(SignInNeeded, _to_sign_in)
    app.add_exception_handler(TeamNeeded, _to_team)


async def _to_sign_in(request: Request, error: Exception) -> Response:
    back = request.url.path if request.method in ("GET", "HEAD") else "/my"
    query = urlencode({"back": back})
    headers = {"Cache-Control": "no-store"}
    return RedirectResponse(f"/sign-in?{query}", status_code=303, headers=headers)


async def _to_team(request: Request, error: Exception) -> Response:
    return RedirectResponse("/my/team", status_code=303, headers={"Cache-Control": "no-store"})
