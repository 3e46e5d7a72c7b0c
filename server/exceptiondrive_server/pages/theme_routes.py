"""The colour theme: a form with three buttons, a cookie, and back to the same page."""

from typing import Annotated

from fastapi import APIRouter, Form, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_server.pages.site import THEME_COOKIE, YEAR_S, safe_back, theme_of

router = APIRouter(include_in_schema=False)


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
