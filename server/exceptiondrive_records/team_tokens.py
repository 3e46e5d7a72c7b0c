"""What a team does with its own tokens. No token gives a right that the asker does not hold."""

from collections.abc import Iterable
from datetime import datetime, timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, InvalidRecord, NotAllowed, NotFound
from exceptiondrive_records.tables import Token
from exceptiondrive_records.tokens import Principal, is_live, issue_token, revoke_token

MAX_LIVE_TOKENS = 50
DEFAULT_KEEP_DAYS = 7
MAX_KEEP_DAYS = 90


def issue_team_token(
    session: Session,
    principal: Principal,
    name: str,
    scopes: tuple[str, ...],
    expires_at: datetime | None = None,
) -> tuple[str, Token]:
    """Issue a token of the asker's team.

    Raises:
        NotAllowed: A scope is wanted that the asker does not hold.
        Conflict: The team has enough live tokens.
        InvalidRecord: As `issue_token` raises it.
    """
    _refuse_more_rights(principal, scopes)
    now = database_now(session)
    if sum(is_live(token, now) for token in team_tokens(session, principal)) >= MAX_LIVE_TOKENS:
        raise Conflict(f"The team has {MAX_LIVE_TOKENS} live tokens; revoke one first.")
    return issue_token(session, principal.team_id, name, scopes, expires_at, actor=principal.actor)


def rotate_team_token(
    session: Session, principal: Principal, token_id: str, keep_days: int = DEFAULT_KEEP_DAYS
) -> tuple[str, Token]:
    """Issue the successor of a token; the old one works for `keep_days` more.

    The successor has the same name, scopes and length of life.

    Raises:
        NotFound: The team has no such token.
        NotAllowed: The token holds a scope that the asker does not hold.
        Conflict: The token is revoked or has expired.
        InvalidRecord: The number of days cannot be used.
    """
    if not 0 <= keep_days <= MAX_KEEP_DAYS:
        raise InvalidRecord(f"The old token may be kept for 0 to {MAX_KEEP_DAYS} days.")
    old = find_team_token(session, principal, token_id)
    now = database_now(session)
    if not is_live(old, now):
        raise Conflict(f"Token {token_id!r} is revoked or has expired; issue a new one.")
    expires_at = None if old.expires_at is None else now + (old.expires_at - old.created_at)
    text, new = issue_team_token(session, principal, old.name, tuple(old.scopes), expires_at)
    ends_at = now + timedelta(days=keep_days)
    old.expires_at = ends_at if old.expires_at is None else min(ends_at, old.expires_at)
    audit(session, principal.actor, "token rotated", token_id, {"successor": new.id})
    return text, new


def revoke_team_token(session: Session, principal: Principal, token_id: str) -> Token:
    """Revoke a token of the asker's team for good, the asker's own included.

    Raises:
        NotFound: The team has no such token.
        Conflict: It is revoked already.
    """
    find_team_token(session, principal, token_id)
    return revoke_token(session, token_id, actor=principal.actor)


def team_tokens(session: Session, principal: Principal) -> list[Token]:
    """Return the tokens of the asker's team, newest first."""
    return list(
        session.scalars(
            select(Token)
            .where(Token.team_id == principal.team_id, Token.team_id.is_not(None))
            .order_by(Token.created_at.desc(), Token.id)
        )
    )


def find_team_token(session: Session, principal: Principal, token_id: str) -> Token:
    """Return a token of the asker's team.

    Raises:
        NotFound: There is none, or it is another team's: the answer is the same.
    """
    token = session.get(Token, token_id)
    if token is None or token.team_id is None or token.team_id != principal.team_id:
        raise NotFound("token", token_id)
    return token


def _refuse_more_rights(principal: Principal, scopes: Iterable[str]) -> None:
    more = sorted(set(scopes) - principal.scopes)
    if more:
        raise NotAllowed(f"Your own token does not have the scope {', '.join(more)}.")
