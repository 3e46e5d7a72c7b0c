"""The team's tokens: list, issue, rotate, revoke. A new token's text is shown once."""

from collections.abc import Callable, Mapping
from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.makers import live_tokens_by_maker
from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import (
    DEFAULT_KEEP_DAYS,
    MAX_KEEP_DAYS,
    MEANING_OF_SCOPE,
    PARTICIPANT_SCOPES,
    TEAM_SCOPES,
    Principal,
    Scope,
    is_live,
    issue_team_token,
    revoke_team_token,
    rotate_team_token,
    team_tokens,
)
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.accounts.queries import scopes_field, team_token_views
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.browser_session import Browser, PostedForm, SignedIn, require_scope
from exceptiondrive_server.web.forms import filled_fields, posted_texts, read_form
from exceptiondrive_server.web.responses import my_page

router = APIRouter(prefix="/my/tokens", include_in_schema=False)
TokenId = Annotated[str, Path(max_length=64)]
Issue = Callable[[Session, Principal], tuple[str, Token]]
KEEP_DAYS = FormField(
    "keep_days", "The old one works, more days", "whole", lowest=0, highest=MAX_KEEP_DAYS
)
_USUAL: Mapping[str, str] = {"scopes": " ".join(PARTICIPANT_SCOPES)}


@router.get("")
def show_tokens(browser: Browser) -> Response:
    """List the team's tokens."""
    return _tokens_page(browser)


@router.post("")
def issue(browser: Browser, form: PostedForm) -> Response:
    """Issue a token and show it, once."""
    fields = _new_token(browser)

    def make(session: Session, keeper: Principal) -> tuple[str, Token]:
        values = read_form(fields, form)
        days = values["days"]
        ends = None if days is None else database_now(session) + timedelta(days=days)
        return issue_team_token(session, keeper, values["name"], values["scopes"], ends)

    return _issue_and_show(browser, make, posted_texts(form))


@router.post("/{token_id}/rotate")
def rotate(browser: Browser, form: PostedForm, token_id: TokenId) -> Response:
    """Issue the successor of a token and show it, once."""

    def make(session: Session, keeper: Principal) -> tuple[str, Token]:
        given = read_form([KEEP_DAYS], form)["keep_days"]
        days = DEFAULT_KEEP_DAYS if given is None else given
        return rotate_team_token(session, keeper, token_id, days)

    return _issue_and_show(browser, make)


@router.post("/{token_id}/revoke")
def revoke(browser: Browser, form: PostedForm, token_id: TokenId) -> Response:
    """Revoke a token; if it is the one of this session, the session ends with it."""
    require_scope(browser, Scope.TOKENS)
    with browser.services.database.write() as session:
        revoke_team_token(session, browser.principal, token_id)
    return RedirectResponse("/my/tokens", status_code=303)


def _issue_and_show(browser: SignedIn, issue: Issue, texts: Mapping[str, str] = _USUAL) -> Response:
    require_scope(browser, Scope.TOKENS)
    team_of(browser.principal)
    try:
        with browser.services.database.write() as session:
            text, _ = issue(session, browser.principal)
    except RecordsError as refusal:
        return _tokens_page(browser, texts=texts, refusal=refusal)
    return _tokens_page(browser, issued=text)


def _tokens_page(
    browser: SignedIn,
    issued: str | None = None,
    texts: Mapping[str, str] = _USUAL,
    refusal: RecordsError | None = None,
) -> Response:
    require_scope(browser, Scope.TOKENS)
    team_id = team_of(browser.principal)
    with browser.services.database.read() as session:
        now = database_now(session)
        tokens = team_tokens(session, browser.principal)
        views = team_token_views(session, team_id, tokens)
        is_alive = [is_live(token, now) for token in tokens]
        actors = [f"token:{token.id}" for token in tokens]
        made_with = live_tokens_by_maker(session, actors, team_id)
    return my_page(
        browser,
        "accounts/tokens.html",
        tokens=sorted(zip(views, is_alive, strict=True), key=lambda line: not line[1]),
        made_with=made_with,
        refusal=refusal,
        fields=filled_fields(_new_token(browser), texts),
        meaning=MEANING_OF_SCOPE,
        new_token=issued,
        keep_days=DEFAULT_KEEP_DAYS,
        max_keep_days=MAX_KEEP_DAYS,
    )


def _new_token(browser: SignedIn) -> tuple[FormField, ...]:
    """What is asked of a new token, which has no more rights than whoever asks."""
    require_scope(browser, Scope.TOKENS)
    scopes = [scope for scope in TEAM_SCOPES if scope in browser.principal.scopes]
    return (
        FormField("name", "Name", hint="what it is for", is_required=True, max_length=80),
        scopes_field(scopes),
        FormField("days", "Days until it expires", "whole", "empty: never", highest=3650),
    )
