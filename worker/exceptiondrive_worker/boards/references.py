"""Reference rows: what needs no skill, scored as entries are, on every board by itself.

They are no submissions: nobody uploaded them, and they depend on split and protocol alone. So each
board makes its own, from the private store where they are kept, and an old board keeps its.
"""

from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.references import REFERENCES
from exceptiondrive_scoring.references import reference_answers
from exceptiondrive_worker.boards.comparisons import entry_uncertainties
from exceptiondrive_worker.boards.entries import ScoredReference
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.splits.private_store import pack_columns, unpack_columns
from exceptiondrive_worker.splits.store import LoadedSplit
from exceptiondrive_worker.stages import Target


def scored_references(
    context: WorkerContext,
    challenge: Challenge,
    split: LoadedSplit,
    protocol: ProtocolDocument,
    rounding: Rounding,
) -> list[ScoredReference]:
    """Score the references of a challenge, so far as the split has what they are made of."""
    n_samples = len(split.manifest.sample_ids)
    made = {
        reference: pack_columns(answers)
        for reference in REFERENCES.get(challenge.id, ())
        if (answers := reference_answers(reference, n_samples, protocol.geometry, split.recorded_m))
    }
    targets = [
        Target(bytes_digest(packed), challenge, split, protocol, made=unpack_columns(packed))
        for packed in made.values()
    ]
    scored = [context.stages.score(target) for target in targets]
    uncertainties = entry_uncertainties(
        context.private,
        context.stages,
        [(target, each.measurement_key) for target, each in zip(targets, scored, strict=True)],
    )
    has_drives = split.manifest.recorded is not None
    return [
        ScoredReference(reference, rounding.sheet(each.sheet, has_public_drives=has_drives), sure)
        for reference, each, sure in zip(made, scored, uncertainties, strict=True)
    ]
