"""Plausibility shares of an entry in words, each with the threshold of the protocol."""

from dataclasses import dataclass

from exceptiondrive_schemas.protocol import PlausibilitySection
from exceptiondrive_schemas.score_sheet import Flag, Plausibility
from exceptiondrive_server.pages.numbers import fixed


@dataclass(frozen=True)
class PlausibilityLine:
    """One share: what it counts, its value in per cent, when it raises a flag."""

    words: str
    value: str | None
    threshold: str
    flag: Flag | None


def plausibility_lines(
    plausibility: Plausibility, section: PlausibilitySection
) -> tuple[PlausibilityLine, ...]:
    """Return a line for every share that the score sheet publishes."""
    words = _words(section)
    raised = {flag.code: flag for flag in plausibility.flags}
    return tuple(
        PlausibilityLine(
            words=words.get(key, (key.replace("_", " "), "", ""))[0],
            value=None if share is None else fixed(share * 100, 1),
            threshold=words.get(key, ("", "", ""))[1],
            flag=raised.get(words.get(key, ("", "", ""))[2]),
        )
        for key, share in _in_order(plausibility.shares, words)
    )


def _words(section: PlausibilitySection) -> dict[str, tuple[str, str, str]]:
    """Share to its words, its threshold in words, and the flag that it may raise."""
    still = f"end less than {section.stationary_below_m:g} m from the start"
    return {
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
            (
                f"edited trajectories above {section.max_acceleration_mps2:g} m/s\u00b2 or turning "
                f"tighter than {section.min_turn_radius_m:g} m"
            ),
            f"above {section.flag_impossible:.0%}",
            "impossible_motion",
        ),
    }


def _in_order(
    shares: dict[str, float | None], words: dict[str, tuple[str, str, str]]
) -> list[tuple[str, float | None]]:
    """Known shares in the order of the protocol's section, then any others."""
    keys = [key for key in words if key in shares] + [key for key in shares if key not in words]
    return [(key, shares[key]) for key in keys]
