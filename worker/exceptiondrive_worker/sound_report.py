"""What a sound planning file looks like: the client's own words, for who uploads with a browser."""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import math
from array import array

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.check.source_fit import file_profile
from exceptiondrive_schemas.faults import CheckReport
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
    rows = zip(manifest.sample_ids, pairs.source, pairs.edited, strict=True)
    profile = file_profile(
        {name: TrajectoryPair(_flat(source), _flat(edited)) for name, source, edited in rows},
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
        profile=profile,
    )


def _flat(waypoints_m: FloatArray) -> array[float] | None:
    values = array("d", waypoints_m.tobytes())
    return None if math.isnan(values[0]) else values
