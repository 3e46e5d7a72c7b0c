"""Flags of motion that a planning file tells of before it is scored.

The rules of the scorer (docs/protocol.md section 5) in pure Python: the client has no numpy. What takes families, regions or controls is left to the scorer.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.protocol import ProtocolDocument

Step = tuple[float, float, float]
"""Its x, y and length, metres."""


class _Counts(NamedTuple):
    """Of one pair, 0 or 1 each; None where it is not asked."""

    is_impossible: bool | None
    is_first_step_wrong: bool | None
    edited_behind: bool
    source_behind: bool
    progress: float | None


def motion_flags(
    pairs: Sequence[TrajectoryPair], protocol: ProtocolDocument
) -> Iterator[tuple[str, str]]:
    """Yield codes of flags of motion, and why they will be raised.

    Args:
        pairs: Of all samples, metres, with the waypoints of the protocol.
        protocol: Thresholds and time step.
    """
    section = protocol.plausibility
    counts = [_counts(pair, protocol) for pair in pairs]
    impossible = _share([each.is_impossible for each in counts])
    first_step = _share([each.is_first_step_wrong for each in counts])
    if impossible > section.flag_impossible:
        yield (
            "impossible_motion",
            f"{impossible:.0%} of the edited trajectories are none that a car can drive",
        )
    elif first_step > section.flag_first_step:
        yield (
            "impossible_motion",
            (
                f"{first_step:.1%} of the edited trajectories begin as the speed of the source does not "
                "allow"
            ),
        )
    edited_behind = _share([each.edited_behind for each in counts])
    source_behind = _share([each.source_behind for each in counts])
    if edited_behind - source_behind > section.flag_reverses_excess:
        yield (
            "reverses",
            (
                f"{edited_behind:.0%} of the edited trajectories end behind the start, "
                f"{source_behind:.0%} of the source"
            ),
        )
    along = [each.progress for each in counts if each.progress is not None]
    if along and (mean := sum(along) / len(along)) < section.flag_progress:
        yield (
            "hardly_moves",
            f"the edited trajectories end {mean:.0%} along the source trajectories",
        )


def _counts(pair: TrajectoryPair, protocol: ProtocolDocument) -> _Counts:
    section = protocol.plausibility
    source = None if pair.source is None else _steps(pair.source)
    edited = None if pair.edited is None else _steps(pair.edited)
    is_wrong = None if source is None or edited is None else _is_wrong(source, edited, protocol)
    return _Counts(
        is_impossible=None
        if edited is None
        else bool(is_wrong) or _is_undrivable(edited, protocol),
        is_first_step_wrong=is_wrong,
        edited_behind=_is_behind(pair.edited, section.stationary_below_m),
        source_behind=_is_behind(pair.source, section.stationary_below_m),
        progress=None
        if source is None
        else _progress(source, pair.edited, section.progress_min_path_m),
    )


def _steps(flat: Sequence[float]) -> list[Step]:
    xs, ys = [0.0, *flat[::2]], [0.0, *flat[1::2]]
    moves = [(x1 - x0, y1 - y0) for x0, x1, y0, y1 in zip(xs, xs[1:], ys, ys[1:], strict=False)]
    return [(x, y, math.hypot(x, y)) for x, y in moves]


def _is_behind(flat: Sequence[float] | None, reach_m: float) -> bool:
    return flat is not None and flat[-2] < 0 and math.hypot(flat[-2], flat[-1]) >= reach_m


def _is_undrivable(steps: Sequence[Step], protocol: ProtocolDocument) -> bool:
    """Whether it accelerates too strongly, or turns too tightly where both steps have a heading."""
    geometry, section = protocol.geometry, protocol.plausibility
    most_m = section.max_acceleration_mps2 * geometry.time_step_s**2
    heading_m = geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    for (ux, uy, u), (vx, vy, v) in itertools.pairwise(steps):
        if math.hypot(vx - ux, vy - uy) > most_m:
            return True
        doubled_area = 2 * abs(ux * vy - uy * vx)
        if u > heading_m and v > heading_m and doubled_area:
            radius_m = u * v * math.hypot(ux + vx, uy + vy) / doubled_area
            if radius_m < section.min_turn_radius_m:
                return True
    return False


def _is_wrong(source: Sequence[Step], edited: Sequence[Step], protocol: ProtocolDocument) -> bool:
    """Whether the first edited step is one that the source's own initial speed does not allow."""
    time_s, section = protocol.geometry.time_step_s, protocol.plausibility
    most_mps2 = section.max_acceleration_mps2
    speed_mps, first_m = source[0][2] / time_s, edited[0][2]
    braking_s = min(speed_mps / most_mps2, time_s)
    nearest_m = speed_mps * braking_s - most_mps2 * braking_s**2 / 2
    farthest_m = speed_mps * time_s + most_mps2 * time_s**2 / 2
    is_too_short = first_m < nearest_m and speed_mps >= section.first_step_from_mps
    return is_too_short or first_m > farthest_m


def _progress(
    source: Sequence[Step], edited: Sequence[float] | None, least_m: float
) -> float | None:
    """Return how far along its source an edited trajectory ends, as a share; None: a short source."""
    path_m = sum(length for _, _, length in source)
    if path_m < least_m:
        return None
    if edited is None:
        return 0.0
    x, y, gone_m = edited[-2], edited[-1], 0.0
    nearest = (math.inf, 0.0)
    for step_x, step_y, length in source:
        share = (x * step_x + y * step_y) / length**2 if length else 0.0
        share = min(max(share, 0.0), 1.0)
        gap_m = math.hypot(x - share * step_x, y - share * step_y)
        if gap_m < nearest[0]:
            nearest = (gap_m, gone_m + share * length)
        x, y, gone_m = x - step_x, y - step_y, gone_m + length
    return min(nearest[1] / path_m, 1.0)


def _share(answers: Sequence[bool | None]) -> float:
    asked = [answer for answer in answers if answer is not None]
    return sum(asked) / len(asked) if asked else 0.0
