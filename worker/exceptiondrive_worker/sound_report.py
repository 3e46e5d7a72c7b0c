"""What a sound planning file looks like: the client's own words, for who uploads with a browser."""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import math
from array import array
from collections.abc import Iterator

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.check.source_fit import file_profile
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.file_profile import FileProfile, Mend
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_worker.stages import Stages, Target


def sound_report(stages: Stages, target: Target, size_bytes: int) -> CheckReport | None:
    """Return a report without faults that says what the file looks like.

    It is made of the file and of what the manifest tells everybody, never of regions or of recorded
    drives that are withheld.

    Args:
        stages: Hold the answers.
        target: What was scored.
        size_bytes: Of the upload.
    """
    if target.challenge.id != PLANNING.id:
        return None
    manifest, protocol = target.split.manifest, target.protocol
    pairs = TrajectoryPairs.from_columns(stages.answers(target))
    rows = map(TrajectoryPair, _flats(pairs.source), _flats(pairs.edited))
    profile = file_profile(
        dict(zip(manifest.sample_ids, rows, strict=True)),
        protocol.geometry,
        protocol.plausibility,
        manifest.recorded,
    )
    return CheckReport(
        challenge=target.challenge.id,
        split=manifest.name,
        n_predictions=len(manifest.sample_ids),
        digest=target.file_digest,
        size_bytes=size_bytes,
        profile=None if profile is None else _rounded(profile, protocol.publication),
    )


def _rounded(profile: FileProfile, publication: PublicationSection) -> FileProfile:
    """Round metres and shares to the digits that the protocol publishes."""
    mend = profile.mend

    def digits(name: str) -> int:
        is_metres = name.endswith(("_m", "_mps"))
        return publication.metre_decimals if is_metres else publication.percent_decimals + 2

    def of(document: FileProfile | Mend) -> dict[str, float]:
        return {
            name: round(value, digits(name)) for name, value in document if isinstance(value, float)
        }

    mended = None if mend is None else mend.model_copy(update=of(mend))
    return profile.model_copy(update={**of(profile), "mend": mended})


def _flats(waypoints_m: FloatArray) -> Iterator[array[float] | None]:
    """Each trajectory of (N, T, 2) by itself, None where missing."""
    values, width = array("d", waypoints_m.tobytes()), 2 * waypoints_m.shape[1]
    for start in range(0, len(values), width):
        yield None if math.isnan(values[start]) else values[start : start + width]
