"""Measure: trajectories and regions to one row of numbers per sample. The only geometry."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_scoring.clearance import clearance_of_footprints_m
from exceptiondrive_scoring.footprint import footprints
from exceptiondrive_scoring.kinematics import (
    Positions,
    Steps,
    net_motion_m,
    peak_acceleration_mps2,
    positions_of_waypoints,
    shift,
    steps,
    tightest_turn_m,
)
from exceptiondrive_scoring.region import PreparedRegions, prepare_regions


@dataclass(frozen=True)
class Measurements:
    """What geometry gives, per sample; all arrays (N,). Withheld: never leaves the worker.

    Attributes:
        clearance_m: Distance of collision tube and region; NaN where edited is missing.
        intrusion: Clearance within the contact tolerance; True where edited is missing.
        shift_m: Mean distance of edited and source; NaN where either is missing.
        shift_x_m: Its longitudinal part.
        shift_y_m: Its lateral part.
        edited_given: Whether there is an edited trajectory.
        source_given: Whether there is a source trajectory.
        edited_motion_m: Distance of the edited end from the start; NaN where missing.
        source_motion_m: The same of the source trajectory.
        peak_acceleration_mps2: Of the edited trajectory; NaN where missing.
        tightest_turn_m: Of the edited trajectory; infinite where straight or missing.
    """

    clearance_m: FloatArray
    intrusion: BoolArray
    shift_m: FloatArray
    shift_x_m: FloatArray
    shift_y_m: FloatArray
    edited_given: BoolArray
    source_given: BoolArray
    edited_motion_m: FloatArray
    source_motion_m: FloatArray
    peak_acceleration_mps2: FloatArray
    tightest_turn_m: FloatArray

    @classmethod
    def from_columns(cls, columns: Columns) -> "Measurements":
        """Read what `columns` wrote."""
        return cls(**{field.name: columns[field.name] for field in fields(cls)})

    def columns(self) -> dict[str, NDArray[Any]]:
        """What a store keeps, one array per attribute."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def measure(
    pairs: TrajectoryPairs, regions_m: FloatArray | PreparedRegions, geometry: GeometrySection
) -> Measurements:
    """Measure every sample (docs/protocol.md section 2; the paper's d_i, ur_i and CTS terms).

    Args:
        pairs: Submitted waypoints of N samples.
        regions_m: (N, 4, 2) corners, or the same regions prepared.
        geometry: The section that fixes every choice made here.

    Raises:
        ValueError: A region crosses itself.
    """
    regions = regions_m if isinstance(regions_m, PreparedRegions) else prepare_regions(regions_m)
    source, edited = (positions_of_waypoints(w) for w in (pairs.source, pairs.edited))
    moves = steps(edited)
    clearance = _clearance_m(edited, moves, pairs.edited_given, regions, geometry)
    moved = shift(source, edited)
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
    )


def _clearance_m(
    edited: Positions,
    moves: Steps,
    given: BoolArray,
    regions: PreparedRegions,
    geometry: GeometrySection,
) -> FloatArray:
    """Missing trajectories stand still while the others are measured, and become NaN after."""
    if not given.all():
        edited = Positions(*(np.where(given, part, 0.0) for part in edited))
        moves = steps(edited)
    boxes = footprints(edited, moves, geometry)
    return np.where(given, clearance_of_footprints_m(boxes, regions, geometry), np.nan)
