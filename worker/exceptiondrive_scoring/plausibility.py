"""Plausibility: shares and flags beside the score, never folded into it (docs/protocol.md section 5)."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import PlausibilitySection, ProtocolDocument
from exceptiondrive_schemas.score_sheet import Flag, MetricRow, Plausibility
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import measured_progress
from exceptiondrive_scoring.measure import Measurements


class OfControls(NamedTuple):
    """Results over the controls: metrics for the total, and flags."""

    metrics: MetricRow
    flags: tuple[Flag, ...] = ()


def raised(code: str, detail: str) -> Flag:
    """Return a registered flag with the sentence that explains it."""
    return Flag(code=code, label=FLAGS[code].label, detail=detail)


def plausibility(
    measurements: Measurements, split: SplitArrays, protocol: ProtocolDocument
) -> Plausibility:
    """Return shares (standing, reversing, unreactive and undrivable trajectories) and flags.

    A missing trajectory counts as one that stands still, so that replacing it by zeros gains
    nothing. Impossible motion is a share of the given edited trajectories; the first step and the
    blind share are over the samples that have both.
    """
    m, section = measurements, protocol.plausibility
    both = m.edited_given & m.source_given
    all_samples = np.ones_like(both)
    steps_wrong = impossible_first_step(m, protocol)
    impossible = (
        (m.peak_acceleration_mps2 > section.max_acceleration_mps2)
        | (m.tightest_turn_m < section.min_turn_radius_m)
        | steps_wrong
    )
    reach_m = section.stationary_below_m
    shares = {
        "edited_stationary": share_of(~(m.edited_motion_m >= reach_m), all_samples),
        "source_stationary": share_of(~(m.source_motion_m >= reach_m), all_samples),
        "edited_behind": share_of(
            (m.edited_motion_m >= reach_m) & (m.edited_end_x_m < 0), all_samples
        ),
        "source_behind": share_of((m.source_motion_m >= reach_m) & m.source_behind, all_samples),
        "blind": share_of(m.shift_m < section.blind_shift_below_m, both),
        "impossible": share_of(impossible, m.edited_given),
        "first_step": share_of(steps_wrong, both),
    }
    known = {key: share or 0.0 for key, share in shares.items()}
    flags = (
        *_flags_of_shares(known, section, is_any_missing=not both.all()),
        *_off_course(m, section),
        *_hardly_moves(m, split, section),
        *_same_answer(m, section),
    )
    return Plausibility(shares=shares, flags=flags)


def impossible_first_step(m: Measurements, protocol: ProtocolDocument) -> BoolArray:
    """Whether the first edited step is impossible at the source's own initial speed; (N,).

    Both trajectories start at the same speed, that of the first source step. With the largest
    acceleration of the protocol the car gets no farther than v t + a t^2 / 2, and when braking it
    goes at least as far as it takes to stop. The latter is checked from `first_step_from_mps` on:
    below, a car that starts from standstill cannot be distinguished from one that rolls.
    """
    geometry, section = protocol.geometry, protocol.plausibility
    time_s, most_mps2 = geometry.time_step_s, section.max_acceleration_mps2
    speed_mps = m.source_first_step_m / time_s
    farthest_m = speed_mps * time_s + most_mps2 * time_s**2 / 2
    braking_s = np.minimum(speed_mps / most_mps2, time_s)
    nearest_m = speed_mps * braking_s - most_mps2 * braking_s**2 / 2
    too_short = (m.edited_first_step_m < nearest_m) & (speed_mps >= section.first_step_from_mps)
    wrong: BoolArray = too_short | (m.edited_first_step_m > farthest_m)
    return wrong


def share_of(which: BoolArray, among: BoolArray) -> float | None:
    """Return the share of `among` for which `which` holds; None if `among` is empty."""
    n = int(np.count_nonzero(among))
    return int(np.count_nonzero(which & among)) / n if n else None


def _flags_of_shares(
    shares: dict[str, float], section: PlausibilitySection, *, is_any_missing: bool
) -> Iterator[Flag]:
    edited, source = shares["edited_stationary"], shares["source_stationary"]
    stand = f"{'are missing or ' * is_any_missing}end within {section.stationary_below_m:g} m"
    if edited - source > section.flag_edited_stationary_excess:
        yield raised(
            "stands_still",
            f"{edited:.0%} of the edited trajectories {stand} of the start, of the source "
            f"trajectories {source:.0%}: standing still raises HCC and lowers UR.",
        )
    if source > section.flag_source_stationary:
        yield raised(
            "source_stands_still",
            f"{share_past(source, section.flag_source_stationary)} of the source trajectories {stand} "
            "of the start, with no hazard in sight.",
        )
    if shares["blind"] > section.flag_blind:
        yield raised(
            "blind_to_the_edit",
            f"{share_past(shares['blind'], section.flag_blind)} of the pairs differ by less than "
            f"{section.blind_shift_below_m:g} m.",
        )
    if shares["impossible"] > section.flag_impossible:
        yield raised(
            "impossible_motion",
            f"{share_past(shares['impossible'], section.flag_impossible)} of the edited trajectories "
            f"accelerate above {section.max_acceleration_mps2:g} m/s^2, turn tighter than "
            f"{section.min_turn_radius_m:g} m, or begin as the speed of the source does not allow.",
        )
    elif shares["first_step"] > section.flag_first_step:
        yield raised(
            "impossible_motion",
            f"{share_past(shares['first_step'], section.flag_first_step, 1)} of the edited trajectories "
            "begin with a step that the speed of the source does not allow, even at "
            f"{section.max_acceleration_mps2:g} m/s^2.",
        )
    behind, source_behind = shares["edited_behind"], shares["source_behind"]
    if behind - source_behind > section.flag_reverses_excess:
        yield raised(
            "reverses",
            f"{behind:.0%} of the edited trajectories end behind the start, of the source "
            f"trajectories {source_behind:.0%}.",
        )


def _off_course(m: Measurements, section: PlausibilitySection) -> Iterator[Flag]:
    """Flag by the median, which a few outliers do not move."""
    if m.source_l2_m is None:
        return
    known = m.source_l2_m[~np.isnan(m.source_l2_m)]
    if len(known) and _median(known) > section.flag_off_course_m:
        yield raised(
            "off_course",
            f"Half of the source trajectories are more than {section.flag_off_course_m:g} m from the "
            "drive that was recorded in the unedited scene.",
        )


def _hardly_moves(
    m: Measurements, split: SplitArrays, section: PlausibilitySection
) -> Iterator[Flag]:
    """Flag over all samples, or in a family with enough samples for a meaningful mean."""
    shares = measured_progress(m, section)
    is_known = ~np.isnan(shares)
    shares, family = shares[is_known], split.family_index[is_known]
    if not len(shares):
        return
    total = float(shares.mean())
    n = np.bincount(family)
    mean = np.bincount(family, shares) / np.maximum(n, 1)
    stuck = (n >= section.flag_family_min_samples) & (mean < section.flag_family_progress)
    if total < section.flag_progress:
        yield raised(
            "hardly_moves",
            f"The edited trajectories end {share_past(total, section.flag_progress)} along the source "
            f"trajectories; less than {100 * section.flag_progress:g}% is hardly any way.",
        )
    elif n_stuck := int(np.count_nonzero(stuck)):
        yield raised(
            "hardly_moves",
            f"In {n_stuck} of {np.count_nonzero(n)} families the edited trajectories end less than "
            f"{100 * section.flag_family_progress:g}% along the source trajectories.",
        )


def _same_answer(m: Measurements, section: PlausibilitySection) -> Iterator[Flag]:
    """Flag one path in nearly all edited scenes: same end distance, end ahead and first step.

    Files that stand still or creep have their own flags.
    """
    measured = np.stack([m.edited_motion_m, m.edited_end_x_m, m.edited_first_step_m])
    measured = measured[:, m.edited_given]
    if measured.shape[1] < section.flag_family_min_samples:
        return
    middle = _median(measured)[:, np.newaxis]
    is_same = (np.abs(measured - middle) < section.blind_shift_below_m).all(axis=0)
    if middle[0, 0] >= section.progress_min_path_m and is_same.mean() > section.flag_same_answer:
        share = share_past(is_same.mean(), section.flag_same_answer)
        yield raised("same_answer", f"{share} of the edited trajectories are the same.")


def _median(values: FloatArray) -> FloatArray:
    """Return the medians over the last axis of numbers, (..., n), n > 0, bit for bit as numpy does.

    `np.median` would import masked arrays.
    """
    ordered, n = np.sort(values, axis=-1), values.shape[-1]
    medians: FloatArray = (ordered[..., (n - 1) // 2] + ordered[..., n // 2]) / 2
    return medians
