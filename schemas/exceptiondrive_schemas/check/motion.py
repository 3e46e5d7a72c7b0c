"""Flags of motion that are known from a planning file before it is scored.

The scorer's rules (docs/protocol.md section 5) without numpy, which the client lacks. Flags that
need families, regions or controls are left to the scorer.
"""

import math
from collections.abc import Iterator
from itertools import pairwise

from exceptiondrive_schemas.check.tracks import Column, PairTracks, Tracks
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import ProtocolDocument


def motion_flags(
    tracks: PairTracks, n_samples: int, protocol: ProtocolDocument
) -> Iterator[tuple[str, str]]:
    """Yield codes of flags of motion, and why they will be raised.

    All trajectories have the protocol's waypoints; some samples may have none.
    """
    section = protocol.plausibility
    source, edited, n_both = tracks.source, tracks.edited, tracks.n_both
    wrong = wrong_first_steps(
        source.step_lengths_m[0][:n_both], edited.step_lengths_m[0][:n_both], protocol
    )
    impossible = _share(len(wrong | undrivable_rows(edited, protocol)), edited.n)
    first_step = _share(len(wrong), n_both)
    if impossible > section.flag_impossible:
        share = share_past(impossible, section.flag_impossible)
        what = f"{share} of the edited trajectories are none that a car can drive"
        yield "impossible_motion", what
    elif first_step > section.flag_first_step:
        share = share_past(first_step, section.flag_first_step, 1)
        what = f"{share} of the edited trajectories begin as the speed of the source does not allow"
        yield "impossible_motion", what
    edited_behind, source_behind = (
        _share(_n_behind(side, section.stationary_below_m), n_samples) for side in (edited, source)
    )
    if edited_behind - source_behind > section.flag_reverses_excess:
        yield (
            "reverses",
            (
                f"{edited_behind:.0%} of the edited trajectories end behind the start, "
                f"{source_behind:.0%} of the source"
            ),
        )
    mean = _low_progress(source, edited, n_both, protocol)
    if mean is not None:
        share = share_past(mean, section.flag_progress)
        yield "hardly_moves", f"the edited trajectories end {share} along the source trajectories"


def _share(n: int, n_asked: int) -> float:
    return n / n_asked if n_asked else 0.0


def _n_behind(tracks: Tracks, reach_m: float) -> int:
    return sum(
        x_m < 0 and end_m >= reach_m
        for x_m, end_m in zip(tracks.x_m[-1], tracks.ends_m, strict=True)
    )


def undrivable_rows(edited: Tracks, protocol: ProtocolDocument) -> set[int]:
    """Return rows that accelerate too much, or turn too tightly while both steps have a heading."""
    geometry, section = protocol.geometry, protocol.plausibility
    most_m = section.max_acceleration_mps2 * geometry.time_step_s**2
    heading_m = geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    least_m, hypot, found = section.min_turn_radius_m, math.hypot, set[int]()
    for before, after in pairwise(edited.steps):
        found.update(
            row
            for row, (ux, uy, u, vx, vy, v) in enumerate(zip(*before, *after, strict=True))
            if hypot(vx - ux, vy - uy) > most_m
            or (
                u > heading_m
                and v > heading_m
                and (doubled_area := 2 * abs(ux * vy - uy * vx))
                and u * v * hypot(ux + vx, uy + vy) / doubled_area < least_m
            )
        )
    return found


def wrong_first_steps(source_m: Column, edited_m: Column, protocol: ProtocolDocument) -> set[int]:
    """Return pairs whose first edited step is impossible at the source's own initial speed."""
    time_s, section = protocol.geometry.time_step_s, protocol.plausibility
    most_mps2, found = section.max_acceleration_mps2, set[int]()
    for row, (from_m, first_m) in enumerate(zip(source_m, edited_m, strict=True)):
        speed_mps = from_m / time_s
        braking_s = min(speed_mps / most_mps2, time_s)
        nearest_m = speed_mps * braking_s - most_mps2 * braking_s**2 / 2
        farthest_m = speed_mps * time_s + most_mps2 * time_s**2 / 2
        is_too_short = first_m < nearest_m and speed_mps >= section.first_step_from_mps
        if is_too_short or first_m > farthest_m:
            found.add(row)
    return found


def _low_progress(
    source: Tracks, edited: Tracks, n_both: int, protocol: ProtocolDocument
) -> float | None:
    """Return the mean progress if below the flag's threshold, else None; a part often suffices."""
    section = protocol.plausibility
    n_long = sum(path_m >= section.progress_min_path_m for path_m in source.lengths_m)
    enough = section.flag_progress * n_long
    total = 0.0
    for share in _progress(source, edited, n_both, section.progress_min_path_m):
        total += share
        if total >= enough:
            return None
    return total / n_long if n_long else None


def _progress(source: Tracks, edited: Tracks, n_both: int, least_m: float) -> Iterator[float]:
    """Yield how far along its source each edited trajectory ends, as a share; skip short sources."""
    steps_of = zip(*(zip(*step, strict=True) for step in source.steps), strict=True)
    ends = zip(edited.x_m[-1][:n_both], edited.y_m[-1][:n_both], strict=True)
    for (x, y), path_m, steps in zip(ends, source.lengths_m, steps_of, strict=False):
        if path_m < least_m:
            continue
        gone_m, nearest_m, reached_m = 0.0, math.inf, 0.0
        for step_x, step_y, length in steps:
            square = length * length  # underflows to 0 for the tiniest steps, too
            share = (x * step_x + y * step_y) / square if square else 0.0
            share = 0.0 if share < 0.0 else min(share, 1.0)
            gap_m = math.hypot(x - share * step_x, y - share * step_y)
            if gap_m < nearest_m:
                nearest_m, reached_m = gap_m, gone_m + share * length
            x, y, gone_m = x - step_x, y - step_y, gone_m + length
        yield min(reached_m / path_m, 1.0)
