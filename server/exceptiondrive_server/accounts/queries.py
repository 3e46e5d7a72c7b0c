"""Tokens as responses show them: without their secret, except once, when they are issued."""

from collections.abc import Sequence
from datetime import datetime

from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.makers import makers_in_words, makers_of_tokens
from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import MEANING_OF_SCOPE, Scope, names_of_actors
from exceptiondrive_schemas.api.form_fields import FormField

_UNKNOWN = "not recorded"


def scopes_field(scopes: Sequence[Scope]) -> FormField:
    """Return the form field for the scopes of a new token."""
    options = tuple((str(scope), f"{MEANING_OF_SCOPE[scope]} ({scope})") for scope in scopes)
    return FormField("scopes", "It may", "several", options=options)


class TokenView(BaseModel):
    """A token without its secret."""

    id: str
    name: str
    prefix: str
    scopes: tuple[str, ...]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None
    made_by: str
    """With which token, or by whom, in words; teams read the names of their own tokens and people alone."""


class RevokedToken(TokenView):
    """A token that works no more, and what it leaves behind."""

    still_work: tuple[TokenView, ...]
    """What was made with it, or with a token that it made: none of these ended with it."""


class IssuedToken(BaseModel):
    """A new token: its text is shown here and never again."""

    token: str
    view: TokenView


def team_token_views(session: Session, team_id: int, tokens: Sequence[Token]) -> list[TokenView]:
    """Return tokens of a team as it sees them; who made one is known after its transaction."""
    words = makers_in_words(session, team_id, makers_of_tokens(session, team_id))
    return [_view(token, words.get(token.id, _UNKNOWN)) for token in tokens]


def token_views(session: Session, tokens: Sequence[Token], team_id: int | None) -> list[TokenView]:
    """Return tokens, of one team if given, as organizers see them."""
    makers = makers_of_tokens(session, team_id)
    names = names_of_actors(session, makers.values())
    words = {token_id: names.get(actor, actor) for token_id, actor in makers.items()}
    return [_view(token, words.get(token.id, _UNKNOWN)) for token in tokens]


def _view(token: Token, made_by: str) -> TokenView:
    return TokenView(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        scopes=tuple(token.scopes),
        created_at=token.created_at,
        expires_at=token.expires_at,
        revoked_at=token.revoked_at,
        last_used_at=token.last_used_at,
        made_by=made_by,
    )
