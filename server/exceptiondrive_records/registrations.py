"""Teams that register themselves: they get a token at once, and submit when they are approved."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, NotAllowed
from exceptiondrive_records.identifiers import checked_text
from exceptiondrive_records.tables import Team, Token
from exceptiondrive_records.teams import create_team, find_team
from exceptiondrive_records.tokens import TEAM_SCOPES, issue_token

MAX_PENDING = 200
"""More than organizers would read; beyond it registration waits for them."""


def register_team(session: Session, slug: str, name: str, note: str) -> tuple[str, Token, Team]:
    """Make a team that waits for approval, and its first token, whose text is returned once.

    Raises:
        InvalidRecord: A text cannot be used.
        Conflict: Id or name is taken, or too many teams wait for approval.
    """
    team = make_pending_team(session, slug, name, note, actor="registration")
    text, token = issue_token(session, team.id, "first token", TEAM_SCOPES, actor="registration")
    return text, token, team


def make_pending_team(session: Session, slug: str, name: str, note: str, *, actor: str) -> Team:
    """Make a team that waits for approval.

    Args:
        session: Of a write transaction.
        slug: Id of the team.
        name: As the board would show it.
        note: Who they are and how to reach them; for organizers alone.
        actor: Who registers it, for the audit line.

    Raises:
        InvalidRecord: A text cannot be used.
        Conflict: Id or name is taken, or too many teams wait for approval.
    """
    waiting = session.scalar(select(func.count()).where(Team.pending_since.is_not(None))) or 0
    if waiting >= MAX_PENDING:
        raise Conflict("Too many teams wait for approval; ask an organizer.")
    note = checked_text("note", note, max_length=500, may_have_lines=True)
    team = create_team(session, slug, name, actor=actor)
    team.pending_since = database_now(session)
    team.registration_note = note
    return team


def approve_team(session: Session, slug: str, *, actor: str) -> Team:
    """Let a team that registered itself submit; approving twice does nothing.

    Raises:
        NotFound: There is no such team.
    """
    team = find_team(session, slug)
    if team.pending_since is not None:
        team.pending_since = None
        audit(session, actor, "team approved", slug)
    return team


def require_approved(team: Team) -> None:
    """Refuse a submission of a team that waits for approval."""
    if team.pending_since is not None:
        raise NotAllowed("Your team is not approved yet; an organizer has to look at it first.")
