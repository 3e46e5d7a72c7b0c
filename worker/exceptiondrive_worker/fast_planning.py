"""Fast reader of `exceptiondrive.planning/1`: the client's decoder, then checks on whole arrays."""

import math
import struct

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.check.fast_decode import rows_of
from exceptiondrive_schemas.check.frame import FAR_M
from exceptiondrive_schemas.check.planning_columns import Side, planning_columns
from exceptiondrive_schemas.protocol import GeometrySection, PlausibilitySection, ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns, FloatArray

ANGLE_MARGIN_DEG = 1e-6
"""Directions this close to the limit of the frame check are left to the precise checker."""
MOVES_ON_M = 1.0
"""Metres from first to last point: more than for one repeated point or for degrees of latitude."""


def read_planning(text: bytes, manifest: Manifest, protocol: ProtocolDocument) -> Columns | None:
    """Return the columns `source` and `edited`, (N, T, 2) metres, NaN where missing.

    None if the file is faulty or not certainly sound.
    """
    columns = planning_columns(text, protocol.geometry.waypoints)
    if columns is None or columns.split != manifest.name:
        return None
    rows = rows_of(columns.sample_ids, manifest)
    if rows is None:
        return None
    at = np.array(rows, dtype=np.intp)
    source = _column(columns.source, at, protocol.geometry)
    edited = _column(columns.edited, at, protocol.geometry)
    if source is None or edited is None:
        return None
    if not is_surely_in_frame(source, protocol.plausibility):
        return None
    return {"source": source, "edited": edited}


def _column(side: Side, rows: NDArray[np.intp], geometry: GeometrySection) -> FloatArray | None:
    """Return (N, T, 2) in canonical order, or None if a bound is violated."""
    packed = struct.pack(f"{len(side.numbers)}d", *side.numbers)  # half the time of `fromiter`
    points_m = np.frombuffer(packed) + 0.0  # no negative zeros, as in the precise checker
    points_m = points_m.reshape(-1, geometry.waypoints, 2)
    if not _is_within_bounds(points_m, geometry):
        return None
    column_m = np.full((len(rows), geometry.waypoints, 2), math.nan)
    column_m[rows if len(points_m) == len(rows) else rows[side.is_given]] = points_m
    return column_m


def _is_within_bounds(points_m: FloatArray, geometry: GeometrySection) -> bool:
    if points_m.size == 0:
        return True
    if not max(points_m.max(), -points_m.min()) <= geometry.max_coordinate_m:
        return False  # checked first: squares of values far outside overflow
    steps_m = np.diff(points_m, axis=1, prepend=0.0)
    squares_m2 = np.square(steps_m, out=steps_m)
    longest_m2 = (squares_m2[..., 0] + squares_m2[..., 1]).max()
    return bool(longest_m2 <= geometry.max_step_m**2)


def is_surely_in_frame(source_m: FloatArray, rules: PlausibilitySection) -> bool:
    """Whether the frame check of docs/protocol.md section 5 certainly passes.

    More than half of the moving trajectories end within the cone around +x, and so does their
    median; more than half of all begin near the car and move on from there, and so do the medians.
    Source waypoints are (N, T, 2), NaN where missing.
    """
    (first_x, first_y), (x_m, y_m) = source_m[:, 0].T, source_m[:, -1].T
    moves = x_m * x_m + y_m * y_m > rules.frame_check_min_motion_m**2
    n_moving = np.count_nonzero(moves)
    if n_moving < rules.frame_check_min_samples:
        return True
    limit_rad = math.radians(rules.frame_check_max_angle_deg - ANGLE_MARGIN_DEG)
    is_ahead = np.abs(y_m) * math.cos(limit_rad) < x_m * math.sin(limit_rad)
    begins_near = np.hypot(first_x, first_y) < FAR_M / 2
    goes_on = np.hypot(x_m - first_x, y_m - first_y) > MOVES_ON_M
    n_given = np.count_nonzero(~np.isnan(x_m))
    return bool(
        np.count_nonzero(moves & is_ahead) * 2 > n_moving
        and np.count_nonzero(begins_near & goes_on) * 2 > n_given
    )
