"""One leader at a time, by a lease in the database."""

from datetime import timedelta

from sqlalchemy import delete, update
from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.orm import Session

from exceptiondrive_records.clock import database_now
from exceptiondrive_records.tables import Leader


def take_lead(session: Session, name: str, holder: str, lease_s: float) -> bool:
    """Become or stay the leader; False while another holder's lease runs."""
    now = database_now(session)
    lease_until = now + timedelta(seconds=lease_s)
    insert = sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
    session.execute(
        insert(Leader).values(name=name, holder=holder, lease_until=now).on_conflict_do_nothing()
    )
    taken = session.execute(
        update(Leader)
        .where(Leader.name == name, (Leader.holder == holder) | (Leader.lease_until <= now))
        .values(holder=holder, lease_until=lease_until)
        .returning(Leader.name)
        .execution_options(synchronize_session=False)
    ).first()
    return taken is not None


def give_up_lead(session: Session, name: str, holder: str) -> None:
    """Let another lead at once."""
    session.execute(delete(Leader).where(Leader.name == name, Leader.holder == holder))
