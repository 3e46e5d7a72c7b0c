"""Whether the files that a phase has accepted can be scored under what is to come.

What cannot be is refused when a run is drafted: else its sheets would all fail, or be made of fewer
waypoints than those of fresh submissions. Tasks that the protocol no longer has are the worker's to
find (`split_refused`): which tasks a split has is withheld from here.
"""

from collections.abc import Iterator

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.tables import SplitRow
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.protocol import GeometrySection, Protocol

_ADVICE = "Open a new phase for it instead."


def require_readable(
    challenge: str, old: tuple[Protocol, SplitRow], new: tuple[Protocol, SplitRow]
) -> None:
    """Refuse a protocol or split revision under which accepted files cannot be scored.

    Args:
        challenge: Of the phase.
        old: What the phase shows.
        new: What is to come.

    Raises:
        InvalidRecord: They cannot; every reason is given.
    """
    reasons = [
        *_sample_reasons(old[1], new[1]),
        *_waypoint_reasons(challenge, old[0].geometry, new[0].geometry),
    ]
    if reasons:
        raise InvalidRecord(" ".join([*reasons, _ADVICE]))


def _sample_reasons(old: SplitRow, new: SplitRow) -> Iterator[str]:
    if new.revision == old.revision:
        return
    before, after = set(old.manifest.sample_ids), set(new.manifest.sample_ids)
    if before - after:
        yield (
            f"The new revision lacks {_samples(len(before - after))} that accepted files answer: "
            "they could not be read under it."
        )
    if after - before:
        yield (
            f"The new revision has {_samples(len(after - before))} that no accepted file answers: "
            "they could not be read under it."
        )


def _waypoint_reasons(challenge: str, old: GeometrySection, new: GeometrySection) -> Iterator[str]:
    if not CHALLENGES[ChallengeId(challenge)].has_waypoints:
        return
    if (old.waypoints, old.time_step_s) != (new.waypoints, new.time_step_s):
        yield (
            f"The protocol asks for {_waypoints(new)}; accepted files hold {_waypoints(old)}: "
            "they cannot be scored under it."
        )


def _samples(count: int) -> str:
    return "1 sample" if count == 1 else f"{count:,} samples"


def _waypoints(geometry: GeometrySection) -> str:
    return f"{geometry.waypoints} waypoints {geometry.time_step_s:g} s apart"
