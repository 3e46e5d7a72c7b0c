"""Whether recorded drives may be what cars drove, in the ego frame, in metres: asked of their maker."""

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
"""Of fewer, a car that backs out may be most."""


def drives_fault(drives: Sequence[Trajectory], protocol: ProtocolDocument) -> str | None:
    """Say why paths with the waypoints of the protocol are no recorded drives; None where they may be.

    They are refused as the source trajectories of an upload are, in another frame or unit; and where no
    car makes most of those that move, which tells of few drives too.
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
    """Which drives no car makes: by their motion, a step that is too long, or one that sets off aside.

    A car that stands makes what is measured of it: centimetres to all sides.
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
