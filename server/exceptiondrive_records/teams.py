"""Teams: they own submissions."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, NotFound
from exceptiondrive_records.identifiers import checked_slug, checked_text
from exceptiondrive_records.tables import Team


def create_team(
    session: Session, slug: str, name: str, *, is_reference: bool = False, actor: str
) -> Team:
    """Create a team.

    Raises:
        InvalidRecord: The slug or the name cannot be used.
        Conflict: One of them is taken.
    """
    checked_slug("team", slug)
    name = checked_text("team name", name, max_length=80)
    taken = session.scalars(select(Team).where((Team.slug == slug) | (Team.name == name))).first()
    if taken is not None:
        what = f"id {slug!r}" if taken.slug == slug else f"name {name!r}"
        raise Conflict(f"There is a team with the {what} already.")
    team = Team(slug=slug, name=name, is_reference=is_reference, created_at=database_now(session))
    session.add(team)
    session.flush()
    audit(session, actor, "team created", slug, {"name": name, "is_reference": is_reference})
    return team


def find_team(session: Session, slug: str) -> Team:
    """Return the team with this slug.

    Raises:
        NotFound: There is none.
    """
    team = session.scalars(select(Team).where(Team.slug == slug)).first()
    if team is None:
        raise NotFound("team", slug)
    return team


def list_teams(session: Session) -> list[Team]:
    """Return all teams by slug."""
    return list(session.scalars(select(Team).order_by(Team.slug)))
