"""Enforces the floors of a split on what the records request; refusals go to the audit log."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import SPLIT_FLOOR_HELD, audit_once
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.splits.confirmations import keys_that_confirm
from exceptiondrive_records.splits.openings import count_opening, opened_protocols
from exceptiondrive_records.splits.splits import (
    find_split,
    lock_split,
    lock_split_last,
)
from exceptiondrive_records.submissions.sheets import require_room_last, scored_within_a_day
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.splits.floors import (
    FloorHeldError,
    SplitDayFullError,
    SplitFloors,
    breaches,
    unconfirmed,
)
from exceptiondrive_worker.splits.store import LoadedSplit


def open_split(
    context: WorkerContext,
    ref: SplitRef,
    protocol: ProtocolDocument,
    *,
    phase_id: str,
    is_public: bool,
    newcomer: str | None = None,
) -> LoadedSplit:
    """Load a split under a protocol if its floors allow that; a public one has none.

    Floors are checked before anything is opened: even whether it loads reveals something of its
    regions. `newcomer` is a submission that is to get its first sheet of the split.

    Raises:
        SplitDayFullError: Enough submissions were scored within a day.
        FloorHeldError: Any other limit is exceeded; the audit log says which.
        SplitUnavailableError: No file holds it.
        SplitRefusedError: It cannot be scored under this protocol.
    """
    if not is_public:
        floors = context.splits.floors(ref.name)
        with held_floors_are_told(context.database, ref, protocol, phase_id):
            _hold_and_count(context.database, floors, ref, protocol, newcomer)
    return context.splits.find(ref.name, ref.revision, protocol)


def _hold_and_count(
    database: Database,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    newcomer: str | None,
) -> None:
    """Check the floors, and count a new protocol atomically: parallel workers obey the limit."""
    with database.read() as session:
        opened = opened_protocols(session, ref.name)
        _hold(session, floors, ref, protocol, opened)
        if newcomer is not None:
            now = database_now(session)
            n_scored = scored_within_a_day(session, ref.name, now, besides=newcomer)
            if n_scored >= floors.max_scored_per_day:
                raise _day_full(floors, f"{n_scored} of {now:%Y-%m-%d}")
    if protocol.digest not in opened:
        with database.write() as session:
            lock_split(session, ref.name)
            opened = opened_protocols(session, ref.name)
            _hold(session, floors, ref, protocol, opened)
            if protocol.digest not in opened:  # else another worker was first
                count_opening(session, ref.name, protocol.digest)


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
    opened: set[str],
) -> None:
    """Check everything but the number of submissions; `opened` are the protocols that count."""
    asks_two = floors.second_organizer
    keys = keys_that_confirm(session, ref, protocol.digest) if asks_two else set()
    found = [*breaches(floors, protocol), *unconfirmed(floors, keys)]
    n_protocols = len(opened | {protocol.digest})
    if protocol.digest not in opened and n_protocols > floors.max_protocols:
        found.append(
            f"it would be protocol number {n_protocols}, at most {floors.max_protocols} may be"
        )
    opens = floors.private_part_from
    if opens is not None and database_now(session) < opens and _may_hold_private(session, ref):
        found.append(f"the private part is closed until {opens:%Y-%m-%d %H:%M %Z}")
    if found:
        raise FloorHeldError(*found)


def _may_hold_private(session: Session, ref: SplitRef) -> bool:
    """Whether samples of a private part may be scored; only a public part certainly holds none."""
    return find_split(session, ref.name, ref.revision).part != "public"


def hold_floors_again(
    session: Session,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    newcomer: str | None = None,
) -> None:
    """Check the floors again when a sheet is recorded: two workers cannot exceed the daily limit.

    The daily limit is checked last, under a lock that is held for no round trip.

    Raises:
        FloorHeldError: As `open_split`; `SplitDayFullError` at the end of the transaction.
    """
    _hold(session, floors, ref, protocol, opened_protocols(session, ref.name))
    if newcomer is not None:
        most = floors.max_scored_per_day
        refusal = _day_full(floors, f"{most} within a day")
        lock_split_last(session, ref.name)
        require_room_last(session, ref.name, most, besides=newcomer, refusal=refusal)


@contextmanager
def held_floors_are_told(
    database: Database, ref: SplitRef, protocol: ProtocolDocument, phase_id: str
) -> Iterator[None]:
    """Record in the audit log, once, what the floors of a split refuse in this block."""
    try:
        yield
    except FloorHeldError as held:
        detail = {
            "phase": phase_id,
            "protocol": protocol.version,
            "revision": ref.revision,
            "asked": list(held.asked),
        }
        with database.write() as session:
            audit_once(session, "worker", SPLIT_FLOOR_HELD, ref.name, detail)
        raise
