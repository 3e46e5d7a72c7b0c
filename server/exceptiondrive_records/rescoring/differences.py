"""What a run changes, from the recorded documents."""

from sqlalchemy.orm import Session

from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.rescoring.keys import new_key, old_key
from exceptiondrive_records.rescoring.pairs import count_pairs
from exceptiondrive_records.splits import find_split
from exceptiondrive_records.tables import Phase, SplitRow
from exceptiondrive_records.tables_rescoring import RescoringRun
from exceptiondrive_schemas.protocol_difference import (
    Change,
    Difference,
    Stage,
    protocol_difference,
    split_changes,
)


def difference_of(session: Session, run: RescoringRun) -> Difference:
    """Return what a run changes, in plain words, and how many sheets stand to be made again."""
    phase = session.get_one(Phase, run.phase_id)
    old, new = old_key(run), new_key(run)
    before, after = (
        find_split(session, phase.split_name, key.split_revision) for key in (old, new)
    )
    return protocol_difference(
        find_protocol(session, old.protocol_digest),
        find_protocol(session, new.protocol_digest),
        count_pairs(session, phase.id, new).total,
        split=_part_change(before, after) or split_changes(before.manifest, after.manifest),
    )


def taken_back(sentences: tuple[str, ...]) -> tuple[str, ...]:
    """Return the sentences of a run that was rolled back."""
    return tuple(f"taken back: {sentence}" for sentence in sentences)


def _part_change(before: SplitRow, after: SplitRow) -> tuple[Change, ...]:
    """Say which samples count, where the part of the split changes."""
    if before.part == after.part:
        return ()
    old, new = (f"{_part_words(row)} ({row.n_samples:,} samples)" for row in (before, after))
    return (Change(sentence=f"{new} count in place of {old}", stage=Stage.MEASURE),)


def _part_words(row: SplitRow) -> str:
    return "all samples of the split" if row.part is None else f"the {row.part} part of the split"
