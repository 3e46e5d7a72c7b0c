"""The tables of accounts."""

from datetime import datetime

from sqlalchemy import CheckConstraint, ForeignKey, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class Token(Base):
    """A bearer token; only the digest of its text is kept."""

    __tablename__ = "tokens"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int | None] = mapped_column(ForeignKey("teams.id"), index=True)
    name: Mapped[str]
    scopes: Mapped[list[str]]
    phases: Mapped[list[str]]
    """The phases that an organizer's token is confined to; empty if it is for the whole site."""
    secret_digest: Mapped[str]
    prefix: Mapped[str]
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]


class BrowserSession(Base):
    """A browser that signed in, with a token or as a person; only its secret's digest is kept."""

    __tablename__ = "sessions"
    __table_args__ = (CheckConstraint("(token_id IS NULL) <> (person_id IS NULL)"),)
    secret_digest: Mapped[str] = mapped_column(primary_key=True)
    token_id: Mapped[str | None] = mapped_column(ForeignKey("tokens.id"), index=True)
    """The session may do what this token may, and ends with it."""
    person_id: Mapped[str | None] = mapped_column(ForeignKey("people.id"), index=True)
    team_id: Mapped[int | None] = mapped_column(ForeignKey("teams.id"))
    """The team that the person acts for now; valid only while the membership lasts."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class SignInAttempts(Base):
    """The number of sign-in attempts under one key (an address, a token id) since `since`."""

    __tablename__ = "sign_in_attempts"
    key: Mapped[str] = mapped_column(primary_key=True)
    n: Mapped[int]
    since: Mapped[datetime] = mapped_column(index=True)


FORGOTTEN = "forgotten"
"""The issuer recorded for forgotten people; no real issuer has it, as issuers are addresses."""


class Person(Base):
    """Somebody whom an OpenID provider vouches for."""

    __tablename__ = "people"
    __table_args__ = (UniqueConstraint("issuer", "subject"),)
    id: Mapped[str] = mapped_column(primary_key=True)
    issuer: Mapped[str]
    subject: Mapped[str]
    """The issuer's id of the person: never shown; it alone, with `issuer`, identifies them."""
    name: Mapped[str]
    email: Mapped[str | None]
    """As the provider gave it; shown only to people who know the person, and never compared."""
    organizer_role: Mapped[str | None]
    """An `OrganizerRole`; None if the person is no organizer."""
    organizer_phases: Mapped[list[str]]
    """The phases that the role is confined to; empty if it is for the whole site."""
    created_at: Mapped[datetime]
    signed_in_at: Mapped[datetime]

    @property
    def is_organizer(self) -> bool:
        """Whether the person has any role."""
        return self.organizer_role is not None


class Membership(Base):
    """A person who acts for a team."""

    __tablename__ = "memberships"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    person_id: Mapped[str] = mapped_column(ForeignKey("people.id"), primary_key=True, index=True)
    joined_at: Mapped[datetime]


class Invitation(Base):
    """A link with which one person joins a team, once; only its digest is kept."""

    __tablename__ = "invitations"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    secret_digest: Mapped[str]
    invited_by: Mapped[str]
    """The name of its maker on team pages."""
    made_by: Mapped[str]
    """Its maker as an audit actor; the invitation ends when they lose the right to invite."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
    used_at: Mapped[datetime | None]
    used_by: Mapped[str | None] = mapped_column(ForeignKey("people.id"))
