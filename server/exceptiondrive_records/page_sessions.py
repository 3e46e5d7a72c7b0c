"""Sessions of browsers: a random secret in a cookie, its digest here, the rights of a token."""

import hashlib
import secrets
from datetime import timedelta

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.tables import Token
from exceptiondrive_records.tables_access import PageSession
from exceptiondrive_records.tokens import Principal, principal_of

LIFETIME = timedelta(hours=12)
MAX_SECRET_LENGTH = 100


def open_page_session(session: Session, principal: Principal) -> str:
    """Open a session with the rights of a token; its secret is returned here and never again.

    Sessions that have run out are removed on the way.
    """
    now = database_now(session)
    session.execute(delete(PageSession).where(PageSession.expires_at <= now))
    secret = new_secret()
    session.add(
        PageSession(
            secret_digest=secret_digest(secret),
            token_id=principal.token_id,
            created_at=now,
            expires_at=now + LIFETIME,
        )
    )
    audit(session, principal.actor, "signed in", principal.token_id)
    return secret


def find_page_session(session: Session, secret: str) -> Principal | None:
    """Return who signed in; None when the session or its token has ended.

    The secret has 256 bits and is looked up by its digest, so that no timing tells of it.
    """
    if len(secret) > MAX_SECRET_LENGTH:
        return None
    row = session.execute(
        select(PageSession, Token)
        .join(Token, Token.id == PageSession.token_id)
        .where(PageSession.secret_digest == secret_digest(secret))
    ).first()
    if row is None or row[0].expires_at <= database_now(session):
        return None
    return principal_of(session, row[1])


def end_page_session(session: Session, secret: str) -> None:
    """End a session; ending it twice does nothing."""
    session.execute(delete(PageSession).where(PageSession.secret_digest == secret_digest(secret)))


def new_secret() -> str:
    """Return the secret of a new session: 256 bits."""
    return secrets.token_urlsafe(32)


def secret_digest(secret: str) -> str:
    """Return what is kept of a secret."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
