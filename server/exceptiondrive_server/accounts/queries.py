"""Tokens as answers show them: never with a secret, save once when they are new."""

from datetime import datetime

from pydantic import BaseModel

from exceptiondrive_records.accounts.tables import Token


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


class IssuedToken(BaseModel):
    """A new token: its text is shown here and never again."""

    token: str
    view: TokenView


def token_view(token: Token) -> TokenView:
    """Return a token as it is shown."""
    return TokenView(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        scopes=tuple(token.scopes),
        created_at=token.created_at,
        expires_at=token.expires_at,
        revoked_at=token.revoked_at,
        last_used_at=token.last_used_at,
    )
