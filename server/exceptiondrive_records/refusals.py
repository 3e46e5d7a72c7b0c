"""Refused registrations: a team that never submitted goes, with everything that hung on it."""

from sqlalchemy import Column, Table, delete, exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.errors import Conflict
from exceptiondrive_records.identifiers import checked_reason
from exceptiondrive_records.tables import Submission, Team, Token
from exceptiondrive_records.teams import find_team


def refuse_team(session: Session, slug: str, *, reason: str, actor: str) -> None:
    """Refuse a team that waits for approval: its id and name are free again, its tokens gone.

    Only an audit line stays. Whatever table comes to hold something of a team is emptied of it
    too, since its foreign key says so.

    Raises:
        NotFound: There is no such team.
        InvalidRecord: The reason cannot be kept.
        Conflict: It was approved, or has submitted.
    """
    team = session.get(Team, find_team(session, slug).id, with_for_update=True)
    assert team is not None
    if team.pending_since is None:
        raise Conflict("The team is approved; only a team that waits for approval can be refused.")
    if session.scalar(select(exists().where(Submission.team_id == team.id))):
        raise Conflict("The team has submissions; they cannot be taken out of the records.")
    detail = {"reason": checked_reason(reason), "name": team.name}
    audit(session, actor, "team refused", slug, detail)
    tokens = select(Token.id).where(Token.team_id == team.id).scalar_subquery()
    for table in reversed(Base.metadata.sorted_tables):
        if table is Submission.__table__:  # there are none, and the server may delete none
            continue
        for column in _pointing(table, "tokens.id"):
            session.execute(delete(table).where(column.in_(tokens)))
        for column in _pointing(table, "teams.id"):
            session.execute(delete(table).where(column == team.id))
    session.execute(delete(Team).where(Team.id == team.id))


def _pointing(table: Table, target: str) -> list[Column[object]]:
    """Return the columns of a table whose foreign key points to `target`."""
    return [
        column
        for column in table.columns
        if any(key.target_fullname == target for key in column.foreign_keys)
    ]
