"""Plausibility: shares published beside the score, never folded into it (docs/protocol.md section 5)."""

import numpy as np

from exceptiondrive_schemas.protocol import PlausibilitySection
from exceptiondrive_schemas.score_sheet import Flag, Plausibility
from exceptiondrive_scoring.aliases import BoolArray
from exceptiondrive_scoring.measure import Measurements


def plausibility(measurements: Measurements, section: PlausibilitySection) -> Plausibility:
    """Shares of trajectories that stand, do not react, or that no car can drive.

    Shares of edited (source) trajectories are taken over the given ones; the blind share over the
    samples that have both.
    """
    m = measurements
    edited_stands = m.edited_motion_m < section.stationary_below_m
    source_stands = m.source_motion_m < section.stationary_below_m
    impossible = (m.peak_acceleration_mps2 > section.max_acceleration_mps2) | (
        m.tightest_turn_m < section.min_turn_radius_m
    )
    shares = {
        "edited_stationary": _share(edited_stands, m.edited_given),
        "source_stationary": _share(source_stands, m.source_given),
        "blind": _share(m.shift_m < section.blind_shift_below_m, m.edited_given & m.source_given),
        "impossible": _share(impossible, m.edited_given),
    }
    return Plausibility(shares=shares, flags=_flags(shares, section))


def _share(which: BoolArray, among: BoolArray) -> float | None:
    n = int(np.count_nonzero(among))
    return int(np.count_nonzero(which & among)) / n if n else None


def _flags(shares: dict[str, float | None], section: PlausibilitySection) -> tuple[Flag, ...]:
    edited, source, blind, impossible = (shares[key] or 0.0 for key in shares)
    raised = (
        (
            edited - source > section.flag_edited_stationary_excess,
            Flag(
                code="stands_still",
                label="Stands still",
                detail=f"{edited:.0%} of the edited trajectories end within {section.stationary_below_m} m"
                f" of the start, of the source trajectories {source:.0%}: standing still raises "
                "HCC and lowers UR.",
            ),
        ),
        (
            source > section.flag_source_stationary,
            Flag(
                code="source_stands_still",
                label="Source stands still",
                detail=f"{source:.0%} of the source trajectories end within {section.stationary_below_m} m"
                " of the start, with no hazard in sight.",
            ),
        ),
        (
            blind > section.flag_blind,
            Flag(
                code="blind_to_the_edit",
                label="Blind to the edit",
                detail=f"{blind:.0%} of the pairs differ by less than {section.blind_shift_below_m} m.",
            ),
        ),
        (
            impossible > section.flag_impossible,
            Flag(
                code="impossible_motion",
                label="Impossible motion",
                detail=f"{impossible:.0%} of the edited trajectories accelerate above "
                f"{section.max_acceleration_mps2:g} m/s^2 or turn tighter than "
                f"{section.min_turn_radius_m:g} m.",
            ),
        ),
    )
    return tuple(flag for is_raised, flag in raised if is_raised)
