"""What organizers switch while the server runs. Every change is an audit line."""

from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.tables_people import SiteSetting

_SELF_REGISTRATION = "self_registration"


def self_registration_is_on(session: Session, environment: bool | None) -> bool:
    """Whether teams may register themselves.

    Args:
        session: Of any transaction.
        environment: False forces it off, whatever organizers switched; True switches it on until
            they decide; None leaves it to them, off at first.
    """
    if environment is False:
        return False
    switched = session.get(SiteSetting, _SELF_REGISTRATION)
    return bool(switched.value["is_on"]) if switched is not None else environment is True


def switch_self_registration(session: Session, is_on: bool, *, actor: str) -> None:
    """Let teams register themselves, or no longer."""
    row = session.get(SiteSetting, _SELF_REGISTRATION)
    if row is not None and row.value == {"is_on": is_on}:
        return
    now = database_now(session)
    if row is None:
        session.add(SiteSetting(name=_SELF_REGISTRATION, value={"is_on": is_on}, changed_at=now))
    else:
        row.value, row.changed_at = {"is_on": is_on}, now
    audit(session, actor, "self-registration switched", "on" if is_on else "off")
