"""The edits that people inspect: those with low marks, and a seeded draw of the accepted ones.

The draw is by a digest of seed and sample id: it is the same on every machine, and adding or
removing a candidate changes at most one place of it.
"""

from collections import defaultdict
from collections.abc import Mapping

from exceptiondrive_build.candidates import Candidate, shares
from exceptiondrive_build.settings import InspectSection
from exceptiondrive_build.values import Reviewed
from exceptiondrive_schemas.base import content_digest

LOW_MARK, DRAWN = "low mark", "random draw"


def to_inspect(candidates: Mapping[str, Candidate], settings: InspectSection) -> dict[str, str]:
    """Return the sample ids to inspect, each with its reason: `random draw` (first) or `low mark`.

    Decided ones stay in the list: callers leave out what has been inspected.
    """
    found = dict.fromkeys(draw(candidates, settings), DRAWN)
    for sample_id, candidate in candidates.items():
        reviewed = candidate.reviewed
        if isinstance(reviewed, Reviewed) and min(reviewed.marks.values()) <= settings.low_mark:
            found.setdefault(sample_id, LOW_MARK)
    return found


def draw(candidates: Mapping[str, Candidate], settings: InspectSection) -> tuple[str, ...]:
    """Return the sample ids drawn from the edits that passed the review, in the order drawn."""
    strata: dict[str, list[str]] = defaultdict(list)
    for sample_id, candidate in candidates.items():
        if candidate.passed_review:
            strata[candidate.task.family if settings.by_family else ""].append(sample_id)
    sizes = shares({key: len(ids) for key, ids in strata.items()}, settings.draw)
    drawn = []
    for stratum, ids in strata.items():
        ids.sort(key=lambda sample_id: content_digest([settings.seed, sample_id]))
        drawn += ids[: sizes[stratum]]
    return tuple(sorted(drawn, key=lambda sample_id: content_digest([settings.seed, sample_id])))
