"""Measure: turn trajectories and regions into numbers per sample. All geometry is here."""

from dataclasses import dataclass, fields

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_scoring.clearance import clearance_of_footprints_m
from exceptiondrive_scoring.footprint import footprints
from exceptiondrive_scoring.kinematics import (
    Positions,
    Steps,
    net_motion_m,
    path_fit,
    peak_acceleration_mps2,
    positions_of_waypoints,
    progress_along,
    shift,
    steps,
    tightest_turn_m,
)
from exceptiondrive_scoring.region import PreparedRegions, prepare_regions


@dataclass(frozen=True)
class Clearances:
    """The measurements that are compared with required clearances; both (N,). Withheld.

    Attributes:
        clearance_m: Distance of collision tube and region; NaN where edited is missing.
        intrusion: Clearance within the contact tolerance; True where edited is missing.
    """

    clearance_m: FloatArray
    intrusion: BoolArray


@dataclass(frozen=True)
class Measurements(Clearances):
    """The geometric measurements of each sample; all (N,). Withheld: never leaves the worker.

    Attributes:
        clearance_m: As in `Clearances`.
        intrusion: The same.
        shift_m: Mean distance of edited and source; NaN where either is missing.
        shift_x_m: Its longitudinal part.
        shift_y_m: Its lateral part.
        edited_given: Whether there is an edited trajectory.
        source_given: Whether there is a source trajectory.
        edited_motion_m: Distance of the edited end from the start; NaN where missing.
        source_motion_m: The same of the source trajectory.
        peak_acceleration_mps2: Of the edited trajectory; NaN where missing.
        tightest_turn_m: Of the edited trajectory; infinite where straight or missing.
        edited_end_x_m: Where the edited trajectory ends, along x; NaN where missing.
        source_behind: Whether the source trajectory ends at x < 0; False where missing.
        edited_first_step_m: Length of the first step of the edited trajectory; NaN where missing.
        source_first_step_m: The same of the source trajectory.
        source_path_m: Length of the source path; NaN where missing.
        reached_m: Arc length at which the edited end lies on it; NaN where either is missing.
        source_l2_m: Mean distance of source and recorded waypoints; NaN where either is missing.
            This and the next three are None if the split records no paths.
        source_l2_1s_m: Their distance at 1 s; NaN also where no waypoint has that time.
        source_l2_2s_m: The same at 2 s.
        source_l2_3s_m: The same at 3 s.
    """

    shift_m: FloatArray
    shift_x_m: FloatArray
    shift_y_m: FloatArray
    edited_given: BoolArray
    source_given: BoolArray
    edited_motion_m: FloatArray
    source_motion_m: FloatArray
    peak_acceleration_mps2: FloatArray
    tightest_turn_m: FloatArray
    edited_end_x_m: FloatArray
    source_behind: BoolArray
    edited_first_step_m: FloatArray
    source_first_step_m: FloatArray
    source_path_m: FloatArray
    reached_m: FloatArray
    source_l2_m: FloatArray | None = None
    source_l2_1s_m: FloatArray | None = None
    source_l2_2s_m: FloatArray | None = None
    source_l2_3s_m: FloatArray | None = None

    @classmethod
    def from_columns(cls, columns: Columns) -> "Measurements":
        """Read what `columns` wrote."""
        return cls(
            **{each.name: columns[each.name] for each in fields(cls) if each.name in columns}
        )

    def columns(self) -> Columns:
        """Return what a store keeps: one array per attribute that is not None."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def measure(
    pairs: TrajectoryPairs,
    regions_m: FloatArray | PreparedRegions,
    geometry: GeometrySection,
    recorded_m: FloatArray | None = None,
) -> Measurements:
    """Measure every sample (docs/protocol.md sections 2 and 9; the paper's d_i, ur_i and CTS terms).

    Args:
        pairs: Submitted waypoints of N samples.
        regions_m: (N, 4, 2) corners, or the same regions prepared.
        geometry: The section that fixes every choice made here.
        recorded_m: (N, T, 2) waypoints actually driven, NaN where unknown.

    Raises:
        ValueError: A region crosses itself.
    """
    regions = regions_m if isinstance(regions_m, PreparedRegions) else prepare_regions(regions_m)
    source, edited = (positions_of_waypoints(w) for w in (pairs.source, pairs.edited))
    moves, source_moves = steps(edited), steps(source)
    clearance = _clearance_m(edited, moves, pairs.edited_given, regions, geometry)
    moved = shift(source, edited)
    progress = progress_along(source, source_moves, edited.x_m[-1], edited.y_m[-1])
    fit = None if recorded_m is None else path_fit(pairs.source, recorded_m, geometry)
    return Measurements(
        clearance_m=clearance,
        intrusion=~(clearance > geometry.contact_tolerance_m),
        shift_m=moved.euclidean_m,
        shift_x_m=moved.x_m,
        shift_y_m=moved.y_m,
        edited_given=pairs.edited_given,
        source_given=pairs.source_given,
        edited_motion_m=net_motion_m(edited),
        source_motion_m=net_motion_m(source),
        peak_acceleration_mps2=peak_acceleration_mps2(moves, geometry),
        tightest_turn_m=tightest_turn_m(moves, geometry),
        edited_end_x_m=edited.x_m[-1],
        source_behind=source.x_m[-1] < 0,
        edited_first_step_m=moves.length_m[0],
        source_first_step_m=source_moves.length_m[0],
        source_path_m=progress.path_m,
        reached_m=progress.reached_m,
        **({} if fit is None else fit._asdict()),
    )


def _clearance_m(
    edited: Positions,
    moves: Steps,
    given: BoolArray,
    regions: PreparedRegions,
    geometry: GeometrySection,
) -> FloatArray:
    """Measure clearances; a missing trajectory is measured as standing still, then set to NaN."""
    if not given.all():
        edited = Positions(*(np.where(given, part, 0.0) for part in edited))
        moves = steps(edited)
    boxes = footprints(edited, moves, geometry)
    return np.where(given, clearance_of_footprints_m(boxes, regions, geometry), np.nan)
