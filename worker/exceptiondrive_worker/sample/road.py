"""The lane: a circular arc that starts at the rear axle, straight ahead."""

import math
from dataclasses import dataclass

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
