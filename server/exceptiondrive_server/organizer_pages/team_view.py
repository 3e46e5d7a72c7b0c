"""Teams as organizers see them: a list, and one team with its tokens."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_records.tables import Team, Token
from exceptiondrive_records.tokens import TEAM_SCOPES, Scope, is_live
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_server.organizer_pages.audit_view import HistoryLine

MEANING = {
    Scope.SUBMIT: "submit and withdraw",
    Scope.READ_OWN: "see the team's submissions",
    Scope.TOKENS: "manage the team's tokens",
    Scope.ORGANIZE: "everything that organizers do",
}
NEW_TEAM = (
    FormField("id", "Id", hint="small letters, digits, hyphens; never changes", is_required=True,
          max_length=64),
    FormField("name", "Name", hint="as the board shows it", is_required=True, max_length=80),
    FormField("is_reference", "A reference row", "yes", "stands on the board, never ranks"),
)  # fmt: skip
NEW_TOKEN = (
    FormField("name", "Name", hint="what it is for", is_required=True, max_length=80),
    *(FormField(f"may_{n}", MEANING[scope], "yes", scope) for n, scope in enumerate(TEAM_SCOPES)),
    FormField("expires_at", "Expires at", "moment", "empty: never"),
)
"""`may_0` and so on stand for the scopes that a team's token may have."""


@dataclass(frozen=True)
class TeamLine:
    """One team in the list."""

    slug: str
    name: str
    is_reference: bool
    created_at: datetime
    pending_since: datetime | None
    note: str | None
    n_tokens: int
    n_submissions: int


@dataclass(frozen=True)
class TokenLine:
    """One token, without its secret."""

    id: str
    name: str
    prefix: str
    rights: str
    last_used_at: datetime | None
    expires_at: datetime | None
    state: str
    is_live: bool


@dataclass(frozen=True)
class TeamPage:
    """Everything that `team.html` needs besides its form."""

    team: Team
    tokens: tuple[TokenLine, ...]
    issued: str | None
    """Text of a new token: shown this once."""
    history: tuple[HistoryLine, ...]
    n_submissions: int


def team_line(team: Team, *, n_tokens: int, n_submissions: int) -> TeamLine:
    """Return a team as the list shows it."""
    return TeamLine(
        slug=team.slug,
        name=team.name,
        is_reference=team.is_reference,
        created_at=team.created_at,
        pending_since=team.pending_since,
        note=team.registration_note,
        n_tokens=n_tokens,
        n_submissions=n_submissions,
    )


def token_lines(tokens: Sequence[Token], now: datetime) -> tuple[TokenLine, ...]:
    """Return tokens, live ones first."""
    lines = [_token(token, now) for token in tokens]
    return tuple(sorted(lines, key=lambda line: not line.is_live))


def chosen_scopes(values: dict[str, object]) -> tuple[Scope, ...]:
    """Return the scopes that were ticked."""
    return tuple(scope for n, scope in enumerate(TEAM_SCOPES) if values[f"may_{n}"])


def _token(token: Token, now: datetime) -> TokenLine:
    lives = is_live(token, now)
    return TokenLine(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        rights=", ".join(MEANING[Scope(scope)] for scope in token.scopes),
        last_used_at=token.last_used_at,
        expires_at=token.expires_at,
        state="live" if lives else ("revoked" if token.revoked_at else "expired"),
        is_live=lives,
    )
