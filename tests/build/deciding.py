"""What people decide in a made-up workshop: two readings of every region, some edits inspected."""

from tests.build.shop import block

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.inspection import draw
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.values import Inspected, Verified
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document

PEOPLE = ("ada-canary", "grace-canary")


def decisions(workshop: Workshop) -> list[Record]:
    """Two readings of each region, three of them no; five of the edits drawn, one of them no."""
    candidates, found = walk(workshop), []
    for place, it in enumerate(candidates.values()):
        accepted = place % 14 != 0
        word = Verified(accepted=accepted, corners=block(place) if accepted else None)
        found += [record(Kind.VERIFY, it.sample_id, who, it.pictures, word) for who in PEOPLE]
    failed = rejected_edit(workshop)
    drawn = [key for key in draw(candidates, workshop.settings.inspect) if key != failed]
    for key in (*drawn[:4], failed):
        passed = Inspected(passed=key != failed)
        found.append(record(Kind.INSPECT, key, PEOPLE[0], candidates[key].pictures, passed))
    return found


def rejected_edit(workshop: Workshop) -> str:
    """The drawn edit that its inspector rejects; its readers do not."""
    candidates = list(walk(workshop))
    drawn = draw(walk(workshop), workshop.settings.inspect)
    return next(key for key in drawn if candidates.index(key) % 14)


def record(
    kind: Kind, candidate: str, person: str, inputs: tuple[str, ...], value: Document
) -> Record:
    return Record(
        kind=kind,
        candidate=candidate,
        by=Author(person=person),
        inputs=inputs,
        value=value.model_dump(mode="json"),
    )
