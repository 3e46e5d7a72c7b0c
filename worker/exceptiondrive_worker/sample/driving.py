"""The lane, an arc that starts straight ahead of the rear axle, and how a synthetic car moves along it."""

import math
from dataclasses import dataclass

from exceptiondrive_schemas.submission_files import Trajectory

Position = tuple[float, float]

STRAIGHT_BELOW_PER_M = 1e-9


@dataclass(frozen=True)
class Lane:
    """A lane centre of constant curvature; positive bends left."""

    curvature_per_m: float

    def position_m(self, along_m: float, left_m: float) -> Position:
        """Return (x, y) of a place given along the lane and to the left of its centre."""
        bend = self.curvature_per_m
        if abs(bend) < STRAIGHT_BELOW_PER_M:
            return along_m, left_m
        heading_rad = bend * along_m
        centre_x = math.sin(heading_rad) / bend
        centre_y = (1 - math.cos(heading_rad)) / bend
        return centre_x - left_m * math.sin(heading_rad), centre_y + left_m * math.cos(heading_rad)


N_WAYPOINTS = 6
TIME_STEP_S = 0.5
SHIFT_LENGTH_M = 14.0
"""Least distance along the road over which a car changes its lateral position."""


@dataclass(frozen=True)
class Manoeuvre:
    """One way to drive the next seconds: along the lane, with an offset to the left of its centre.

    The speed is the initial one; the acceleration applies until any braking begins.
    """

    speed_mps: float
    acceleration_mps2: float = 0.0
    brake_at_s: float = math.inf
    brake_mps2: float = 0.0
    aside_m: float = 0.0

    def along_m(self, time_s: float) -> float:
        """Distance driven along the lane; a car that has stopped stays."""
        before_s = min(time_s, self.brake_at_s)
        driven = self.speed_mps * before_s + self.acceleration_mps2 * before_s**2 / 2
        if time_s <= self.brake_at_s:
            return driven
        speed = self.speed_mps + self.acceleration_mps2 * self.brake_at_s
        braking_s = min(time_s - self.brake_at_s, speed / self.brake_mps2)
        return driven + speed * braking_s - self.brake_mps2 * braking_s**2 / 2

    def left_m(self, along_m: float) -> float:
        """Lateral offset after this much road: a smooth step."""
        share = min(along_m / max(SHIFT_LENGTH_M, 2 * self.speed_mps), 1.0)
        return self.aside_m * share * share * (3 - 2 * share)

    def trajectory(self, lane: Lane) -> Trajectory:
        """Waypoints at 0.5 ... 3.0 s, metres, to the millimetre."""
        waypoints = []
        for step in range(1, N_WAYPOINTS + 1):
            along = self.along_m(step * TIME_STEP_S)
            x, y = lane.position_m(along, self.left_m(along))
            waypoints.append((round(x, 3), round(y, 3)))
        return tuple(waypoints)
