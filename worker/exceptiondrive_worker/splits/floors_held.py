"""Holds the floors of a split against what the records ask for, and says so in the audit log."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import SPLIT_FLOOR_HELD, audit_once
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.rescoring.trials import tried_protocols
from exceptiondrive_records.splits.confirmations import keys_that_confirm
from exceptiondrive_records.splits.splits import (
    find_split,
    lock_split,
    lock_split_last,
)
from exceptiondrive_records.submissions.sheets import (
    protocols_of_split,
    require_room_last,
    scored_within_a_day,
)
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_worker.splits.floors import (
    FloorHeldError,
    SplitDayFullError,
    SplitFloors,
    breaches,
    unconfirmed,
)


def hold_floors(
    session: Session,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    newcomer: str | None = None,
) -> None:
    """Let pass what the floors of a withheld split allow; a public one has nothing to hold back.

    The newcomer is a submission that is to get its first sheet of the split.

    Raises:
        SplitDayFullError: Enough submissions were scored within a day.
        FloorHeldError: Anything else is too much.
    """
    _hold(session, floors, ref, protocol, protocols_of_split(session, ref.name))
    if newcomer is not None:
        now = database_now(session)
        n_scored = scored_within_a_day(session, ref.name, now, besides=newcomer)
        if n_scored >= floors.max_scored_per_day:
            raise _day_full(floors, f"{n_scored} of {now:%Y-%m-%d}")


def _day_full(floors: SplitFloors, scored: str) -> SplitDayFullError:
    most = floors.max_scored_per_day
    return SplitDayFullError(
        f"another submission, after {scored}; at most {most} a day may be scored"
    )


def _hold(
    session: Session,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    scored: set[str],
) -> None:
    """All but the number of submissions; `scored` are the protocols that have sheets of the split."""
    protocols = scored | tried_protocols(session, ref.name) | {protocol.digest}
    asks_two = floors.second_organizer
    keys = keys_that_confirm(session, ref, protocol.digest) if asks_two else set()
    found = [*breaches(floors, protocol), *unconfirmed(floors, keys)]
    if protocol.digest not in scored and len(protocols) > floors.max_protocols:
        found.append(
            f"it would be protocol number {len(protocols)}, at most {floors.max_protocols} may be"
        )
    opens = floors.private_part_from
    if opens is not None and database_now(session) < opens and _has_private(session, ref):
        found.append(f"the private part is closed until {opens:%Y-%m-%d %H:%M %Z}")
    if found:
        raise FloorHeldError(*found)


def _has_private(session: Session, ref: SplitRef) -> bool:
    """Whether samples of the private part are scored: as the part, or with the whole split."""
    return find_split(session, ref.name, ref.revision).counts_private


def hold_floors_alone(
    session: Session,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    newcomer: str | None = None,
) -> None:
    """Hold them when the write transaction records: two together take no more than is left.

    A sheet takes a place among the protocols only where it is the first one under its protocol: then the
    split is locked from here on. The places of a day are counted last, under a lock held for no round trip.

    Raises:
        FloorHeldError: As `hold_floors`; `SplitDayFullError` at the end of the transaction.
    """
    scored = protocols_of_split(session, ref.name)
    if protocol.digest not in scored:
        lock_split(session, ref.name)
        scored = protocols_of_split(session, ref.name)
    _hold(session, floors, ref, protocol, scored)
    if newcomer is not None:
        most = floors.max_scored_per_day
        refusal = _day_full(floors, f"{most} within a day")
        lock_split_last(session, ref.name)
        require_room_last(session, ref.name, most, besides=newcomer, refusal=refusal)


@contextmanager
def held_floors_are_told(
    database: Database, ref: SplitRef, protocol: ProtocolDocument, phase_id: str
) -> Iterator[None]:
    """Say once in the audit log what the floors of a split refuse inside."""
    try:
        yield
    except FloorHeldError as held:
        detail = {"phase": phase_id, "protocol": protocol.version, "asked": list(held.asked)}
        with database.write() as session:
            audit_once(session, "worker", SPLIT_FLOOR_HELD, ref.name, detail)
        raise
