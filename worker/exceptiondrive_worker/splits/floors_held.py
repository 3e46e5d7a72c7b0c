"""Holds the floors of a split against what the records ask for, and says so in the audit log."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import SPLIT_FLOOR_HELD, audit_once
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.rescoring.trials import lock_protocols, tried_protocols
from exceptiondrive_records.splits.confirmations import keys_that_confirm
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.splits.splits import find_split, part_revision
from exceptiondrive_records.submissions.sheets import protocols_of_split, scored_within_a_day
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
    submission_id: str | None = None,
) -> None:
    """Let pass what the floors of a split allow.

    Args:
        session: To read with.
        floors: Of the split.
        ref: The split, at the revision that is asked for.
        protocol: Under which something is to be published.
        submission_id: What is to be scored; None: a board is to be built.

    Raises:
        SplitDayFullError: Enough submissions were scored within a day.
        FloorHeldError: Anything else is too much.
    """
    if find_public_split(session, ref) is not None:
        return
    scored = protocols_of_split(session, ref.name)
    protocols = scored | tried_protocols(session, ref.name) | {protocol.digest}
    found = [
        *breaches(floors, protocol),
        *unconfirmed(floors, keys_that_confirm(session, ref, protocol.digest)),
    ]
    if protocol.digest not in scored and len(protocols) > floors.max_protocols:
        found.append(
            f"it would be protocol number {len(protocols)}, at most {floors.max_protocols} may be"
        )
    opens, now = floors.private_part_from, database_now(session)
    if opens is not None and now < opens and _has_private(session, ref):
        found.append(f"the private part is closed until {opens:%Y-%m-%d %H:%M %Z}")
    if found:
        raise FloorHeldError(*found)
    if submission_id is not None:
        n_scored = scored_within_a_day(session, ref.name, now, besides=submission_id)
        if n_scored >= floors.max_scored_per_day:
            raise SplitDayFullError(
                f"another submission, after {n_scored} of {now:%Y-%m-%d}; at most "
                f"{floors.max_scored_per_day} a day may be scored"
            )


def _has_private(session: Session, ref: SplitRef) -> bool:
    """Whether samples of the private part are scored: as the part, or with the whole split."""
    part = find_split(session, ref.name, ref.revision).part
    private = part_revision(session, ref.name, ref.revision, "private")
    return part == "private" or (part is None and private is not None)


def hold_floors_alone(
    session: Session,
    floors: SplitFloors,
    ref: SplitRef,
    protocol: ProtocolDocument,
    submission_id: str | None = None,
) -> None:
    """Hold them before the write transaction records: two together take no more than is left.

    Raises:
        FloorHeldError: As `hold_floors`.
    """
    lock_protocols(session, ref.name)
    hold_floors(session, floors, ref, protocol, submission_id)


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
