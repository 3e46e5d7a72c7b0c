"""Reference rows: baselines that need no skill, scored like entries and added to every board.

They are no submissions: nobody uploaded them, and they depend on split and protocol alone. So each
board makes its own, from the cache in the private store, and an old board keeps its own.
"""

from dataclasses import replace

from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.references import REFERENCES
from exceptiondrive_scoring.references import reference_answers
from exceptiondrive_worker.boards.comparisons import entry_uncertainties
from exceptiondrive_worker.boards.entries import ScoredReference
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.private_store import pack_columns, unpack_columns
from exceptiondrive_worker.stages import Stages, Target


def scored_references(stages: Stages, like: Target, rounding: Rounding) -> list[ScoredReference]:
    """Score the references of a challenge for which the split has the data.

    `like` is a target with challenge, split and protocol of the board; its file does not matter.
    """
    split, geometry = like.split, like.protocol.geometry
    n_samples = len(split.manifest.sample_ids)
    made = {
        reference: pack_columns(answers)
        for reference in REFERENCES.get(like.challenge.id, ())
        if (answers := reference_answers(reference, n_samples, geometry, split.recorded_m))
    }
    targets = [
        replace(like, file_digest=bytes_digest(packed), made=unpack_columns(packed))
        for packed in made.values()
    ]
    scored = [stages.score(target) for target in targets]
    measured = [
        (target, each.measurement_key) for target, each in zip(targets, scored, strict=True)
    ]
    return [
        ScoredReference(reference, rounding.sheet(each.sheet), sure)
        for reference, each, sure in zip(
            made, scored, entry_uncertainties(stages, measured), strict=True
        )
    ]
