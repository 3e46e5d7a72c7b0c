"""Plausibility of recorded drives (ego frame, metres, drivable), checked when a split is made."""

import math
from collections.abc import Sequence
from itertools import chain

from exceptiondrive_schemas.check.fault_list import FaultList
from exceptiondrive_schemas.check.frame import FrameCheck
from exceptiondrive_schemas.check.motion import undrivable_rows
from exceptiondrive_schemas.check.tracks import Tracks
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.submission_files import Trajectory

MIN_DRIVES = 3
"""With fewer drives, a car that backs out may be the majority."""


def drives_fault(drives: Sequence[Trajectory], protocol: ProtocolDocument) -> str | None:
    """Say why paths with the protocol's waypoints are no recorded drives; None if they may be.

    They are refused for another frame or unit, like the source trajectories of an upload, and if no
    car could drive most of those that move, which is checked for few drives, too.
    """
    tracks = Tracks.of(list(map(chain.from_iterable, drives)), protocol.geometry.waypoints)
    faults = FaultList()
    FrameCheck(tracks, protocol).finish(faults, None)
    if not faults.is_empty:
        return faults.groups()[0].message
    n_moving, n_wrong = len(_moving_rows(tracks, protocol)), len(not_driven(tracks, protocol))
    if n_wrong < MIN_DRIVES or 2 * n_wrong <= n_moving:
        return None
    return (
        f"No car makes {n_wrong:,} of {n_moving:,} recorded drives that move: they set off aside or "
        "backwards, or are too fast, too sharp or too sudden. Are they metres, x ahead and y left of the "
        f"rear axle at t = 0, {protocol.geometry.time_step_s:g} s apart?"
    )


def not_driven(drives: Tracks, protocol: ProtocolDocument) -> set[int]:
    """Return drives that no car makes: by their motion, too long a step, or a sideways start.

    A standing car is exempt: its measured drive scatters by centimetres to all sides.
    """
    geometry, section = protocol.geometry, protocol.plausibility
    found = undrivable_rows(drives, protocol)
    for lengths_m in drives.step_lengths_m:
        found.update(row for row, m in enumerate(lengths_m) if m > geometry.max_step_m)
    steepest = math.cos(math.radians(section.frame_check_max_angle_deg))
    found.update(
        row
        for row, (x_m, m) in enumerate(zip(drives.x_m[0], drives.step_lengths_m[0], strict=True))
        if m > section.stationary_below_m and x_m < steepest * m
    )
    return found & _moving_rows(drives, protocol)


def _moving_rows(drives: Tracks, protocol: ProtocolDocument) -> set[int]:
    least_m = protocol.plausibility.frame_check_min_motion_m
    return {row for row, path_m in enumerate(drives.lengths_m) if path_m > least_m}
