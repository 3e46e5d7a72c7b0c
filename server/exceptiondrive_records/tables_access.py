"""Tables of access: signed-in browsers, and attempts to sign in."""

from datetime import datetime

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.tables import Base


class BrowserSession(Base):
    """A browser that signed in, with a token or as a person; only its secret's digest is kept."""

    __tablename__ = "sessions"
    __table_args__ = (CheckConstraint("(token_id IS NULL) <> (person_id IS NULL)"),)
    secret_digest: Mapped[str] = mapped_column(primary_key=True)
    token_id: Mapped[str | None] = mapped_column(ForeignKey("tokens.id"), index=True)
    """The session may do what this token may, and ends with it."""
    person_id: Mapped[str | None] = mapped_column(ForeignKey("people.id"), index=True)
    team_id: Mapped[int | None] = mapped_column(ForeignKey("teams.id"))
    """For whom the person acts now; it counts only while the membership lasts."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class SignInAttempts(Base):
    """How often a sign-in was tried under one key (an address, a token id) since a moment."""

    __tablename__ = "sign_in_attempts"
    key: Mapped[str] = mapped_column(primary_key=True)
    n: Mapped[int]
    since: Mapped[datetime] = mapped_column(index=True)
