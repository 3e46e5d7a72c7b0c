"""Draws entries of public splits, and the example of a protocol. Drawings are public forever.

A drawing shows hazard regions. Nothing of a split is drawn unless the records say that its whole
file is public; the records check this again when they store it.
"""

from collections.abc import Sequence

import structlog

from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.drawings import (
    PublicSplit,
    drawn_submissions,
    find_public_split,
    has_protocol_drawing,
    keep_entry_drawings,
    keep_protocol_drawing,
)
from exceptiondrive_schemas.drawing import PACKAGED_DRAWING, EntryDrawings
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_scoring.drawing import protocol_drawing
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.stages import RejectedUpload, Stages, Target

DRAWN_AT_ONCE = 50
"""Entries drawn after one board: new ones, or some of those whose drawings are missing."""

Drawable = tuple[Target, str]
"""A target to draw, and its submission."""

_log = structlog.get_logger("exceptiondrive.worker")


class WithheldSplitError(Exception):
    """A drawing of a split that is not public was requested."""


def draw_entries(context: WorkerContext, entries: Sequence[Drawable]) -> None:
    """Draw the entries that have no drawings yet, if their split is public.

    All are of one phase under one protocol and split revision. Those beyond `DRAWN_AT_ONCE` wait
    for the next call.
    """
    if not entries:
        return
    target = entries[0][0]
    ref, digest = target.split.manifest.ref, target.protocol.digest
    with context.database.read() as session:
        split = find_public_split(session, ref)
        drawn = drawn_submissions(session, digest, ref.revision)
    if split is None:
        return
    missing = [(t, submission_id) for t, submission_id in entries if submission_id not in drawn]
    for target, submission_id in missing[:DRAWN_AT_ONCE]:
        _draw_entry(context, split, target, submission_id)


def _draw_entry(
    context: WorkerContext, split: PublicSplit, target: Target, submission_id: str
) -> None:
    try:
        drawings = drawings_of(context.stages, split, target)
    except RejectedUpload:
        _log.warning("not drawn: the upload cannot be read any more", submission=submission_id)
        return
    if drawings is None:
        return
    with context.database.write() as session:
        keep_entry_drawings(session, submission_id, target.protocol.digest, split, drawings)


def drawings_of(stages: Stages, split: PublicSplit, target: Target) -> EntryDrawings | None:
    """Draw samples of an upload; None if the challenge has no drawings.

    Raises:
        WithheldSplitError: The upload was scored on another split than this public one.
        RejectedUpload: The answers are no longer cached, and the upload now has faults.
    """
    loaded = target.split
    if loaded.manifest.ref != split.ref:
        raise WithheldSplitError(f"split {loaded.manifest.name} is not public: nothing is drawn")
    return target.scoring.drawings(
        stages.counted_answers(target),
        stages.measurements(target),
        loaded.counted_ids,
        loaded.arrays,
        target.protocol,
    )


def draw_protocol(context: WorkerContext, protocol_digest: str) -> None:
    """Draw the example sample of a protocol, unless that is done."""
    with context.database.read() as session:
        protocol = find_protocol(session, protocol_digest)
        if has_protocol_drawing(session, protocol):
            return
    drawing = protocol_drawing(protocol)
    with context.database.write() as session:
        keep_protocol_drawing(session, drawing)


def packaged_drawing_text() -> str:
    """Return the drawing of the packaged protocol, as it ships with the schemas."""
    return protocol_drawing(packaged_protocol()).model_dump_json(by_alias=True, indent=1) + "\n"


if __name__ == "__main__":
    PACKAGED_DRAWING.write_text(packaged_drawing_text(), encoding="utf-8")
