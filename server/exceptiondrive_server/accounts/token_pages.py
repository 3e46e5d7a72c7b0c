"""The team's tokens: list, issue, rotate, revoke. A new token's text is shown once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated

from fastapi import APIRouter, Path, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session
from starlette.datastructures import FormData

from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import (
    DEFAULT_KEEP_DAYS,
    MAX_KEEP_DAYS,
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
from exceptiondrive_records.db.database import database_now
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_server.web.auth import ServicesOf, team_of
from exceptiondrive_server.web.browser_session import Browser, PostedForm, SignedIn, require_scope
from exceptiondrive_server.web.responses import private_page
from exceptiondrive_server.web.services import Services

# What the page of a team's tokens shows.


MEANING = {
    Scope.SUBMIT: "submit and withdraw",
    Scope.READ_OWN: "see the team's submissions",
    Scope.TOKENS: "manage the team's tokens",
    Scope.ORGANIZE: "everything that organizers do",
}


@dataclass(frozen=True)
class ScopeBox:
    """A right that a new token may be given."""

    value: str
    meaning: str
    is_chosen: bool


@dataclass(frozen=True)
class TokenLine:
    """One token."""

    id: str
    name: str
    prefix: str
    rights: str
    created_at: datetime
    expires_at: datetime | None
    last_used_at: datetime | None
    state: str
    is_live: bool
    is_this: bool
    can_rotate: bool


@dataclass(frozen=True)
class TokensPage:
    """Everything that `tokens.html` needs."""

    team: str | None
    lines: tuple[TokenLine, ...]
    scopes: tuple[ScopeBox, ...]
    issued: str | None
    form_token: str
    keep_days: int
    max_keep_days: int


def tokens_view(
    who: Principal,
    tokens: Sequence[Token],
    *,
    now: datetime,
    issued: str | None,
    form_token: str,
) -> TokensPage:
    """Set the page: live tokens first."""
    lines = [_line(token, who, now) for token in tokens]
    return TokensPage(
        team=who.team_name,
        lines=tuple(sorted(lines, key=lambda line: not line.is_live)),
        scopes=tuple(
            ScopeBox(scope.value, MEANING[scope], scope in PARTICIPANT_SCOPES)
            for scope in TEAM_SCOPES
            if scope in who.scopes
        ),
        issued=issued,
        form_token=form_token,
        keep_days=DEFAULT_KEEP_DAYS,
        max_keep_days=MAX_KEEP_DAYS,
    )


def _line(token: Token, who: Principal, now: datetime) -> TokenLine:
    lives = is_live(token, now)
    return TokenLine(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        rights=", ".join(MEANING[Scope(scope)] for scope in token.scopes),
        created_at=token.created_at,
        expires_at=token.expires_at,
        last_used_at=token.last_used_at,
        state="live" if lives else ("revoked" if token.revoked_at else "expired"),
        is_live=lives,
        is_this=token.id == who.token_id,
        can_rotate=lives and set(token.scopes) <= who.scopes,
    )


router = APIRouter(prefix="/my/tokens", include_in_schema=False)
TokenId = Annotated[str, Path(max_length=64)]
Issue = Callable[[Session, Principal], tuple[str, Token]]
MAX_DAYS = 3650


@router.get("")
def show_tokens(request: Request, services: ServicesOf, browser: Browser) -> Response:
    """List the team's tokens."""
    return _page(request, services, browser)


@router.post("")
def issue(request: Request, services: ServicesOf, browser: Browser, form: PostedForm) -> Response:
    """Issue a token and show it, once."""
    scopes = tuple(str(scope) for scope in form.getlist("scope"))
    days = _days(form, "days", None)

    def make(session: Session, keeper: Principal) -> tuple[str, Token]:
        ends = None if days is None else database_now(session) + timedelta(days=days)
        return issue_team_token(session, keeper, str(form.get("name", "")), scopes, ends)

    return _issued(request, services, browser, make)


@router.post("/{token_id}/rotate")
def rotate(
    request: Request, services: ServicesOf, browser: Browser, form: PostedForm, token_id: TokenId
) -> Response:
    """Issue the successor of a token and show it, once."""
    days = _days(form, "keep_days", DEFAULT_KEEP_DAYS) or 0
    return _issued(
        request, services, browser, lambda s, keeper: rotate_team_token(s, keeper, token_id, days)
    )


@router.post("/{token_id}/revoke")
def revoke(services: ServicesOf, browser: Browser, form: PostedForm, token_id: TokenId) -> Response:
    """Revoke a token; if it is the one of this session, the session ends with it."""
    require_scope(browser, Scope.TOKENS)
    with services.database.write() as session:
        revoke_team_token(session, browser.principal, token_id)
    return RedirectResponse("/my/tokens", status_code=303)


def _issued(request: Request, services: Services, browser: SignedIn, issue: Issue) -> Response:
    require_scope(browser, Scope.TOKENS)
    team_of(browser.principal)
    with services.database.write() as session:
        text, _ = issue(session, browser.principal)
    return _page(request, services, browser, issued=text)


def _page(
    request: Request, services: Services, browser: SignedIn, issued: str | None = None
) -> Response:
    require_scope(browser, Scope.TOKENS)
    team_of(browser.principal)
    with services.database.read() as session:
        now = database_now(session)
        content = tokens_view(
            browser.principal,
            team_tokens(session, browser.principal),
            now=now,
            issued=issued,
            form_token=browser.form_token,
        )
    return private_page(request, "accounts/tokens.html", "my", page=content)


def _days(form: FormData, field: str, default: int | None) -> int | None:
    text = str(form.get(field, "")).strip()
    if not text:
        return default
    is_plain = text.isascii() and text.isdigit() and len(text) <= len(str(MAX_DAYS))
    if not (is_plain and int(text) <= MAX_DAYS):
        raise InvalidRecord(f"The number of days must be a whole number up to {MAX_DAYS}.")
    return int(text)
