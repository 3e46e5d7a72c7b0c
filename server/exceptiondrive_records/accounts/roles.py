"""Organizer roles, either for the whole site or for certain phases only.

Which role a route requires is defined in `exceptiondrive_server.web.organizer_rights`.
"""

from collections.abc import Iterable
from enum import StrEnum

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import InvalidRecord, NotFound
from exceptiondrive_records.phases.tables import Phase


class OrganizerRole(StrEnum):
    """Ordered by rights: each role includes those before it."""

    READ_ONLY = "read-only"
    HELPER = "helper"
    OWNER = "owner"

    def includes(self, other: "OrganizerRole") -> bool:
        """Whether this role includes the rights of the other one."""
        order = list(OrganizerRole)
        return order.index(self) >= order.index(other)


def checked_phases(session: Session, phases: Iterable[str]) -> list[str]:
    """Return the ids of the phases that a role is confined to; empty if it is for the whole site.

    Raises:
        NotFound: One of them does not exist.
        InvalidRecord: There are too many.
    """
    wanted = sorted(set(phases))
    if len(wanted) > MAX_PHASES:
        raise InvalidRecord(f"A role is confined to at most {MAX_PHASES} phases.")
    known = set(session.scalars(select(Phase.id).where(Phase.id.in_(wanted))))
    for phase_id in wanted:
        if phase_id not in known:
            raise NotFound("phase", phase_id)
    return wanted


MAX_PHASES = 20
