"""Flags: reasons why an entry's numbers mean less than they seem to (docs/protocol.md section 5).

Shown beside the score and never folded into it. A protocol names the flags that keep an entry from
ranking (`ranking.unranked_flags`); whatever the protocol, an entry with a flag that bars leading is
named as the best by no headline, card or badge.
"""

from collections.abc import Iterable, Mapping

from exceptiondrive_schemas.base import Document


class FlagKind(Document):
    """A flag as it is known before any entry carries it."""

    code: str
    label: str
    meaning: str
    bars_leading: bool = True
    """Whether an entry that carries it is no example of a good one, even where it ranks first."""


_KINDS = (
    FlagKind(
        code="stands_still",
        label="Stands still",
        meaning="Far more edited than source trajectories stay at the start: standing still raises "
        "HCC and lowers UR.",
    ),
    FlagKind(
        code="source_stands_still",
        label="Source stands still",
        meaning="Most source trajectories stay at the start, with no hazard in sight.",
    ),
    FlagKind(
        code="impossible_motion",
        label="Impossible motion",
        meaning="Edited trajectories that no car can drive: too strong an acceleration, too tight a "
        "turn, or a first step that the speed of the source does not allow.",
    ),
    FlagKind(
        code="reverses",
        label="Reverses",
        meaning="More edited than source trajectories end behind the start.",
    ),
    FlagKind(
        code="blind_to_the_edit",
        label="Blind to the edit",
        meaning="Nearly all pairs are equal: the planner does not see the edit, or does not heed it.",
        bars_leading=False,
    ),
    FlagKind(
        code="off_course",
        label="Off course",
        meaning="The source trajectories are far from the drive that was recorded: wrong axes, "
        "units, time step or order, or no plan for these scenes at all.",
    ),
    FlagKind(
        code="hardly_moves",
        label="Hardly moves",
        meaning="The edited trajectories get hardly anywhere along the source trajectories, in all "
        "samples or in those of a family.",
    ),
    FlagKind(
        code="over_cautious",
        label="Over-cautious",
        meaning="The edited trajectories hold back at most controls too, where no hazard asks for it.",
    ),
    FlagKind(
        code="same_answer",
        label="Same answer",
        meaning="Nearly all answers are the same, whatever the scene: one strategy, or one path.",
    ),
)

FLAGS: Mapping[str, FlagKind] = {kind.code: kind for kind in _KINDS}
"""All flags by code. Answers of a newer server may contain others."""


def bars_leading(codes: Iterable[str]) -> bool:
    """Whether one of these flags keeps an entry from being named as the best.

    Unknown flags do, since they are not known to be harmless.
    """
    return any(code not in FLAGS or FLAGS[code].bars_leading for code in codes)
