"""Plausibility shares of an entry in words, each with the threshold of the protocol."""

from typing import NamedTuple

from exceptiondrive_schemas.protocol import PlausibilitySection
from exceptiondrive_schemas.score_sheet import Plausibility


class PlausibilityLine(NamedTuple):
    """One share: what it counts, its value, what raises a flag, whether it is raised."""

    words: str
    share: float | None
    threshold: str
    is_raised: bool


def plausibility_lines(
    plausibility: Plausibility, section: PlausibilitySection
) -> list[PlausibilityLine]:
    """Return a line for every share that the score sheet publishes, known ones first."""
    still = f"end less than {section.stationary_below_m:g} m from the start"
    turning = f"turning tighter than {section.min_turn_radius_m:g} m"
    known = {  # share to its words, its threshold, the flag that it may raise
        "edited_stationary": (
            f"edited trajectories that {still}",
            f"more than {section.flag_edited_stationary_excess:.0%} above the source share",
            "stands_still",
        ),
        "source_stationary": (
            f"source trajectories that {still}",
            f"above {section.flag_source_stationary:.0%}",
            "source_stands_still",
        ),
        "blind": (
            f"pairs that differ by less than {section.blind_shift_below_m:g} m",
            f"above {section.flag_blind:.0%}",
            "blind_to_the_edit",
        ),
        "impossible": (
            f"edited trajectories above {section.max_acceleration_mps2:g} m/s\u00b2 or {turning}",
            f"above {section.flag_impossible:.0%}",
            "impossible_motion",
        ),
    }
    raised = {flag.code for flag in plausibility.flags}
    lines = []
    for key in sorted(plausibility.shares, key=lambda key: [*known, key].index(key)):
        words, threshold, flag = known.get(key, (key.replace("_", " "), "", ""))
        lines.append(PlausibilityLine(words, plausibility.shares[key], threshold, flag in raised))
    return lines
