"""What the page of a team's tokens shows."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_records.tables import Token
from exceptiondrive_records.team_tokens import DEFAULT_KEEP_DAYS, MAX_KEEP_DAYS
from exceptiondrive_records.tokens import PARTICIPANT_SCOPES, TEAM_SCOPES, Principal, Scope, is_live

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
