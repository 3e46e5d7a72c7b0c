"""Tables of access: signed-in browsers, and attempts to sign in."""

from datetime import datetime

from sqlalchemy import ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class PageSession(Base):
    """A browser that signed in with a token; only the digest of its cookie is kept."""

    __tablename__ = "page_sessions"
    secret_digest: Mapped[str] = mapped_column(primary_key=True)
    token_id: Mapped[str] = mapped_column(ForeignKey("tokens.id"), index=True)
    """The session may do what this token may, and ends with it."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class SignInAttempts(Base):
    """How often a sign-in was tried under one key (an address, a token id) since a moment."""

    __tablename__ = "sign_in_attempts"
    key: Mapped[str] = mapped_column(primary_key=True)
    n: Mapped[int]
    since: Mapped[datetime] = mapped_column(index=True)
