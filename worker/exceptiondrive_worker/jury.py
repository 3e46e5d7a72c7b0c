"""The jury of a split: planners whose behaviour is known, scored before all others.

They validate it as judges' solutions do a problem of a programming contest. Trajectory files are
scored like uploads, and so are the reference rows. An unexpected result is a gate.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.references import FREEZE, REFERENCES, SOURCE_AS_EDITED
from exceptiondrive_scoring.references import reference_answers
from exceptiondrive_worker.splits.private_store import PrivateStore
from exceptiondrive_worker.splits.store import LoadedSplit
from exceptiondrive_worker.stages import RejectedUpload, Stages, Target
from exceptiondrive_worker.upload_reader import read_upload

STANDS_SAFE = 0.95
"""Least HCC of a car that stands still: below, many regions crowd the start."""
UNAWARE_HITS = 0.5
"""Least UR of a driver who follows the recorded path: below, most regions call for no response."""
TOO_EASY = 0.95
"""Highest HCC of a moving planner: above, the split does not separate planners."""
STANDING = frozenset({"stands_still", "source_stands_still", "hardly_moves"})
"""Flags of files that do not move; their HCC says nothing about the split."""


@dataclass(frozen=True)
class Verdict:
    """The result of a member of the jury, a reference row or a file, by the average that ranks.

    HCC and UR are None if it was not scored. The objection says what is unexpected; with one of the
    flags it is no moving planner, and its HCC is not judged. On a split with parts each part is
    judged, too.
    """

    method: str
    hcc: float | None
    ur: float | None
    objection: str = ""
    flags: tuple[str, ...] = ()
    part: SplitPart | None = None


def files_of_jury(folder: Path) -> dict[str, bytes]:
    """Return the trajectory files in a folder by file name: `.json` and `.json.gz`.

    Raises:
        OSError: The folder cannot be read.
    """
    paths = [path for path in sorted(folder.iterdir()) if path.name.endswith((".json", ".json.gz"))]
    return {path.name: path.read_bytes() for path in paths}


def jury(
    split: LoadedSplit, protocol: ProtocolDocument, files: Mapping[str, bytes], folder: Path
) -> Iterator[Verdict]:
    """Score reference rows and files, each under its name, one after the other.

    What scoring keeps meanwhile in the folder is withheld, and to be removed by the caller.
    """
    by_digest = {bytes_digest(data): data for data in files.values()}
    stages = Stages(PrivateStore(folder), by_digest.__getitem__, read_upload)
    for reference in REFERENCES[PLANNING.id]:
        answers = reference_answers(
            reference, len(split.manifest.sample_ids), protocol.geometry, split.recorded_m
        )
        if answers is not None:
            target = Target(reference.method, PLANNING, split, protocol, made=answers)
            yield _verdict(stages, target, reference.method)
    for name, data in files.items():
        yield _verdict(stages, Target(bytes_digest(data), PLANNING, split, protocol), name)


def _verdict(stages: Stages, target: Target, method: str) -> Verdict:
    try:
        sheet = stages.score(target).sheet
    except RejectedUpload as rejected:
        faults = rejected.report.faults
        why = "; ".join(f"{group.code.value} ({group.count:,})" for group in faults)
        return Verdict(method, None, None, why)
    row = sheet.average(target.protocol.grading.headline)
    flags = tuple(flag.code for flag in sheet.plausibility.flags if flag.code in STANDING)
    objection = _objection(method, row["hcc"], row["ur"], moves=not flags)
    return Verdict(method, row["hcc"], row["ur"], objection, flags)


def _objection(method: str, hcc: float | None, ur: float | None, *, moves: bool) -> str:
    if hcc is None or ur is None:
        return "has no score"
    if method == FREEZE.method:
        if ur > 0 or hcc < STANDS_SAFE:
            return (
                f"a car that stands still should have HCC 100 and UR 0, at least {STANDS_SAFE:.0%}"
            )
    elif method == SOURCE_AS_EDITED.method:
        if ur < UNAWARE_HITS:
            return (
                f"who drives on as recorded should hit at least {UNAWARE_HITS:.0%} of the regions"
            )
    elif moves and hcc > TOO_EASY:
        return f"a moving planner has HCC above {TOO_EASY:.0%}: the split tells nobody apart"
    return ""
